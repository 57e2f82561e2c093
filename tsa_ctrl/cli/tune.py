"""`tsa tune`: the guided procedure from a rig to a model file that fits it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl.cli.options import CUTOFF, Finite

if TYPE_CHECKING:
    from tsa_ctrl.tune.procedure import Outcome
    from tsa_ctrl.tune.session import Session


@click.command(
    "tune",
    epilog="Example: tsa tune config/controller.toml --seconds 20 --out out/tune",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.argument("controller", type=click.Path(path_type=Path))
@click.option("--axis", "axis_name", metavar="NAME", help="Axis to tune; required if the file has several.")
@click.option(
    "--joint",
    "joints",
    multiple=True,
    metavar="NAME",
    help="Also move this axis and identify how its joint bends the sheaths; repeatable.",
)
@click.option("--torque", type=Finite(min=0.0, min_open=True), help="Maximum joint torque, N*m.")
@click.option("--speed", type=Finite(min=0.0, min_open=True), help="Maximum joint speed, rad/s.")
@click.option("--travel", type=Finite(), nargs=2, metavar="LOW HIGH", help="Permitted joint angles, rad.")
@click.option(
    "--seconds", default=20.0, show_default=True, type=Finite(8.0, 600.0), help="Duration of the excitation, s."
)
@click.option(
    "--verify-seconds",
    default=10.0,
    show_default=True,
    type=Finite(4.0, 600.0),
    help="Duration of each of the three verification runs, s.",
)
@click.option(
    "--certified-gain", is_flag=True, help="The gain of both torque channels is certified: also use the slope."
)
@click.option("--given-form", is_flag=True, help="Keep the transmission's form; do not try the full model (3.53).")
@click.option("--extended", is_flag=True, help="Add the effects that the diagnosis identifies with certainty.")
@click.option(
    "--setpoint",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Excite with this torque (CSV with t, tau_j_des), as written by tsa diagnose.",
)
@click.option(
    "--virtual",
    "plant",
    type=click.Path(path_type=Path),
    metavar="PLANT.toml",
    help="Tune this simulated plant in virtual time; nothing is sent on a bus. New files are written only to --out.",
)
@click.option("--allow-simulated", is_flag=True, help="Allow a model file with simulated numbers on real drives.")
@click.option(
    "--from-log",
    "logs",
    multiple=True,
    type=click.Path(),
    metavar="LOG",
    help="Use this log (repeatable); move nothing.",
)
@CUTOFF
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder for page, pictures and logs; default: next to the logs."
)
@click.option("--yes", is_flag=True, help="Write the new file without asking.")
@click.option(
    "--dry-run", is_flag=True, help="Print checks and plan, with --from-log also the estimate; write nothing."
)
@click.option("--undo", is_flag=True, help="Restore the files that the last tuning replaced.")
@click.option(
    "--json", "as_json", is_flag=True, help="One JSON object on stdout; asks nothing, writes only with --yes."
)
def command(
    controller: Path,
    axis_name: str | None,
    joints: tuple[str, ...],
    torque: float | None,
    speed: float | None,
    travel: tuple[float, float] | None,
    seconds: float,
    verify_seconds: float,
    certified_gain: bool,
    given_form: bool,
    extended: bool,
    setpoint: Path | None,
    plant: Path | None,
    allow_simulated: bool,
    logs: tuple[str, ...],
    cutoff: float | None,
    out: Path | None,
    yes: bool,
    dry_run: bool,
    undo: bool,
    as_json: bool,
) -> None:
    """Excite the rig gently, estimate its friction, verify on another motion, and write the model file after a yes.

    A little shaking of the motor shows its inertia, the tendons' stiffness and how late a command acts; turn, lead and
    damping follow from them, with a gain margin of 2, and go into CONTROLLER.toml.

    The defaults are the limits of CONTROLLER.toml, and the torque up to which both tendons certainly pull. Ctrl-C at
    any point leaves the drive disabled and the files as they were.
    """
    from tsa_ctrl.tune.session import Plan, Session

    plan = Plan(
        torque=torque,
        speed=speed,
        travel=travel,
        seconds=seconds,
        verification_seconds=verify_seconds,
        certified_gain=certified_gain,
        forms=not given_form,
        extended=extended,
        setpoint=setpoint,
        joints=joints,
        plant=plant,
        allow_simulated=allow_simulated,
    )
    if cutoff is not None and not logs:
        raise click.UsageError("--cutoff applies only to --from-log; omit it")
    if plant is not None and logs:
        raise click.UsageError("--virtual generates its own logs; omit it or --from-log")
    if setpoint is not None and logs:
        raise click.UsageError("--setpoint applies only to a run on the rig; omit it or --from-log")
    session = Session(controller, axis_name, plan)
    if undo and (dry_run or logs):
        raise click.UsageError("--undo only restores the previous files; omit --dry-run and --from-log")
    if undo:
        kept = session.undo()
        text = "\n".join(f"{path}: restored from {old.name}" for path, old in kept.items())
        _tell(as_json, {"schema": 1, "undone": str(session.path), "files": [str(path) for path in kept]}, text)
        return
    if dry_run and not logs:
        _tell(as_json, session.plan_dict(), session.plan_text())
        return
    from tsa_ctrl.cli.tuning import interrupted_once

    with interrupted_once():
        _tune(session, logs, cutoff, out, yes, dry_run, as_json)


def _tell(as_json: bool, data: dict[str, object], text: str) -> None:
    click.echo(json.dumps(data, allow_nan=False) if as_json else text)


def _tune(
    session: Session,
    logs: tuple[str, ...],
    cutoff: float | None,
    out: Path | None,
    yes: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    from tsa_ctrl.tune import report

    with session.workspace(out, keep=not dry_run):
        outcome = session.from_logs(logs, cutoff) if logs else _on_the_rig(session, not (yes or as_json))
        session.finish(outcome)
        if not as_json:
            report.show(outcome, session.difference(outcome), session.page)
        written = None
        if not dry_run and _wanted(session, outcome, yes, as_json):
            written = session.write(outcome)
        if as_json:
            kept = None if written is None else next(before or path for path, before in written.items())
            click.echo(json.dumps(report.to_dict(outcome, session.axis.name, session.page, kept), allow_nan=False))
        elif written is not None:
            for path, before in written.items():
                click.echo(
                    f"written: {path}"
                    + (f"; the previous file is {before.name} (restore it with --undo)" if before else "")
                )
            if step := session.next_step(outcome):
                click.echo(step)
        else:
            click.echo(f"{session.path} is unchanged")


def _on_the_rig(session: Session, asks: bool) -> Outcome:
    from tsa_ctrl.cli.tuning import shown

    with shown() as (say, ask):
        return session.run(say, ask if asks and sys.stdin.isatty() else None)


def _wanted(session: Session, outcome: Outcome, yes: bool, as_json: bool) -> bool:
    """Return True if the files are to be written: only after consent, and never files that did worse."""
    if not session.worth_writing(outcome):
        click.echo("nothing is written: the new file is no better on data not used for the fit", err=True)
        return False
    if yes:
        return True
    if as_json or not sys.stdin.isatty():
        click.echo("not written: without a terminal, --yes is required", err=True)
        return False
    names = " and ".join(str(path) for path in session.targets(outcome))
    return click.confirm(f"write {names}?", default=False, err=True)
