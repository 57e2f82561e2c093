"""`tsa calibrate`: estimate friction angle and pretension from logs, and write them into a model file."""

from __future__ import annotations

import datetime
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from tsa_ctrl import __version__
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import Calibration, calibrate
from tsa_ctrl.identify.dataset import Dataset, load_log
from tsa_ctrl.model.parameters import load_tendon_sheath, save_model


@click.command("calibrate", epilog="Example: tsa calibrate a.csv b.csv --model actuator.toml --out calibrated.toml")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--model", required=True, type=click.Path(path_type=Path), help="Nominal actuator model file.")
@click.option("--out", type=click.Path(path_type=Path), help="Write the calibrated model file here.")
@click.option("--certified-gain", is_flag=True, help="The gain of both torque channels is certified: the slope counts.")
@click.option(
    "--tensioner",
    multiple=True,
    metavar="LOG=NEWTON",
    help="Known change of the pretension in a log (name or pattern), for example high.csv=+20.",
)
@click.option(
    "--split",
    type=click.Choice(["keep", "fit"]),
    default="keep",
    show_default=True,
    help="Where the data cannot part x and T_p: keep the file's proportion, or fit the simulation error.",
)
@click.option("--hold-out", metavar="PATTERN", help="Logs on which the error is measured (default: every third).")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(
    logs: tuple[Path, ...],
    model: Path,
    out: Path | None,
    certified_gain: bool,
    tensioner: tuple[str, ...],
    split: str,
    hold_out: str | None,
    as_json: bool,
) -> None:
    """Estimate friction angle and pretension from LOG files with honest intervals."""
    nominal = load_tendon_sheath(model)
    datasets = [load_log(path) for path in logs]
    result = calibrate(
        datasets,
        nominal,
        certified_gain=certified_gain,
        tensioner=dict(_change(text) for text in tensioner),
        hold_out=hold_out,
        split="fit" if split == "fit" else "keep",
    )
    if out is not None:
        save_model(result.model, out, template=model, provenance=_provenance(result, datasets, model))
    if as_json:
        click.echo(result.to_json())
    else:
        _show(result, nominal.friction_angle, nominal.pretension, out)


def _change(text: str) -> tuple[str, float]:
    name, separator, value = text.rpartition("=")
    try:
        if not separator or not name:
            raise ValueError
        return name, float(value)
    except ValueError:
        raise UsageError(f"--tensioner: found '{text}'; write LOG=NEWTON, for example high.csv=+20") from None


def _provenance(result: Calibration, logs: list[Dataset], nominal: Path) -> dict[str, object]:
    return {
        "command": "calibrate",
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "version": __version__,
        "nominal": nominal.name,
        "logs": {log.name: log.sha256 for log in logs},
        "split": result.split,
        "friction_angle": [result.friction_angle.low, result.friction_angle.high],
        "pretension": [result.pretension.low, result.pretension.high],
        "half_loop_torque": [result.half_loop_torque.low, result.half_loop_torque.high],
        "slope": [result.slope.low, result.slope.high],
    }


def _show(result: Calibration, friction_angle: float, pretension: float, out: Path | None) -> None:
    table = Table("quantity", "nominal", "value", "95 % interval", "unit", title="identified by these logs")
    rows = (
        ("half loop torque", None, result.half_loop_torque),
        ("slope", None, result.slope),
        ("friction angle", friction_angle, result.friction_angle),
        ("pretension", pretension, result.pretension),
    )
    for name, nominal, quantity in rows:
        value = "" if nominal is None else f"{nominal:.4g}"
        interval = f"{quantity.low:.4g} to {quantity.high:.4g}"
        table.add_row(name, value, f"{quantity.value:.4g}", interval, quantity.unit)
    console = Console()
    console.print(table)
    if result.split:
        console.print(f"friction angle and pretension are parted by the data (condition {result.condition_number:.3g})")
    else:
        console.print(
            "friction angle and pretension are NOT parted by these logs; their intervals are what is left open"
        )
        console.print(f"to settle it: {result.experiment}", soft_wrap=True)
    for note in result.notes:
        console.print(f"note: {note}", soft_wrap=True)
    refused = ", ".join(result.refused) or "nothing"
    console.print(f"admitted {result.admitted_seconds:.1f} s; refused: {refused}")
    console.print(f"RMS error on held-out data: {result.rms_before:.4g} N*m before, {result.rms_after:.4g} N*m after")
    if out is not None:
        console.print(f"written: {out}", soft_wrap=True)
