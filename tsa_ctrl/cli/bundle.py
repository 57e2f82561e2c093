"""`tsa bundle`: write a field report of a run."""

from __future__ import annotations

import json
import tempfile
import zipfile
from pathlib import Path

import click

from tsa_ctrl.cli.options import Finite
from tsa_ctrl.errors import UsageError

TOLD = """Field report of a run of tsa-ctrl.

log.mcap       header with all files, the last part of the records, all events; tsa log info log.mcap
summary.json   counts and histograms of the whole run
files/         the files of the run, as text
doctor.json    checks of the machine on which the report was made
drive/         object values of a drive, if added (tsa drive dump)

tsa simulate-loop THIS.zip repeats a virtual run and compares each record with the log.
tsa simulate-loop THIS.zip PLANT.toml --seconds 10 runs the files of a hardware run on a simulated machine.
"""


@click.command("bundle", epilog="Example: tsa bundle logs/run.mcap --out report.zip")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="The ZIP file to write.")
@click.option(
    "--minutes",
    default=5.0,
    show_default=True,
    type=Finite(0.01, 10_000.0),
    help="Duration of the records up to the end of the run, minutes.",
)
@click.option(
    "--drive", "dumps", multiple=True, type=click.Path(path_type=Path), help="Add a file of tsa drive dump; repeatable."
)
@click.option("--no-doctor", is_flag=True, help="Skip the checks of this machine, which take a few seconds.")
def command(log: Path, out: Path, minutes: float, dumps: tuple[Path, ...], no_doctor: bool) -> None:
    """Write a field report of a run: LOG.mcap with its files, summary, events, and the checks of this machine.

    A stranger can reproduce the run from this one file: see tsa simulate-loop.
    """
    from tsa_ctrl import outputs
    from tsa_ctrl.log.convert import write_last
    from tsa_ctrl.log.reader import LogFile

    outputs.refuse_inputs(out, [log, *dumps])
    if log.is_dir():
        raise UsageError(f"{log}: is a folder; give the path of an MCAP file in it")
    if not log.is_file():
        raise UsageError(f"{log}: no such log; give the MCAP file of a run")
    for dump in dumps:
        if not dump.is_file():
            raise UsageError(f"{dump}: no such file; write it with tsa drive dump")
        twins = [str(other) for other in dumps if other.name == dump.name]
        if len(twins) > 1:
            raise UsageError(f"--drive {' and '.join(twins)} have the same name in the report; rename one of them")
    with tempfile.TemporaryDirectory() as folder, outputs.beside(out) as part:
        last = Path(folder, "log.mcap")
        seconds = write_last(log, last, 60.0 * minutes)
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as report:
            report.writestr("README.txt", TOLD)
            report.write(last, "log.mcap")
            for name, text in LogFile(log).files.items():
                report.writestr(f"files/{name.replace('../', 'above/').lstrip('/')}", text)
            summary = log.with_suffix(".json")
            if summary.is_file():
                report.write(summary, "summary.json")
            if not no_doctor:
                report.writestr("doctor.json", _doctor())
            for dump in dumps:
                report.write(dump, f"drive/{dump.name}")
    click.echo(f"written: {out} (the last {seconds:.1f} s)")
    if not summary.is_file():
        click.echo(f"note: {summary} is missing: the report has no counts of the whole run", err=True)


def _doctor() -> str:
    """Return the checks of this machine as JSON."""
    from tsa_ctrl.doctor import machine
    from tsa_ctrl.outputs import json_types
    from tsa_ctrl.system.realtime import RealtimeSettings

    checks = list(machine.checks(RealtimeSettings(), 1000.0, 1.0))
    return json.dumps({"schema": 1, "checks": json_types(checks)}, indent=1)
