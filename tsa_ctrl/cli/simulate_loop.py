"""`tsa simulate-loop`: the real loop and the real plant under one clock of their own."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl.cli.finite import Finite

if TYPE_CHECKING:
    from tsa_ctrl.virtual.result import Simulation


@click.command(
    "simulate-loop",
    epilog="Example: tsa simulate-loop config/controller.toml config/plant.toml --seconds 10 --out out/loop "
    "--fault 'torn_tendon@5'",
)
@click.argument("controller", type=click.Path(path_type=Path))
@click.argument("plant", type=click.Path(path_type=Path))
@click.option("--seconds", required=True, type=Finite(0.1, 86_400.0), help="Of torque.")
@click.option("--record", type=click.Path(path_type=Path), help="CSV of the plant's own truth, as of tsa plant.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the daemon's own log, tsa.mcap.")
@click.option("--seed", type=click.IntRange(0), help="Of all noise; default: the plant file's.")
@click.option(
    "--fault", "faults", multiple=True, metavar="LINE@T", help="As tsa plant --ask, or slow_loop (s per cycle), at T s."
)
@click.option("--set", "changes", multiple=True, metavar="NAME=VALUE@T", help="As tsa set, at T s.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(
    controller: Path,
    plant: Path,
    seconds: float,
    record: Path | None,
    out: Path | None,
    seed: int | None,
    faults: tuple[str, ...],
    changes: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run CONTROLLER.toml on PLANT.toml in virtual time: deterministic, faster than real time, no bus, no rights.

    T counts from the first cycle, as t in the log. Errors are the delivered joint torque (the plant's truth) less the
    one wanted, from the end of the fade-in on. A fault is a result, too: exit status 0.
    """
    from tsa_ctrl.virtual.simulation import simulate_loop  # the loop and the plant, not loaded for --help

    with _progress() as tick:
        simulation = simulate_loop(
            controller, plant, seconds, out=out, record=record, seed=seed, faults=faults, changes=changes, tick=tick
        )
    if as_json:
        click.echo(json.dumps(simulation.to_dict(), allow_nan=False))
    else:
        _show(simulation)


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[float], None]]:
    """The share of the time that has gone, on stderr where that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("simulating", total=1.0)
        yield lambda share: progress.update(task, completed=share)


def _show(simulation: Simulation) -> None:
    from rich.console import Console
    from rich.table import Table

    data = simulation.to_dict()
    columns = ("axis", "RMS error (mN·m)", "99 %", "peak", "joint speed RMS (rad/s)", "peak", "state")
    table = Table(*columns, title=f"{simulation.seconds:g} s in virtual time", title_justify="left")
    for axis in data["axes"]:
        errors = ("-" if axis[key] is None else f"{1e3 * axis[key]:.1f}" for key in ("rms", "p99", "peak"))
        speeds = ("-" if axis[key] is None else f"{axis[key]:.3f}" for key in ("joint_speed_rms", "joint_speed_peak"))
        table.add_row(axis["name"], *errors, *speeds, axis["state"])
    console = Console()
    console.print(table)
    for event in simulation.summary.events:
        console.print(str(event), style="red" if event.fault else None, highlight=False, markup=False)
    for note in simulation.notes:
        console.print(f"note: {note}", soft_wrap=True, highlight=False, markup=False)
    for name in ("log", "record"):
        if data[name] is not None:
            console.print(f"{name}: {data[name]}", soft_wrap=True, highlight=False, markup=False)
