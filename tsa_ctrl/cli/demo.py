"""`tsa demo`: run the whole system on this machine."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from tsa_ctrl.cli.options import Finite, progress_bar
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.outputs import make_folder, terminal, untaken

if TYPE_CHECKING:
    from tsa_ctrl.demo.circle import Circle
    from tsa_ctrl.demo.outcome import Outcome
    from tsa_ctrl.demo.rig import BusChoice
    from tsa_ctrl.demo.run import Progress

Shown = TypeVar("Shown")

SECONDS = 11.0  # s, of a gait and of a sine; the load "wearer" takes longer
LOADS = ("imposed", "held", "free", "spring", "weight", "limb", "wearer")
FULL_SECONDS = 20.0  # s, the period of the motion
STAGE_WORDS = {
    "none": "without compensation",
    "nominal": "nominal model",
    "calibrated": "calibrated on the nominal run",
    "extended": "extended by the diagnosis of that run",
    "true": "true parameters (best possible)",
}


@click.command("demo", epilog="Example: tsa demo --seconds 10 --out out/demo")
@click.option("--setpoint", type=click.Path(path_type=Path), help="CSV with t, tau_j_des and q_j; default: a gait.")
@click.option(
    "--seconds",
    type=Finite(3.0, 3600.0),
    help=f"Torque per run.  [default: {SECONDS:g}; --load wearer 14; --full {FULL_SECONDS:g}]",
)
@click.option(
    "--rate",
    type=Finite(50.0, 4000.0),
    help="Rate of the loop, Hz.  [default: 1000]",
)
@click.option("--bus", help="CAN interface, or INTERFACE:CHANNEL; default: the best available.")
@click.option("--virtual", is_flag=True, help="Run in virtual time: no bus, no special rights, faster than real time.")
@click.option("--load", type=click.Choice(LOADS), default="imposed", show_default=True, help="Load of the joint.")
@click.option(
    "--tendon", type=click.Choice(["full", "distributed"]), help="Tendon model of the plant.  [default: distributed]"
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder for files, logs and picture; default: out/demo-DATE."
)
@click.option(
    "--leg", is_flag=True, help="Simulate hip, knee and ankle, which bend each other's sheaths, in virtual time."
)
@click.option("--full", is_flag=True, help="Full circle: hide an effect, run, calibrate, diagnose, run again.")
@click.option(
    "--seed",
    default=1,
    show_default=True,
    type=click.IntRange(0),
    help="With --full: seed that selects the hidden effect.",
)
@click.option(
    "--hidden",
    multiple=True,
    metavar="EFFECT",
    help="With --full: hide this effect (repeatable); the seed sets its size.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(
    setpoint: Path | None,
    seconds: float | None,
    rate: float | None,
    bus: str | None,
    virtual: bool,
    load: str,
    tendon: str | None,
    out: Path | None,
    leg: bool,
    full: bool,
    seed: int,
    hidden: tuple[str, ...],
    as_json: bool,
) -> None:
    """Simulated drive and joint on a bus, the daemon, a set-point: what compensation gains.

    An imposed joint follows a gait whatever its torque is; the others are held or move by the delivered torque, so
    their motion "without compensation" is another one.

    With --full: five runs on a plant with a hidden effect (without compensation, with the nominal, the calibrated, the
    extended and the true model), the models estimated from the nominal run's log.
    """
    given = _given()
    if leg:
        if given - {"leg", "seconds", "virtual", "out", "as_json"}:
            raise UsageError("demo: --leg can only be combined with --seconds, --virtual, --out and --json")
        _leg(seconds, out, as_json)
        return
    if full:
        if given & {"setpoint", "tendon", "load"}:
            raise UsageError("demo: --full has its own motion and tendons; omit --setpoint, --tendon and --load")
        _full_circle(seed, hidden, FULL_SECONDS if seconds is None else seconds, rate, bus, virtual, out, as_json)
        return
    if given & {"hidden", "seed"}:
        raise UsageError("demo: --hidden and --seed require --full; add --full")
    from tsa_ctrl.demo import rig  # imports plant, loop and pictures, which --help does not need
    from tsa_ctrl.demo.rig import from_file, play_for
    from tsa_ctrl.demo.run import demo

    play = play_for(load) if setpoint is None else from_file(setpoint, rig.MOST_TORQUE)
    seconds = play.seconds if seconds is None else seconds
    chosen = _bus(bus, virtual)
    folder = _folder(out)

    def show(where: BusChoice, say: Progress) -> Outcome:
        return demo(folder, where, play, seconds, rate, tendon or "distributed", say, load)

    outcome = _shown(show, chosen, asked=bus is not None)
    if as_json:
        click.echo(json.dumps(outcome.to_dict(), allow_nan=False))
    else:
        _show(outcome)


def _given() -> set[str]:
    """Return the names of the parameters that are on the command line."""
    context = click.get_current_context()
    return {
        name for name in context.params if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
    }


def _leg(seconds: float | None, out: Path | None, as_json: bool) -> None:
    """Run the leg without compensation, without routing and with both, and print a table."""
    from tsa_ctrl.cli import init
    from tsa_ctrl.demo.leg import FIXED, FOLLOWED, SECONDS, WITHOUT, demo
    from tsa_ctrl.demo.rig import VIRTUAL

    folder = _folder(out)
    texts, motions = init.leg()
    init.write(folder, {**texts, **motions})
    with progress_bar(f"demo on {VIRTUAL.name}") as say:
        found = demo(folder, SECONDS if seconds is None else seconds, say)
    if as_json:
        click.echo(json.dumps(found.to_dict(), allow_nan=False))
        return
    from rich.table import Table

    table = Table("joint", "without compensation", "without routing", "with routing", title="RMS error, mN·m")
    for name in found.runs[FOLLOWED]:
        table.add_row(name, *(f"{1e3 * found.runs[run][name].rms:.0f}" for run in (WITHOUT, FIXED, FOLLOWED)))
    terminal().print(table)
    click.echo(f"picture: {found.picture}")
    click.echo(f"reduction: {found.reduction:.1f} %")


def _shown(show: Callable[[BusChoice, Progress], Shown], chosen: BusChoice, asked: bool) -> Shown:
    """Run `show` on the bus, or in virtual time if real time fails on a bus that the user did not request."""
    from tsa_ctrl.demo.rig import VIRTUAL

    try:
        with progress_bar(f"demo on {chosen.name}") as say:
            return show(chosen, say)
    except BusError as error:
        if chosen.virtual:
            raise
        if asked:
            raise BusError(f"{error}; tsa demo --virtual runs the same without a bus") from None
        click.echo(f"demo on {chosen.name}: {error}; continuing in virtual time, without a bus", err=True)
    with progress_bar(f"demo on {VIRTUAL.name}") as say:
        return show(VIRTUAL, say)


def _bus(asked: str | None, virtual: bool) -> BusChoice:
    from tsa_ctrl.demo.rig import VIRTUAL, choose

    if not virtual:
        return choose(asked, lambda line: click.echo(line, err=True))
    if asked is not None:
        raise UsageError(f"demo: --virtual with --bus {asked}: virtual time has no bus; omit one of them")
    return VIRTUAL


def _full_circle(
    seed: int,
    names: tuple[str, ...],
    seconds: float,
    rate: float | None,
    bus: str | None,
    virtual: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    from tsa_ctrl.demo.circle import circle  # the diagnosis is slow to import
    from tsa_ctrl.demo.example import draw
    from tsa_ctrl.demo.run import RATE

    hidden = draw(seed, names)
    chosen = _bus(bus, virtual)
    folder = _folder(out)

    def show(where: BusChoice, say: Progress) -> Circle:
        return circle(folder, where, hidden, seconds, rate or RATE, say)

    found = _shown(show, chosen, asked=bus is not None)
    if as_json:
        click.echo(json.dumps({**found.to_dict(), "folder": str(folder)}, allow_nan=False))
    else:
        _show_circle(found, folder)


def _folder(out: Path | None) -> Path:
    out = untaken(Path("out"), "demo") if out is None else out
    make_folder(out)
    return out.resolve()


def _show(outcome: Outcome) -> None:
    from rich.table import Table

    data = outcome.to_dict()
    table = Table("joint torque", "RMS (N·m)", title=f"demo on {outcome.bus}", title_justify="left")
    table.add_row("desired", f"{data['rms']['wanted']:.4f}")
    table.add_row("error without compensation", f"{data['rms']['without']:.4f}")
    table.add_row("error with compensation", f"{data['rms']['with']:.4f}")
    console = terminal()
    console.print(table)
    cycles = data["cycles"]
    console.print(
        f"cycles: {cycles['planned']} planned, {cycles['sent']} sent, {cycles['late']} late, "
        f"{cycles['missed_pdo']} PDOs missed"
    )
    if cycles["planned"] > cycles["sent"]:
        console.print(
            f"{cycles['planned'] - cycles['sent']} cycles were skipped because the machine woke the loop after their "
            "time; the torque was held during them",
            soft_wrap=True,
        )
    console.print(f"log: {data['log']}", soft_wrap=True)
    console.print(f"picture: {data['picture']}", soft_wrap=True)
    click.echo(f"reduction: {outcome.reduction:.1f} %")


def _show_circle(circle: Circle, folder: Path) -> None:
    """Print the hidden effect, the result, and the error of each stage; `folder` contains all files."""
    from rich.table import Table

    from tsa_ctrl.demo.circle import STAGES

    console = terminal()
    table = Table("run", "RMS error (mN·m)", title=f"full circle on {circle.bus}", title_justify="left")
    for stage in STAGES:
        table.add_row(STAGE_WORDS[stage], f"{1e3 * circle.rms(stage):.1f}")
    console.print(table)
    for line in (
        f"hidden: {circle.hidden.name}",
        f"found: {circle.found} ({circle.diagnosis.verdict.value})",
        circle.diagnosis.sentence,
        *(f"note: {note}" for note in circle.notes),
        f"all files: {folder}",
    ):
        console.print(line, soft_wrap=True)
    console.print(f"share of the reachable reduction: {100.0 * circle.share('none'):.1f} %")
