"""`tsa log`: look into a log, convert it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click


@click.group(
    "log",
    epilog="Example: tsa log info log/tsa-20250131-142501.mcap",
    context_settings={"help_option_names": ["-h", "--help"]},
)
def command() -> None:
    """Look into and convert logs (MCAP, CSV, CSV.gz, Parquet)."""


@command.command(epilog="Example: tsa log info run.mcap --json")
@click.argument("log", type=click.Path())
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout and nothing else.")
def info(log: str, as_json: bool) -> None:
    """Rate, length, jitter, axes and columns of LOG (LOG.mcap:AXIS for one axis), faults with their causes."""
    from tsa_ctrl.log.info import inspect

    found = inspect(log)
    if as_json:
        click.echo(json.dumps(found.as_dict(), allow_nan=False))
        return
    click.echo(f"{found.path}  sha256 {found.sha256[:16]}")
    if found.about:
        click.echo(f"recorded {found.about.get('started', '?')} by tsa-ctrl {found.about.get('version', '?')}")
    for problem in found.problems:
        click.echo(f"note: {problem}")
    for axis in found.axes:
        head = f"axis {axis.axis}: " if axis.axis is not None else ""
        click.echo(
            f"{head}{axis.rows} rows, {axis.seconds:.3f} s at {axis.rate:.6g} Hz, jitter {axis.jitter:.2%} of a period"
            + (f", {axis.skipped} samples skipped" if axis.skipped else "")
        )
        for column in axis.columns:
            span = "no number" if column.low is None else f"{column.low:12.6g} to {column.high:12.6g} {column.unit}"
            gaps = f"  ({column.missing} rows empty)" if column.missing else ""
            click.echo(f"  {column.name:16s}{', '.join(column.names) or span}{gaps}")
        for name in axis.text_columns:
            click.echo(f"  {name:16s}text")
    for note in found.notes:
        click.echo(str(note))


@command.command(epilog="Example: tsa log convert run.mcap --out run.csv.gz")
@click.argument("log", type=click.Path())
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path),
    help="FILE.csv, FILE.csv.gz or FILE.parquet, or a folder for CSV; several axes give one file each.",
)
def convert(log: str, out: Path) -> None:
    """Write LOG as a table, one file per axis; codes become names, empty columns are left out."""
    from tsa_ctrl.log.convert import convert as convert_log

    if sys.stderr.isatty():
        with click.progressbar(length=100, label="writing", file=sys.stderr) as bar:
            written = convert_log(log, out, lambda share: bar.update(int(100 * share) - bar.pos))
    else:
        written = convert_log(log, out)
    for file in written:
        click.echo(str(file.path))
        for note in file.notes:
            click.echo(f"note: {note}", err=True)
