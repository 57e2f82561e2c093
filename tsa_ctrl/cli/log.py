"""`tsa log`: inspect, convert and import logs, and show a trend over runs."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl.cli.options import Finite

if TYPE_CHECKING:
    from tsa_ctrl.log.foreign.mapping import Imported

_VIRTUAL = "1970-01-01T00:00:00Z"  # start of each log of virtual time, so that two runs give the same bytes


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
        started = found.about.get("started", "?")
        how = "simulated in virtual time" if started == _VIRTUAL else f"recorded {started}"
        click.echo(f"{how} by tsa-ctrl {found.about.get('version', '?')}")
    for problem in found.problems:
        click.echo(f"note: {problem}")
    for axis in found.axes:
        head = f"axis {axis.axis}: " if axis.axis is not None else ""
        click.echo(
            f"{head}{axis.rows} rows, {axis.seconds:.3f} s at {axis.rate:.6g} Hz, jitter {axis.jitter:.2%} of a period"
            + (f", {axis.skipped} samples skipped" if axis.skipped else "")
        )
        for column in axis.columns:
            span = "no numbers" if column.low is None else f"{column.low:12.6g} to {column.high:12.6g} {column.unit}"
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
    help="FILE.csv, FILE.csv.gz or FILE.parquet, or a folder for CSV; each axis gets its own file.",
)
def convert(log: str, out: Path) -> None:
    """Write LOG as a table, one file per axis; codes become names, empty columns are left out."""
    from tsa_ctrl.log.convert import convert as convert_log

    with click.progressbar(length=100, label="writing", file=sys.stderr, hidden=not sys.stderr.isatty()) as bar:
        written = convert_log(log, out, lambda share: bar.update(int(100 * share) - bar.pos))
    for file in written:
        click.echo(str(file.path))
        for note in file.notes:
            click.echo(f"note: {note}", err=True)


@command.command(epilog="Example: tsa log trend logs --model actuator.toml --picture trend.png")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--model", required=True, type=click.Path(path_type=Path), help="Actuator model file.")
@click.option("--picture", type=click.Path(path_type=Path), help="PNG file for a picture of the trend.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout and nothing else.")
def trend(folder: Path, model: Path, picture: Path | None, as_json: bool) -> None:
    """Show friction torque, stiffness and zero of every log in FOLDER over time, and report changes.

    Each log is one run. All logs must be of one axis. The friction torque is derived from the joint torque sensor or
    from the tendon elongation. Stiffness and zero are derived from the elongation, which requires q_m and q_j. Changes
    are reported if there are at least six runs.
    """
    from tsa_ctrl.identify.trend import ALARM, draw
    from tsa_ctrl.identify.trend import trend as trend_of
    from tsa_ctrl.model.parameters import load_tendon_sheath

    nominal = load_tendon_sheath(model)
    with click.progressbar(length=100, label="reading", file=sys.stderr, hidden=not sys.stderr.isatty()) as bar:
        found = trend_of(folder, nominal, lambda share: bar.update(int(100 * share) - bar.pos))
    if picture is not None:
        draw(picture, found)
    if as_json:
        click.echo(json.dumps(found.to_dict(), allow_nan=False))
        return
    for run in found.runs:
        values = "; ".join(
            f"{name.replace('half_loop', 'friction').replace('_', ' ')} {quantity}"
            for name, quantity in run.quantities.items()
        )
        warm = f", {run.temperature:.1f} °C" if run.temperature == run.temperature else ""
        click.echo(f"{run.started}  {run.log}{warm}: {values or 'no result'}")
        for note in run.notes:
            click.echo(f"  note: {note}")
    if found.by_temperature is not None:
        click.echo(
            f"friction torque over temperature: {found.by_temperature:.3g} N·m/K, removed before the search for changes"
        )
    for change in found.changes:
        click.echo(str(change))
    if not found.changes:
        click.echo("no change found")
    click.echo(
        f"false alarms: {100.0 * ALARM:g} % for each quantity of a folder; detecting a change takes at least six runs"
    )


@command.command("import", epilog="Example: tsa log import measured.txt --column 'tau_m=Strom|A*0.12' --out mine")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--map", "map_file", type=click.Path(path_type=Path), help="Mapping file, as written by an import.")
@click.option(
    "--column",
    "given",
    multiple=True,
    metavar="NAME=HEADER[|UNIT[*SCALE]]",
    help="Source of one log column; repeatable, overrides the mapping file.",
)
@click.option(
    "--rate",
    type=Finite(min=0.0, min_open=True),
    metavar="HZ",
    help="Sampling rate of a file without a time column.",
)
@click.option(
    "--kind",
    type=click.Choice(["tendon_sheath", "rigid_drive", "geared_drive"]),
    show_default="tendon_sheath with a joint torque, else rigid_drive",
    help="Kind of the model file to be completed.",
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for CSV, mapping, model, picture.")
@click.option("--yes", is_flag=True, help="Accept the proposals for all open questions.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout; asks nothing.")
def import_(
    files: tuple[Path, ...],
    map_file: Path | None,
    given: tuple[str, ...],
    rate: float | None,
    kind: str | None,
    out: Path,
    yes: bool,
    as_json: bool,
) -> None:
    """Turn tables of other programs into logs that every command reads.

    FILE is text, .mat, .xlsx, .h5, .npy, .npz, .tdms, .lvm, .parquet, .json, .mcap, a ROS 1 bag or a ROS 2 folder.
    Separator, decimal sign, encoding, names and units are determined from the file. All open questions come in one
    message, each with a proposal. --column, --map and --yes answer them. Writes the log in SI, the mapping, a model
    file to fill in, and a picture.
    """
    from tsa_ctrl.cli import log_import

    asked = sys.stdin.isatty() and sys.stdout.isatty() and not (yes or as_json or map_file is not None)
    every, proposals = log_import.understand_all(files, map_file, given, accept=yes or asked, rate=rate)
    for done in [] if as_json else every:
        log_import.show(done)
    if proposals and not as_json:
        click.echo("proposals, not stated in the files: " + " ".join(f"--column '{text}'" for text in proposals))
    if asked and not click.confirm("is this correct?", default=True):
        raise click.ClickException("nothing was written; correct the mapping with --column or --map")
    pairs = [
        (done, log_import.write(done, out, s, kind or ""))
        for done, s in zip(every, log_import.stems(files), strict=True)
    ]
    if as_json:
        rows = [log_import.as_dict(done, written) for done, written in pairs]
        click.echo(json.dumps(rows[0] if len(rows) == 1 else {"schema": 1, "files": rows}, allow_nan=False))
        return
    for done, written in pairs:
        _written(done.columns, written, out)


def _written(columns: Mapping[str, object], written: Imported, out: Path) -> None:
    for path in (written.log, written.mapping, written.model, written.picture):
        if path is not None:
            click.echo(f"written: {path}")
    verb = "diagnose" if "tau_m" in columns else "log info"
    more = f" --model {out / 'model.toml'} --out {out / 'diagnosis'}" if verb == "diagnose" else ""
    click.echo(f"next: fill in {out / 'model.toml'}, then run: tsa {verb} {written.log}{more}")
