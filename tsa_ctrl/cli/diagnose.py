"""`tsa diagnose`: find and explain model errors, extend the model, and measure the gain."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl import outputs
from tsa_ctrl.cli.options import CUTOFF, STRICT
from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import terminal

if TYPE_CHECKING:
    from tsa_ctrl.identify.diagnosis import Diagnosis
    from tsa_ctrl.identify.quantity import Quantity

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # constants of <malloc.h>
LARGE = 8 << 20  # bytes, a quarter of the maximum of glibc's own threshold; a minute at 1 kHz is 0.5 MB
# Bytes that may stay free at the end of the heap. If the threshold above is fixed, glibc keeps only 128 KB, and maps
# each array of a minute again page by page, which is 16 % of a diagnosis.
KEPT = 8 * LARGE

EXAMPLES = """\b
Examples:
  tsa diagnose a.csv b.csv --model actuator.toml --out out/diagnosis
  tsa diagnose folder-of-logs --model actuator.toml --out out/fleet
  tsa diagnose --example
"""


@click.command("diagnose", epilog=EXAMPLES)
@click.argument("logs", metavar="LOG...|FOLDER", nargs=-1, type=click.Path(path_type=Path))
@click.option("--model", type=click.Path(path_type=Path), help="Actuator model file.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for JSON, model, report and pictures.")
@click.option(
    "--example", is_flag=True, help="Diagnose a simulated log with a hidden cause, and print that cause at the end."
)
@click.option("--hold-out", metavar="PATTERN", help="Logs on which the gain is measured (default: every third).")
@STRICT
@CUTOFF
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of all random draws.")
@click.option("--json", "as_json", is_flag=True, help="Print diagnosis.json on stdout, and nothing else there.")
@click.option("--jobs", type=click.IntRange(1), help="Processes for a folder of logs (default: one per core).")
@click.option("--scheduler", metavar="ADDRESS", help="A running Dask scheduler for a folder of logs (tcp://host:8786).")
def command(
    logs: tuple[Path, ...],
    model: Path | None,
    out: Path | None,
    example: bool,
    hold_out: str | None,
    strict: bool,
    cutoff: float | None,
    seed: int,
    as_json: bool,
    jobs: int | None,
    scheduler: str | None,
) -> None:
    """Find the error of the simulation of LOG files, identify its cause, extend the model, measure the gain.

    Several logs are diagnosed together, as one drive. Each log of a folder is diagnosed separately: the answers go to
    one table, verdicts.csv, and the same command goes on where it was interrupted.
    """
    # Set before numpy is imported. With matrices this narrow, a second thread mostly waits and occupies a core, and the
    # order of the sums would depend on the number of cores.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    if example:
        _example(logs, model, out, seed, as_json)
        return
    if not logs or model is None or out is None:
        missing = "LOG" if not logs else "--model" if model is None else "--out"
        raise click.UsageError(f"Missing {missing}; or try --example")
    folders = [path for path in logs if path.is_dir()]
    if folders:
        if len(logs) > 1:
            raise UsageError(f"{folders[0]}: is a folder; give only the folder, or list the logs in it")
        if cutoff is not None:
            raise UsageError("--cutoff: does not apply to a folder; omit it, or list the logs in the folder")
        if hold_out is not None:
            raise UsageError("--hold-out: each log of a folder is diagnosed separately; omit it, or list the logs")
        from tsa_ctrl.cli.fleet import diagnose_folder

        diagnose_folder(
            folders[0], model, out, seed=seed, strict=strict, jobs=jobs, scheduler=scheduler, as_json=as_json
        )
        return
    if jobs is not None or scheduler is not None:
        raise UsageError(
            f"{'--jobs' if jobs else '--scheduler'}: applies only to a folder of logs; omit it, or give a folder"
        )
    result = _diagnose(logs, model, out, hold_out, seed, strict, cutoff)
    if as_json:
        click.echo(result.to_json(), nl=False)
    else:
        _show(result, out)


def _example(logs: tuple[Path, ...], model: Path | None, out: Path | None, seed: int, as_json: bool) -> None:
    """Make an example log, diagnose it, and print the hidden cause at the end."""
    if logs or model is not None:
        raise UsageError("--example: generates its own log and model; omit LOG and --model")
    from tsa_ctrl.demo import example

    folder = outputs.untaken(Path("out"), "example") if out is None else out
    outputs.make_folder(folder)
    click.echo(f"running the loop on a simulated joint, in virtual time: {folder}", err=True)
    made = example.make(folder.resolve(), seed)
    result = _diagnose((made.log,), made.model, folder / "diagnosis", None, seed, False, None)
    if as_json:
        click.echo(result.to_json(), nl=False)
        return
    _show(result, folder / "diagnosis")
    click.echo(f"hidden cause: {made.told()}")
    click.echo(f"to repeat it: tsa diagnose {made.log} --model {made.model} --out DIR")


def give_back_large() -> None:
    """Let glibc map each large array separately, so that its memory returns to the system when it is freed.

    After the first arrays are freed, glibc takes arrays of up to 32 MB from one heap. A column of an hour at 1 kHz is
    29 MB, and a freed column between two used ones stays with the process. Without glibc the function does nothing.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGE)
        mallopt(M_TRIM_THRESHOLD, KEPT)


def _diagnose(
    logs: tuple[Path, ...],
    model: Path,
    out: Path,
    hold_out: str | None,
    seed: int,
    strict: bool,
    cutoff: float | None,
) -> Diagnosis:
    """Read logs, diagnose them and write the report; show the current step on stderr."""
    from tsa_ctrl.system.process_supervisor import worker_context

    if len(os.sched_getaffinity(0)) > 1:  # matplotlib takes as long to import as everything else together
        worker_context("tsa_ctrl.identify.diagnosis.report.pictures")

    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from tsa_ctrl.identify.dataset import load_logs
    from tsa_ctrl.identify.diagnosis import diagnose
    from tsa_ctrl.identify.diagnosis.report.page import drawing, write
    from tsa_ctrl.model.parameters import load_model

    give_back_large()
    given = load_model(model)
    console = terminal(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    hidden = not console.is_terminal
    bar = Progress(*columns, console=console, transient=True, disable=hidden)
    with outputs.sole_writer(out), drawing() as plot, bar as progress:
        task = progress.add_task("reading logs", total=None)

        def say(stage: str) -> None:
            progress.update(task, description=stage)

        datasets = load_logs(logs, strict, cutoff)

        result = diagnose(datasets, given, hold_out=hold_out, seed=seed, progress=say)
        say("report")
        write(result, out, model, plot)
    return result


def _show(result: Diagnosis, out: Path) -> None:
    from rich.table import Table

    from tsa_ctrl.identify.diagnosis.report.page import PAGE
    from tsa_ctrl.identify.diagnosis.report.words import four_lines, remarks, spoken

    console = terminal()
    console.print(result.sentence, soft_wrap=True)
    for name, line in four_lines(result).items():
        console.print(f"{name}: {line}", soft_wrap=True)
    if result.causes:
        table = Table("cause", "or", "parameter", "value", "95 % interval")
        for cause in result.causes:
            first = True
            names = spoken(cause.effect), ", ".join(spoken(other) for other in cause.alternatives)
            for name, value in cause.parameters.items() or (("", ""),):
                text = (value, "") if isinstance(value, str) else _shown(value)
                table.add_row(*(names if first else ("", "")), spoken(name), *text)
                first = False
        console.print(table)
    for remark in remarks(result):
        console.print(remark, soft_wrap=True)
    console.print(f"verdict: {result.verdict.value}; next experiment: {result.experiment.text}", soft_wrap=True)
    console.print(f"report: {out / PAGE}", soft_wrap=True)


def _shown(value: Quantity) -> tuple[str, str]:
    """Return a number with its unit, and its interval if it was estimated from the logs."""
    from tsa_ctrl.identify.quantity import spelled

    unit = "" if value.unit == "1" else f" {spelled(value.unit)}"
    interval = f"{value.low:.4g} to {value.high:.4g}" if value.told else "not determined"
    return f"{value.value:.4g}{unit}", interval if value.low < value.high else ""
