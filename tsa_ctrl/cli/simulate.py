"""`tsa simulate`: predict the joint torque for a log and print the error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl import outputs
from tsa_ctrl.cli.options import CUTOFF, STRICT
from tsa_ctrl.errors import UsageError

if TYPE_CHECKING:
    from tsa_ctrl.identify.three_errors import ThreeErrors


@click.command(
    "simulate",
    epilog="Example: tsa simulate run.mcap --model config/actuator.toml --model extended.toml --picture run.png",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.argument("log", type=click.Path())
@click.option(
    "--model", "models", multiple=True, required=True, type=click.Path(), help="Actuator model file; repeatable."
)
@click.option("--out", type=click.Path(path_type=Path), help="CSV with t, tau_j, tau_j_sim, residual.")
@click.option("--picture", type=click.Path(path_type=Path), help="PNG of measured and simulated torque.")
@STRICT
@CUTOFF
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout and nothing else.")
def command(
    log: str,
    models: tuple[str, ...],
    out: Path | None,
    picture: Path | None,
    strict: bool,
    cutoff: float | None,
    as_json: bool,
) -> None:
    """Predict the joint torque for LOG (CSV, CSV.gz, Parquet, MCAP or MCAP:AXIS) and print the error.

    A model of kind rigid_drive predicts the motor torque instead. Without the predicted torque in the log, no error is
    printed.
    """
    from tsa_ctrl.identify.dataset import load_log, notes_of
    from tsa_ctrl.identify.simulate import labels, simulate_all, unmoved, write_csv
    from tsa_ctrl.identify.unused import with_unused
    from tsa_ctrl.log.table import split_axis
    from tsa_ctrl.model.parameters import load_model

    for option, path in (("--out", out), ("--picture", picture)):
        if path is not None:
            outputs.refuse_inputs(path, [split_axis(log)[0], *map(Path, models)], option)
    if out is not None and out == picture:
        raise UsageError(f"--picture {picture}: is the same file as --out; choose another file")
    loaded = [load_model(path) for path in models]
    dataset = load_log(log, strict, cutoff)
    simulations = simulate_all(dataset, list(zip(labels(models), loaded, strict=True)))
    notes = [*notes_of([with_unused(dataset, model, "simulate") for model in loaded])]
    notes += filter(None, [unmoved(dataset)])
    notes += [f"{simulation.likely} ({simulation.name})" for simulation in simulations if simulation.likely]
    kept = {path: outputs.keep(path) for path in (out, picture) if path is not None}
    if out is not None:
        write_csv(out, dataset, simulations)
    if picture is not None:
        from tsa_ctrl.identify.simulation_picture import draw

        draw(picture, dataset, simulations)
    if as_json:
        result = {
            "schema": 1,
            "log": dataset.name,
            "sha256": dataset.sha256,
            "models": [simulation.as_dict() for simulation in simulations],
            "notes": notes,
        }
        click.echo(json.dumps(result, allow_nan=False))
        return
    click.echo(f"{dataset.name}: {len(dataset)} samples at {dataset.rate:.6g} Hz, {dataset.seconds:.3f} s")
    for note in notes:
        click.echo(f"note: {note}")
    for simulation in simulations:
        if simulation.beyond_slack > 0.0:
            remedy = (
                "as modelled by [effects.tendon_slack]" if simulation.slack_modelled else "outside the domain of (3.55)"
            )
            click.echo(
                f"note: {simulation.beyond_slack:.1%} of the samples lie beyond abs(tau_m) = 2 T_p r_M, where one "
                f"tendon is slack, {remedy} ({simulation.name})"
            )
    for path, before in kept.items():
        click.echo(outputs.kept_words(path, before))
    for simulation in simulations:
        if simulation.rms is not None:
            click.echo(_parts(simulation.errors, simulation.name))
    for simulation in simulations:
        if simulation.rms is None:
            click.echo(f"predicted only: the log has no {simulation.quantity} ({simulation.name})")
        else:
            click.echo(f"RMS error: {_shown(simulation.rms)} N*m ({simulation.name})")


def _parts(errors: ThreeErrors, name: str) -> str:
    """Return the three errors in one line, which precedes the total."""
    told = {
        "while sliding": errors.sliding,
        "in reversals": errors.reversals,
        "sensor noise": errors.sensor_noise,
    }
    values = (f"{key} {'unknown' if value is None else f'{_shown(value)} N*m'}" for key, value in told.items())
    return f"error {', '.join(values)} ({name})"


def _shown(value: float) -> str:
    """Return a value with four decimals, or three digits if it is small; never with an exponent."""
    import numpy as np

    return (
        f"{value:.4f}" if value >= 0.01 else np.format_float_positional(value, precision=3, fractional=False, trim="0")
    )
