"""`tsa simulate-loop`: run the real loop on the simulated plant under one virtual clock."""

from __future__ import annotations

import json
import tempfile
import zipfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl.cli.options import Finite, progress_bar
from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import terminal

if TYPE_CHECKING:
    from tsa_ctrl.virtual.result import Simulation

SIMULATING = "simulating"
NO_SECONDS = "--seconds is missing; give the duration with torque in s"
MOST_LOG = 4_000_000_000  # bytes of a log in a field report: some hours of four axes


@click.command(
    "simulate-loop",
    epilog="Example: tsa simulate-loop config/controller.toml config/plant.toml --seconds 10 --out out/loop "
    "--fault 'torn_tendon@5'",
)
@click.argument("controller", type=click.Path(path_type=Path))
@click.argument("plant", required=False, type=click.Path(path_type=Path))
@click.option(
    "--seconds", type=Finite(0.1, 86_400.0), help="Duration with torque; required unless a virtual run is repeated."
)
@click.option(
    "--record", type=click.Path(path_type=Path), help="CSV of the plant's true values, as written by tsa plant."
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the daemon's log, tsa.mcap.")
@click.option("--seed", type=click.IntRange(0), help="Seed of all noise; default: the value in the plant file.")
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="LINE@T",
    help="Fault at T s: a line as for tsa plant --ask, or slow_loop (s per cycle).",
)
@click.option(
    "--set", "changes", multiple=True, metavar="NAME=VALUE@T", help="Parameter change at T s, as with tsa set."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(
    controller: Path,
    plant: Path | None,
    seconds: float | None,
    record: Path | None,
    out: Path | None,
    seed: int | None,
    faults: tuple[str, ...],
    changes: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run CONTROLLER.toml on PLANT.toml in virtual time: deterministic, faster than real time, no bus, no rights.

    T counts from the first cycle, as t in the log. Errors are the delivered joint torque (the plant's truth) less the
    desired one, from the end of the fade-in on. The exit status is 0 after a fault as well.

    In place of CONTROLLER.toml, a field report (tsa bundle) or the log of a virtual run: the run is repeated with its
    files and arguments, and each record is compared with the log.
    """
    from tsa_ctrl.virtual.simulation import simulate_loop  # imports loop and plant, which --help does not need

    if controller.suffix.lower() in (".zip", ".mcap"):
        simulation = _repeated(controller, plant, seconds, record, out, seed, faults, changes)
    elif plant is None:
        raise UsageError("PLANT.toml is missing; give the file of the simulated machine after CONTROLLER.toml")
    elif seconds is None:
        raise UsageError(NO_SECONDS)
    else:
        with progress_bar(SIMULATING) as say:
            tick = partial(say, SIMULATING)
            simulation = simulate_loop(
                controller, plant, seconds, out=out, record=record, seed=seed, faults=faults, changes=changes, tick=tick
            )
    if as_json:
        click.echo(json.dumps(simulation.to_dict(), allow_nan=False))
    else:
        _show(simulation)


def _repeated(
    report: Path,
    plant: Path | None,
    seconds: float | None,
    record: Path | None,
    out: Path | None,
    seed: int | None,
    faults: tuple[str, ...],
    changes: tuple[str, ...],
) -> Simulation:
    """Repeat the run of a field report or log, and report if its records are equal."""
    from tsa_ctrl.virtual.script import Replay, first_difference
    from tsa_ctrl.virtual.simulation import simulate_loop

    with tempfile.TemporaryDirectory() as folder:
        log = report if report.suffix.lower() == ".mcap" else _log_of(report, Path(folder))
        files = Path(folder, "files")
        files.mkdir()
        replay = Replay(log, files)
        changed = plant is not None or seconds is not None or seed is not None or bool(faults or changes)
        on, old = plant or replay.plant, replay.arguments
        if on is None:
            raise UsageError(
                f"{report}: is from a run on hardware; give a PLANT.toml to run its files on, and --seconds"
            )
        duration = seconds if seconds is not None or old is None else old.seconds
        if duration is None:
            raise UsageError(NO_SECONDS)
        with progress_bar(SIMULATING) as say:
            simulation = simulate_loop(
                replay.controller,
                on,
                duration,
                out=out,
                record=record,
                seed=seed if seed is not None or old is None else old.seed,
                faults=faults or (old.faults if old else ()),
                changes=changes or (old.changes if old else ()),
                tick=partial(say, SIMULATING),
            )
        if changed:
            click.echo("not compared with the log: the arguments differ", err=True)
        elif difference := first_difference(log, {axis.name: axis.log for axis in simulation.axes}):
            click.echo(f"differs from the log: {difference}", err=True)
        else:
            click.echo("every record is identical to the log, bit by bit", err=True)
        return simulation


def _log_of(report: Path, folder: Path) -> Path:
    """Extract the log of a field report to a folder and return its path; raise UsageError for another file."""
    if not report.is_file():
        raise UsageError(f"{report}: no such file; give a field report written by tsa bundle")
    try:
        with zipfile.ZipFile(report) as archive:
            size = archive.getinfo("log.mcap").file_size
            if size > MOST_LOG:
                raise UsageError(f"{report}: its log has {size / 1e9:.1f} GB; at most {MOST_LOG / 1e9:g} GB is allowed")
            return Path(archive.extract("log.mcap", folder))
    except UsageError:
        raise
    except Exception as error:  # zipfile and each compression have their own errors for damage and encryption
        reason = str(error) or "it ends early"
        raise UsageError(f"{report}: not a field report ({reason}); give a file that tsa bundle wrote") from None


def _show(simulation: Simulation) -> None:
    from rich.table import Column, Table

    data = simulation.to_dict()
    columns = ("axis", "RMS error", "99 %", "peak error", "RMS speed", "peak speed", Column("state", no_wrap=True))
    title = f"{simulation.seconds:g} s in virtual time; error of the joint torque in mN·m, joint speed in rad/s"
    table = Table(*columns, title=title, title_justify="left")
    for axis in data["axes"]:
        errors = ("-" if axis[key] is None else f"{1e3 * axis[key]:.1f}" for key in ("rms", "p99", "peak"))
        speeds = ("-" if axis[key] is None else f"{axis[key]:.3f}" for key in ("joint_speed_rms", "joint_speed_peak"))
        table.add_row(axis["name"], *errors, *speeds, axis["state"])
    console = terminal()
    console.print(table)
    for event in simulation.summary.events:
        console.print(str(event), style="red" if event.fault else None)
    for note in simulation.notes:
        console.print(f"note: {note}", soft_wrap=True)
    for name in ("log", "record"):
        if data[name] is not None:
            console.print(f"{name}: {data[name]}", soft_wrap=True)
