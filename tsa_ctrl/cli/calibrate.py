"""`tsa calibrate`: estimate friction angle and pretension from logs, and write them into a model file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl import outputs
from tsa_ctrl.cli.strict import STRICT
from tsa_ctrl.errors import UsageError

if TYPE_CHECKING:
    from tsa_ctrl.identify.calibrate import Calibration


@click.command(
    "calibrate",
    epilog="Example: tsa calibrate a.csv b.csv --model actuator.toml --out calibrated.toml",
    context_settings={"help_option_names": ["-h", "--help"]},
)
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
@STRICT
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(
    logs: tuple[Path, ...],
    model: Path,
    out: Path | None,
    certified_gain: bool,
    tensioner: tuple[str, ...],
    split: str,
    hold_out: str | None,
    strict: bool,
    as_json: bool,
) -> None:
    """Estimate friction angle and pretension from LOG files with honest intervals."""
    from tsa_ctrl.identify.calibrate import calibrate
    from tsa_ctrl.identify.dataset import load_logs
    from tsa_ctrl.identify.provenance import provenance
    from tsa_ctrl.log.table import split_axis
    from tsa_ctrl.model.parameters import load_tendon_sheath, save_model

    if out is not None:
        outputs.refuse_inputs(out, [split_axis(path)[0] for path in logs])
    nominal = load_tendon_sheath(model)
    datasets = load_logs(logs, strict)
    result = calibrate(
        datasets,
        nominal,
        certified_gain=certified_gain,
        tensioner=dict(_change(text) for text in tensioner),
        hold_out=hold_out,
        split="fit" if split == "fit" else "keep",
    )
    kept = None
    if out is not None:
        kept = outputs.keep(out)
        source = provenance("calibrate", datasets, model, result.quantities, split=result.split)
        save_model(result.model, out, template=model, provenance=source)
    if as_json:
        click.echo(result.to_json())
    else:
        _show(result, nominal.friction_angle, nominal.pretension)
        if out is not None:
            click.echo(outputs.kept_words(out, kept))


def _change(text: str) -> tuple[str, float]:
    name, separator, value = text.rpartition("=")
    try:
        change = float(value)
        if not separator or not name or not math.isfinite(change):
            raise ValueError
        return name, change
    except ValueError:
        raise UsageError(f"--tensioner: found '{text}'; write LOG=NEWTON, for example high.csv=+20") from None


def _show(result: Calibration, friction_angle: float, pretension: float) -> None:
    from rich.console import Console
    from rich.table import Table

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
