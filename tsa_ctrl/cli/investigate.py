"""`tsa investigate`: run experiments until one cause remains or the remaining ones cannot be separated."""

from __future__ import annotations

import json
import os
import shutil
import sys
from functools import partial
from pathlib import Path

import click

from tsa_ctrl.cli.options import Finite
from tsa_ctrl.errors import TsaError, UsageError
from tsa_ctrl.outputs import make_folder

EXAMPLE = "Example: tsa investigate config/controller.toml --virtual config/plant.toml --out out/investigation"


@click.command("investigate", epilog=EXAMPLE)
@click.argument("controller", type=click.Path(path_type=Path))
@click.argument("logs", metavar="[LOG]...", nargs=-1, type=click.Path())
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="New folder; each motion gets a folder in it."
)
@click.option(
    "--virtual",
    "plant",
    type=click.Path(path_type=Path),
    metavar="PLANT.toml",
    help="Move this simulated plant, in virtual time; nothing is sent on a bus.",
)
@click.option("--axis", "axis_name", metavar="NAME", help="Axis to investigate; required if the file has several.")
@click.option("--torque", type=Finite(min=0.0, min_open=True), help="Maximum joint torque, N*m.")
@click.option("--speed", type=Finite(min=0.0, min_open=True), help="Maximum joint speed, rad/s.")
@click.option("--travel", type=Finite(), nargs=2, metavar="LOW HIGH", help="Permitted joint angles, rad.")
@click.option("--seconds", default=20.0, show_default=True, type=Finite(8.0, 120.0), help="Duration of each motion, s.")
@click.option("--most", default=6, show_default=True, type=click.IntRange(1, 30), help="Maximum number of motions.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of all random draws.")
@click.option("--allow-simulated", is_flag=True, help="Allow a model file with simulated numbers on real drives.")
@click.option("--yes", is_flag=True, help="Start without asking.")
@click.option("--json", "as_json", is_flag=True, help="Print investigation.json on stdout, and nothing else there.")
def command(
    controller: Path,
    logs: tuple[str, ...],
    out: Path,
    plant: Path | None,
    axis_name: str | None,
    torque: float | None,
    speed: float | None,
    travel: tuple[float, float] | None,
    seconds: float,
    most: int,
    seed: int,
    allow_simulated: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Diagnose, play the motion that separates the open causes best, and diagnose again.

    The answer is one cause, a group that no motion within the limits separates, or "outside the catalogue". The
    options narrow the limits of CONTROLLER.toml. The files of the rig are not changed. Ctrl-C at any point leaves the
    drive disabled and keeps the result of the motions so far. So does an error.
    """
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # as in tsa diagnose
    from tsa_ctrl.cli.tuning import interrupted_once, shown
    from tsa_ctrl.identify.dataset import load_logs
    from tsa_ctrl.identify.diagnosis.report.page import MODEL
    from tsa_ctrl.identify.diagnosis.report.page import write as write_diagnosis
    from tsa_ctrl.identify.diagnosis.report.pictures import plot
    from tsa_ctrl.investigate.procedure import (
        Answer,
        Investigation,
        Step,
        investigate,
        on_the_rig,
        report_dict,
        write_report,
    )
    from tsa_ctrl.model.provenance import Origin
    from tsa_ctrl.plant.process import check
    from tsa_ctrl.tune.session import Plan, Session

    session = Session(controller, axis_name, Plan(torque, speed, travel, plant=plant, allow_simulated=allow_simulated))
    if session.by_stretch:
        raise UsageError(
            f"{controller}: axis '{session.axis.name}' has no joint torque sensor, which a diagnosis requires; add "
            "[axis.torque_sensor] or an [[axis.serial]] with tau_j"
        )
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out}: already exists and is not empty; choose another --out")
    given = load_logs(logs) if logs else []
    if plant is not None:
        check(plant)
    bounds = session.bounds
    if plant is None and not yes:
        question = (
            f"move the joint of axis {session.axis.name} up to {most} times for {seconds:g} s with up to "
            f"{bounds.torque:.3g} N*m and {bounds.speed:g} rad/s; do not wear it. Start?"
        )
        if not sys.stdin.isatty():
            raise UsageError(f"investigate: would {question.removesuffix(' Start?')}; confirm with --yes")
        click.confirm(question, abort=True, err=True)
    session.check_ready()
    make_folder(out)
    folder = out.resolve()
    simulated = None if plant is None else Origin("simulated")

    steps: list[Step] = []

    def keep(step: Step) -> None:
        steps.append(step)
        own = folder / "given-logs" if step.folder is None else step.folder
        own.mkdir(exist_ok=True)
        write_diagnosis(step.result, own, session.path, plot, simulated)
        shutil.copyfile(own / MODEL, folder / MODEL)  # the last motion replaces it

    with interrupted_once(), shown() as (say, _):
        # Motion of any other joint may bend the sheath.
        play = on_the_rig(partial(session.runner, all_axes=True), folder, session.path)
        try:
            found = investigate(play, session.model, bounds, most, seed, given, say, keep, seconds)
        except TsaError as error:
            if any(folder.iterdir()):
                write_report(Investigation(Answer.STOPPED, f"stopped by an error: {error}", tuple(steps)), folder)
            raise
    page = write_report(found, folder)
    if as_json:
        click.echo(json.dumps(report_dict(found, folder), allow_nan=False))
    else:
        for step in found.steps:
            causes = "; ".join(" or ".join(names) for names in step.hypotheses) or "no cause"
            click.echo(f"{step.name} ({step.seconds:.3g} s): {step.result.verdict.value}, {causes}")
        click.echo(f"answer: {found.answer.value}: {found.statement}")
        click.echo(f"report: {page}")
    if found.answer is Answer.STOPPED:
        sys.exit(1)
