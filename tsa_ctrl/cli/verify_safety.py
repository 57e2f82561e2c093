"""`tsa verify-safety`: verify that the drive stops if this computer fails."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl.cli.options import Finite
from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import terminal

if TYPE_CHECKING:
    from tsa_ctrl.config import Configuration
    from tsa_ctrl.drills.trials import Outcome, Verification


@click.command(
    "verify-safety",
    epilog="Example: tsa verify-safety config/controller.toml --torque 0.1",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.argument("controller", metavar="CONTROLLER.toml", type=click.Path(path_type=Path))
@click.option(
    "--torque", type=Finite(min=0.0, min_open=True), help="Torque at the motor, N*m; default: [safety] torque."
)
@click.option("--held", is_flag=True, help="Instead, test sign and gain of the torque on locked joints.")
@click.option("--record", type=click.Path(path_type=Path), help="Folder for the record; default: the log folder.")
@click.option("--yes", is_flag=True, help="Do not ask before the motors pull.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout and nothing else.")
def command(controller: Path, torque: float | None, held: bool, record: Path | None, yes: bool, as_json: bool) -> int:
    """Hang and kill the loop at a small torque, withhold its heartbeat, and time the drive's own reaction.

    While that torque begins, motor, joint and joint torque sensor show whether it pulls the right way, and as much.
    A process apart from the loop listens on the bus and takes the time until the drive reports no torque. Leaves a
    dated record. Exit code 1 when a drive takes longer than [safety] zero_torque_within.

    With --held, the joints are held and the motors pull in both directions. The joint torque sensor or the load cells
    must show the sign and, within 10 %, the gain. Passed trials are stored in verify-safety.toml next to the controller
    file. Class "worn" requires both results.
    """
    from tsa_ctrl.config import load_configuration
    from tsa_ctrl.drills.trials import check_folder, save, trial_torque, verify
    from tsa_ctrl.readiness import add_to_record

    unused = [option for option, value in (("--torque", torque), ("--record", record)) if value is not None]
    if held and unused:
        raise UsageError(f"verify-safety: --held does not use {' and '.join(unused)}; leave this out")
    configuration = load_configuration(controller)
    if held:
        return _held(configuration, yes, as_json)
    chosen = trial_torque(configuration, torque)
    folder = record or configuration.log_folder
    check_folder(folder)
    if not yes:
        _confirm(chosen, len(configuration.file.axes))
    found = verify(configuration, chosen, lambda line: click.echo(line, err=True))
    path = save(found, folder)
    if found.safe:
        add_to_record(configuration, found.nodes, watchdogs=found.date)
    if as_json:
        click.echo(json.dumps({**found.as_dict(samples=False), "record": str(path)}, allow_nan=False))
    else:
        _show(found)
        click.echo(f"record: {path}")
    return 0 if found.safe else 1


def _held(configuration: Configuration, yes: bool, as_json: bool) -> int:
    """Run the test on locked joints and store its results."""
    from tsa_ctrl.drills.held import amplitude, run_held
    from tsa_ctrl.readiness import add_to_record

    pairs = zip(configuration.file.axes, configuration.models, strict=True)
    most = max(amplitude(configuration, axis, model) for axis, model in pairs)
    if not yes:
        _confirm(most, len(configuration.file.axes), "in both directions for 9 s. Is every joint locked?")
    found, nodes = run_held(configuration, lambda line: click.echo(line, err=True))
    path = add_to_record(configuration, nodes, held=found)
    if as_json:
        shown = {name: {"gain": each.gain, "sensor": each.sensor} for name, each in found.items()}
        click.echo(json.dumps({"schema": 1, "held": shown, "record": str(path)}, allow_nan=False))
        return 0
    for name, each in found.items():
        click.echo(
            f"axis '{name}': the {each.sensor} shows the right sign and {each.gain:.3f} times the model's torque"
        )
    click.echo(f"record: {path}")
    return 0


def _confirm(torque: float, axes: int, question: str = "three times. Is the joint free?") -> None:
    motors = "the motor" if axes == 1 else f"all {axes} motors"
    if not sys.stdin.isatty():
        raise UsageError(f"{motors} will pull with {torque:g} N*m; confirm this in a terminal, or give --yes")
    click.confirm(f"{motors.capitalize()} will pull with {torque:g} N*m, {question}", abort=True)


def _show(found: Verification) -> None:
    """Print one line for each trial and axis: its columns do not fit a terminal of 80 characters as a table."""
    from rich.text import Text

    from tsa_ctrl.drills.trials import Trial

    words = {trial.key: trial.words for trial in Trial}
    for outcome in found.outcomes:
        timing = outcome.timing
        before = "no torque" if timing.torque_before is None else f"{timing.torque_before:.3f} N·m"
        zero = "never zero" if timing.zero_after is None else f"zero after {1e3 * timing.zero_after:.0f} ms"
        seen = "" if timing.source is None else f" by {timing.source.upper()}"
        facts = (
            f", {before} before, {zero}{seen}, allowed {1e3 * outcome.limit:.0f} ms; stopped by: {_acted(outcome)}; "
            f"motor pulls: {outcome.pull}"
        )
        verdict = ("in time", "green") if outcome.safe else ("NOT SAFE", "bold red")
        line = Text.assemble(f"{words[outcome.trial]}, axis '{outcome.axis}': ", verdict, facts)
        terminal().print(line, soft_wrap=True)
    for outcome in found.outcomes:
        if outcome.watchdog.warning:
            click.echo(f"warning: {words[outcome.trial]}, axis '{outcome.axis}': {outcome.watchdog.warning}")


def _acted(outcome: Outcome) -> str:
    """Return the watchdog that removed the torque, and its time."""
    found = outcome.watchdog
    if found.acted is None or found.after is None:
        return "unknown"
    name = {"rpdo": "RPDO timer", "heartbeat": "heartbeat"}[found.acted]
    return f"{name}, {1e3 * found.after:.0f} ms"
