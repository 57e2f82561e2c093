"""`tsa calibrate`: estimate friction angle and pretension from logs, and write them into a model file."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl import outputs
from tsa_ctrl.cli.options import CUTOFF, STRICT
from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import terminal

if TYPE_CHECKING:
    from tsa_ctrl.identify.calibrate import Calibration
    from tsa_ctrl.identify.calibrate.stretch import StretchFit
    from tsa_ctrl.identify.quantity import Quantity
    from tsa_ctrl.model.parameters import TendonSheath


MOST_CHANGE = 20e3  # N, largest pretension of a model file


@click.command(
    "calibrate",
    epilog="Example: tsa calibrate a.csv b.csv --model actuator.toml --out calibrated.toml",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--model", required=True, type=click.Path(path_type=Path), help="Nominal actuator model file.")
@click.option("--out", type=click.Path(path_type=Path), help="Write the calibrated model file here.")
@click.option(
    "--certified-gain", is_flag=True, help="The gain of both torque channels is certified: also use the slope."
)
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
    help="If the data cannot separate x and T_p: keep the file's ratio, or fit the simulation error.",
)
@click.option(
    "--stretch",
    is_flag=True,
    help="Also identify stiffness, curvature profile and motor inertia from q_m and q_j; then tau_j is optional.",
)
@click.option("--hold-out", metavar="PATTERN", help="Logs on which the error is measured (default: every third).")
@STRICT
@CUTOFF
@click.option(
    "--yes", is_flag=True, help="Write the result even if it is doubtful, for example worse than the nominal model."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout; asks nothing.")
def command(
    logs: tuple[Path, ...],
    model: Path,
    out: Path | None,
    certified_gain: bool,
    tensioner: tuple[str, ...],
    split: str,
    stretch: bool,
    hold_out: str | None,
    strict: bool,
    cutoff: float | None,
    yes: bool,
    as_json: bool,
) -> None:
    """Estimate friction angle and pretension from LOG files with honest intervals."""
    from tsa_ctrl.identify.calibrate import calibrate
    from tsa_ctrl.identify.calibrate.routing import joint_columns
    from tsa_ctrl.identify.calibrate.stretch import fit_stretch
    from tsa_ctrl.identify.dataset import load_logs, notes_of
    from tsa_ctrl.identify.provenance import provenance
    from tsa_ctrl.identify.unused import with_unused
    from tsa_ctrl.log.table import split_axis
    from tsa_ctrl.model.parameters import save_model

    if out is not None:
        outputs.refuse_inputs(out, [split_axis(path)[0] for path in logs])
    nominal = _loaded(model)
    used = "t1", "t3", *(("q_m", "q_j") if stretch else ())
    datasets = [
        with_unused(log, nominal, "calibrate", *used, *joint_columns(log, nominal))
        for log in load_logs(logs, strict, cutoff)
    ]
    fit = fit_stretch(datasets, nominal) if stretch else None
    if fit is not None:
        if not as_json:
            _show_stretch(fit)
        if not all("tau_j" in dataset for dataset in datasets):
            kept = None
            if out is not None:
                kept = outputs.keep(out)
                source = provenance("calibrate", datasets, model, fit.quantities)
                save_model(fit.model, out, template=model, provenance=source)
            if as_json:
                told = {"schema": 1, "stretch": fit.to_dict(), "notes": notes_of(datasets)}
                click.echo(json.dumps(told, allow_nan=False))
                return
            for note in notes_of(datasets):
                click.echo(f"note: {note}")
            if out is not None:
                click.echo(outputs.kept_words(out, kept))
            return
        nominal = replace(fit.model, friction_coefficient=nominal.friction_coefficient)
    result = calibrate(
        datasets,
        nominal,
        certified_gain=certified_gain,
        tensioner=dict(_change(text) for text in tensioner),
        hold_out=hold_out,
        split="fit" if split == "fit" else "keep",
    )
    if not as_json:
        _show(result, nominal)
    kept = None
    if out is not None:
        if result.objection and not yes:
            _ask(result, model, out, as_json)
        kept = outputs.keep(out)
        quantities = {**({} if fit is None else fit.quantities), **result.quantities}
        source = provenance("calibrate", datasets, model, quantities, split=result.split)
        save_model(result.model, out, template=model, provenance=source)
    if as_json:
        more = {} if fit is None else {"stretch": fit.to_dict()}
        click.echo(json.dumps({**result.to_dict(), **more}, allow_nan=False))
    elif out is not None:
        click.echo(outputs.kept_words(out, kept))


def _ask(result: Calibration, model: Path, out: Path, as_json: bool) -> None:
    """Raise UsageError unless the user confirms that a doubtful result is to be written."""
    asked = sys.stdin.isatty() and sys.stdout.isatty() and not as_json
    if asked and click.confirm(f"{result.objection}; write {out}?", default=False):
        return
    raise UsageError(f"{out}: not written: {result.objection}; --yes writes the file anyway")


def _loaded(model: Path) -> TendonSheath:
    """Return the nominal model; raise UsageError for a plain drive, whose parameters `tsa diagnose` estimates."""
    from tsa_ctrl.model.parameters import TendonSheath, load_model

    loaded = load_model(model)
    if isinstance(loaded, TendonSheath):
        return loaded
    raise UsageError(
        f"{model}: is a {loaded.kind.value}; use tsa diagnose, which calibrates its parameters: "
        f"tsa diagnose LOG --model {model} --out DIR writes them to DIR/extended.toml"
    )


def _change(text: str) -> tuple[str, float]:
    name, separator, value = text.rpartition("=")
    try:
        change = float(value)
        if not separator or not name or not abs(change) <= MOST_CHANGE:
            raise ValueError
        return name, change
    except ValueError:
        raise UsageError(
            f"--tensioner: found '{text}'; write LOG=NEWTON, for example high.csv=+20, at most {MOST_CHANGE:g} N"
        ) from None


def _show(result: Calibration, nominal: TendonSheath) -> None:
    from rich.table import Table

    from tsa_ctrl.identify.diagnosis.report.words import of_the_written_model

    table = Table("quantity", "nominal", "value", "95 % interval", "unit", title="identified from these logs")
    rows = (
        ("friction torque", None, result.half_loop_torque),
        ("slope", None, result.slope),
        ("friction angle", nominal.friction_angle, result.friction_angle),
        ("pretension", nominal.pretension, result.pretension),
        *((name.replace("_", " "), None, quantity) for name, quantity in result.routing.items()),
    )
    for name, given, quantity in rows:
        value = "" if given is None else f"{given:.4g}"
        interval = f"{quantity.low:.4g} to {quantity.high:.4g}"
        table.add_row(name, value, f"{quantity.value:.4g}", interval, _unit(quantity))
    console = terminal()
    console.print(table)
    if result.split:
        console.print(
            f"friction angle and pretension are separately identifiable (condition number "
            f"{result.condition_number:.3g})"
        )
    else:
        console.print(
            "friction angle and pretension are NOT separately identifiable; their intervals are the remaining "
            "uncertainty"
        )
        console.print(f"to separate them: {result.experiment}", soft_wrap=True)
    for note in result.notes:
        click.echo(f"note: {note}")
    refused = ", ".join(result.refused) or "nothing"
    click.echo(f"admitted {result.admitted_seconds:.1f} s; rejected: {refused}")
    click.echo(
        f"RMS error of the calibrated model on these logs: {result.rms_given:.4g} N·m nominal, "
        f"{result.rms_written:.4g} N·m calibrated"
    )
    click.echo(
        f"RMS error on held-out data, calibrated without them: {result.rms_before:.4g} N·m nominal, "
        f"{result.rms_after:.4g} N·m calibrated"
    )
    click.echo(of_the_written_model(result.errors))
    if result.objection:
        click.echo(
            f"the error while sliding is LARGER than with the nominal model: {result.worse}; tsa diagnose finds the "
            f"cause"
        )


def _unit(quantity: Quantity) -> str:
    """Return the unit for a table, or an empty text for a dimensionless number."""
    from tsa_ctrl.identify.quantity import spelled

    return "" if quantity.unit == "1" else spelled(quantity.unit)


def _show_stretch(fit: StretchFit) -> None:
    from rich.table import Table

    table = Table("quantity", "value", "95 % interval", "unit", title="identified from the tendon elongation")
    rows = {**fit.quantities, **{f"zero of the elongation in {name}": quantity for name, quantity in fit.zeros.items()}}
    for name, quantity in rows.items():
        interval = f"{quantity.low:.4g} to {quantity.high:.4g}"
        table.add_row(name.replace("_", " "), f"{quantity.value:.4g}", interval, _unit(quantity))
    console = terminal()
    console.print(table)
    for note in fit.notes:
        console.print(f"note: {note}", soft_wrap=True)
