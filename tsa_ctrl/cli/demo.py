"""`tsa demo`: the whole system on this machine."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.bus_choice import choose
from tsa_ctrl.demo.motion import from_file, gait
from tsa_ctrl.demo.outcome import Outcome
from tsa_ctrl.demo.run import demo
from tsa_ctrl.errors import UsageError


@click.command("demo", epilog="Example: tsa demo --seconds 10 --out out/demo")
@click.option("--setpoint", type=click.Path(path_type=Path), help="CSV with t, tau_j_des and q_j; default: a gait.")
@click.option("--seconds", default=11.0, show_default=True, type=click.FloatRange(3.0, 3600.0), help="Torque per run.")
@click.option("--rate", default=1000.0, show_default=True, type=click.FloatRange(50.0, 4000.0), help="Of the loop, Hz.")
@click.option("--bus", help="CAN interface, or INTERFACE:CHANNEL of python-can; default: the best there is.")
@click.option("--tendon", type=click.Choice(["full", "distributed"]), default="full", show_default=True)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder for files, logs and picture; default: out/demo-DATE."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(
    setpoint: Path | None, seconds: float, rate: float, bus: str | None, tendon: str, out: Path | None, as_json: bool
) -> None:
    """Simulated drive and joint on a bus, the daemon, a set-point: what compensation gains."""
    play = gait() if setpoint is None else from_file(setpoint, rig.MOST_TORQUE)
    chosen = choose(bus)
    folder = _folder(out)
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(f"demo on {chosen.name}", total=1.0)

        def say(what: str, share: float) -> None:
            progress.update(task, description=what, completed=share)

        outcome = demo(folder, chosen, play, seconds, rate, tendon, say)
    if as_json:
        click.echo(json.dumps(outcome.to_dict(), allow_nan=False))
    else:
        _show(outcome)


def _folder(out: Path | None) -> Path:
    if out is None:
        out = Path("out") / f"demo-{dt.datetime.now():%Y%m%d-%H%M%S}"
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{out}: cannot be made ({error.strerror}); choose another --out") from None
    return out.resolve()


def _show(outcome: Outcome) -> None:
    data = outcome.to_dict()
    table = Table("joint torque", "RMS (N·m)", title=f"demo on {outcome.bus}", title_justify="left")
    table.add_row("wanted", f"{data['rms']['wanted']:.4f}")
    table.add_row("error without compensation", f"{data['rms']['without']:.4f}")
    table.add_row("error with compensation", f"{data['rms']['with']:.4f}")
    console = Console()
    console.print(table)
    cycles = data["cycles"]
    console.print(
        f"cycles: {cycles['planned']} planned, {cycles['sent']} sent, {cycles['late']} late, "
        f"{cycles['missed_pdo']} PDOs missed"
    )
    console.print(f"log: {data['log']}", soft_wrap=True)
    console.print(f"picture: {data['picture']}", soft_wrap=True)
    click.echo(f"reduction: {outcome.reduction:.1f} %")
