"""`tsa verify-safety`: does the drive stop by itself when this computer does not?"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl.cli.finite import Finite
from tsa_ctrl.errors import UsageError

if TYPE_CHECKING:
    from tsa_ctrl.drills.trials import Outcome
    from tsa_ctrl.drills.verify import Verification


@click.command(
    "verify-safety",
    epilog="Example: tsa verify-safety config/controller.toml --torque 0.1",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.argument("controller", metavar="CONTROLLER.toml", type=click.Path(path_type=Path))
@click.option("--torque", type=Finite(min=0.0, min_open=True), help="N*m at the motor; default: [safety] torque.")
@click.option("--record", type=click.Path(path_type=Path), help="Folder of the record; default: that of the logs.")
@click.option("--yes", is_flag=True, help="Do not ask before the motor pulls.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout and nothing else.")
def command(controller: Path, torque: float | None, record: Path | None, yes: bool, as_json: bool) -> int:
    """Hang and kill the loop at a small torque, withhold its heartbeat, and time the drive's own reaction.

    While that torque begins, motor, joint and joint torque sensor show whether it pulls the right way, and as much.
    A process apart from the loop listens on the bus and takes the time until the drive reports no torque. Leaves a
    dated record. Exit code 1 when a drive takes longer than [safety] zero_torque_within.
    """
    from tsa_ctrl.config import load_configuration
    from tsa_ctrl.drills.verify import check_folder, save, trial_torque, verify

    configuration = load_configuration(controller)
    chosen = trial_torque(configuration, torque)
    folder = record or configuration.log_folder
    check_folder(folder)
    if not yes:
        _confirm(chosen, len(configuration.file.axes))
    found = verify(configuration, chosen, lambda line: click.echo(line, err=True))
    path = save(found, folder)
    if as_json:
        click.echo(json.dumps({**found.as_dict(samples=False), "record": str(path)}, allow_nan=False))
    else:
        _show(found)
        click.echo(f"record: {path}")
    return 0 if found.safe else 1


def _confirm(torque: float, axes: int) -> None:
    motors = "the motor" if axes == 1 else f"all {axes} motors"
    if not sys.stdin.isatty():
        raise UsageError(f"{motors} will pull with {torque:g} N*m, and nobody is there to agree; give --yes")
    click.confirm(f"{motors.capitalize()} will pull with {torque:g} N*m, three times. Is the joint free?", abort=True)


def _show(found: Verification) -> None:
    from rich.console import Console
    from rich.table import Table

    from tsa_ctrl.drills.trials import Trial

    words = {trial.key: trial.words for trial in Trial}
    table = Table("trial", "axis", "torque before", "zero after", "allowed", "seen by", "by", "motor pulls", "")
    for outcome in found.outcomes:
        timing = outcome.timing
        before = "none" if timing.torque_before is None else f"{timing.torque_before:.3f} N*m"
        zero = "never seen" if timing.zero_after is None else f"{1e3 * timing.zero_after:.0f} ms"
        verdict = "[green]in time[/green]" if outcome.safe else "[bold red]NOT SAFE[/bold red]"
        allowed = f"{1e3 * outcome.limit:.0f} ms"
        seen = (timing.source or "-").upper()
        table.add_row(
            words[outcome.trial], outcome.axis, before, zero, allowed, seen, _acted(outcome), str(outcome.pull), verdict
        )
    Console().print(table)
    for outcome in found.outcomes:
        if outcome.watchdog.warning:
            click.echo(f"warning: {words[outcome.trial]}, axis '{outcome.axis}': {outcome.watchdog.warning}")


def _acted(outcome: Outcome) -> str:
    """The watchdog that took the torque."""
    found = outcome.watchdog
    if found.acted is None or found.after is None:
        return "not told"
    name = {"rpdo": "RPDO timer", "heartbeat": "heartbeat"}[found.acted]
    return f"{name}, {1e3 * found.after:.0f} ms"
