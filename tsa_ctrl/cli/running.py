"""Commands to a running daemon over its socket: status, set, stop, dashboard and live."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import re
import sys
import time
from pathlib import Path

import click

from tsa_ctrl.cli.options import Finite
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc import protocol, server_process
from tsa_ctrl.ipc.client import MOST_RATE, Client, stop_daemon
from tsa_ctrl.ipc.parameters import of_unit
from tsa_ctrl.outputs import terminal

FOLLOW_PERIOD = 0.1  # s between two statuses of --follow
RECOVERY = 15.0  # s for the bring-up of a slow drive and the settling cycles
HELD = 2.0  # s of torque within which a remaining fault appears; a torn tendon throws the joint in less
POLL = 0.05  # s
PATIENCE = 0.5  # share of the wait after which the process also gets SIGTERM
DASHBOARD_NEEDS = ("starlette", "uvicorn")

SOCKET = click.option(
    "--socket", "path", default=protocol.default_path, show_default="this user's", help="Socket of the daemon."
)


@click.command(
    "status",
    epilog="Example: tsa status --json",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option("--once", is_flag=True, help="Print the page once, also on a terminal.")
@click.option(
    "--follow", is_flag=True, help="Print a status every 0.1 s until Ctrl-C; with --json one object per line."
)
@SOCKET
def status_command(as_json: bool, once: bool, follow: bool, path: str) -> None:
    """Show the state of a running daemon: a live page on a terminal, else once."""

    from tsa_ctrl.ipc.page import Page, watch  # rich's layouts are not needed for --json

    with Client(path) as client:
        if as_json:
            click.echo(json.dumps(client.ask(protocol.Status())))
            while follow:
                time.sleep(FOLLOW_PERIOD)
                click.echo(json.dumps(client.ask(protocol.Status())))
        elif once or not (sys.stdout.isatty() and sys.stdin.isatty()):
            page, console = Page(), terminal()
            page.take(client.ask(protocol.Status()))
            console.print(page.render())
            while follow:
                time.sleep(FOLLOW_PERIOD)
                page.take(client.ask(protocol.Status()))
                console.print(page.render())
        else:
            watch(client)


class _Assigning(click.Command):
    """A command that also accepts its NAME and VALUE as one argument NAME=VALUE."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and (pair := re.fullmatch(r"([A-Za-z][\w.-]*)=([^,]+)", args[0])):
            args = [*pair.groups(), *args[1:]]
        return super().parse_args(ctx, args)


@click.command(
    "set",
    cls=_Assigning,
    context_settings={"ignore_unknown_options": True},  # a negative VALUE is not an option
    epilog="Example: tsa set knee.compensation 0.9",
)
@click.argument("name")
@click.argument("value", type=Finite())
@click.option(
    "--against",
    type=Finite(),
    help="Compare VALUE (A) with this one (B) in alternating blocks, then restore the previous value.",
)
@click.option(
    "--with", "more", multiple=True, metavar="NAME=A,B", help="Another parameter of the two sets being compared."
)
@click.option(
    "--blocks", default=12, show_default=True, type=click.IntRange(6, 1000), help="Number of blocks of a comparison."
)
@click.option(
    "--block-seconds", default=4.0, show_default=True, type=Finite(1.0, 3600.0), help="Duration of each block, s."
)
@click.option("--json", "as_json", is_flag=True, help="The comparison as one JSON object on stdout.")
@SOCKET
def set_command(
    name: str,
    value: float,
    against: float | None,
    more: tuple[str, ...],
    blocks: int,
    block_seconds: float,
    as_json: bool,
    path: str,
) -> None:
    """Change a parameter of a running daemon within its bounds; it moves there smoothly.

    NAME is a parameter as `tsa status` lists them, with its axis before a dot where there are several axes: KNEE.slew.
    "recover 1" asks for a new start after a latched fault.

    With --against the joint torque errors of two values (or, with --with, sets of values) are compared on the motion
    that is running, and a verdict with its 95 % interval is given: tsa set compensation 0.8 --against 0.95
    """
    if more and against is None:
        raise UsageError("--with requires a comparison; also give --against")
    with Client(path) as client:
        if against is not None:
            sets = {"a": {name: value}, "b": {name: against}}
            for text in more:
                other, a, b = _pair(text)
                if other in sets["a"]:
                    raise UsageError(f"--with {text}: {other} already has two values; give each parameter once")
                sets["a"][other], sets["b"][other] = a, b
            _compare(client, sets, blocks, block_seconds, as_json)
            return
        if name == "recover":
            if value != 1.0:
                raise UsageError(f"recover {value:g}: the only value is 1, which requests a restart after a fault")
            click.echo(_recovered(client))
            return
        answer = client.ask(protocol.Set(name, value))
    stage = answer.get("waiting_for")
    waits = f"; takes effect when the axis runs (startup: {stage})" if stage else ""
    value_now = f"{answer['value']:g}{of_unit(answer['unit'])}"
    before = "-" if answer["before"] is None else f"{answer['before']:g}"
    click.echo(f"{answer['axis']}.{answer['name']}: {before} -> {value_now}{waits}")


def _recovered(client: Client) -> str:
    """Request a recovery and return its result.

    Raises:
        UsageError: No fault is latched, or this client may not request a recovery now.
        BusError: The recovery failed, or the rig does not run within RECOVERY, or does not run for HELD.
    """
    failed = client.ask(protocol.Status())["recovery"]["failed"]
    client.ask(protocol.Recover())
    end, running = time.monotonic() + RECOVERY, 0.0
    while True:
        status, now = client.ask(protocol.Status()), time.monotonic()
        if status["recovery"]["failed"] > failed and not running:
            events = sorted((*status["events"], *status["faults"]), key=lambda event: int(event["number"]))
            reason = events[-1]["text"] if events else "see its events"
            raise BusError(f"the recovery failed, phase {status['phase']}: {reason}; remove the cause, then repeat")
        if status["phase"] == "running":
            running = running or now
            if now - running >= HELD:
                return f"recovered: running for {HELD:g} s without a fault"
        elif running or now > end:
            causes = "; ".join(str(fault["text"]) for fault in status["faults"][-2:]) or "no fault is reported"
            how = "recovered, but stopped again" if running else f"not recovered after {RECOVERY:g} s"
            raise BusError(f"{how}, phase {status['phase']}: {causes}; remove the cause, then recover again")
        time.sleep(0.1)


def _pair(text: str) -> tuple[str, float, float]:
    name, _, values = text.partition("=")
    try:
        a, b = (Finite().convert(value, None, None) for value in values.split(","))
    except (ValueError, click.BadParameter):
        raise UsageError(f"--with: found '{text}'; write NAME=A,B, for example slew=60,90") from None
    return name, a, b


def _compare(
    client: Client, sets: dict[str, dict[str, float]], blocks: int, block_seconds: float, as_json: bool
) -> None:
    from tsa_ctrl.tune.comparison import LiveBlocks, alternate

    live = LiveBlocks(client, sets, block_seconds)
    live.check()
    try:
        found = alternate(
            blocks,
            live.apply,
            live.measure,
            lambda number, name, error: click.echo(
                f"block {number + 1}: {name.upper()} {1e3 * error:.1f} mN*m", err=True
            ),
        )
    finally:
        live.restore()
    click.echo(json.dumps(found.to_dict(), allow_nan=False) if as_json else found.verdict)


@click.command(
    "stop",
    epilog="Example: tsa stop",
)
@SOCKET
@click.option(
    "--wait",
    default=15.0,
    show_default=True,
    type=Finite(0.0),
    help="Time to wait for the daemon to end, s; 0: do not wait.",
)
def stop_command(path: str, wait: float) -> None:
    """Ramp a running daemon's torque to zero, disable its drives, and end it; this also ends one that is starting.

    If the request fails for any reason, the daemon's process gets SIGTERM, which has the same effect.
    """
    process = server_process.running(path)
    answer = stop_daemon(path)
    if "signalled" in answer:
        click.echo(f"{answer['reason']}\nstop: process {answer['signalled']} got SIGTERM instead", err=True)
    begun, signalled = time.monotonic(), "signalled" in answer
    while wait > 0.0 and (protocol.is_socket(path) if process is None else server_process.running(path) == process):
        waited = time.monotonic() - begun
        if waited > wait:
            raise BusError(
                f"{path}: the daemon received the stop request but still runs after {wait:g} s; check its output"
            )
        if not signalled and waited > PATIENCE * wait:
            signalled = True
            with contextlib.suppress(BusError):
                server_process.terminate(path)
        time.sleep(POLL)
    stage = answer.get("waiting_for")
    starting = f"; it was in startup: {stage}" if stage else ""
    click.echo(("stop requested" if wait == 0.0 else "stopped: the daemon has ended") + starting)


@click.command("dashboard", epilog="Example: tsa dashboard --port 8402")
@SOCKET
@click.option("--port", default=0, type=click.IntRange(0, 65535), show_default="a free one", help="Port on 127.0.0.1.")
def dashboard_command(path: str, port: int) -> None:
    """Open a local page to watch and tune a running daemon: torques, latency, state, faults, live parameters.

    Prints the address to open, with its token, and serves until Ctrl-C. Bound to the loopback address; it talks to the
    daemon over the local socket as `tsa status` and `tsa set` do. A change asks for a confirmation and can be undone.
    """
    missing = [name for name in DASHBOARD_NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise UsageError(f"{', '.join(missing)} not installed; pip install '.[dashboard]'")
    from tsa_ctrl.dashboard.server import serve

    serve(path, port, lambda address: click.echo(f"dashboard: {address}"))


@click.command("live", epilog="Example: tsa live --port 8765")
@SOCKET
@click.option(
    "--port",
    default=8765,
    show_default=True,
    type=click.IntRange(0, 65535),
    help="Port on 127.0.0.1; 0: a free one.",
)
@click.option("--rate", default=1000.0, show_default=True, type=Finite(1.0, MOST_RATE), help="Rate of the signals, Hz.")
@click.option("--settable", is_flag=True, help="Let every client on this computer change live parameters as this user.")
@click.option(
    "--layouts", "folder", type=click.Path(path_type=Path), help="Folder in which to write layouts for both programs."
)
def live_command(path: str, port: int, rate: float, settable: bool, folder: Path | None) -> None:
    """Publish a running daemon on a WebSocket that Foxglove and PlotJuggler can read, until Ctrl-C.

    Foxglove: open a connection to ws://localhost:8765. PlotJuggler: start the Foxglove Bridge streaming plugin.
    Topics: /AXIS/signals (each cycle), /AXIS/status, /joint_states, /events. Bound to the loopback address.
    """
    if importlib.util.find_spec("foxglove") is None:
        raise UsageError("foxglove-sdk not installed; pip install '.[live]'")
    from tsa_ctrl.live import Publisher, write_layouts

    publisher = Publisher(path, port, settable)
    try:
        for written in [] if folder is None else write_layouts(folder, publisher.axes):
            click.echo(f"written: {written}")
        click.echo(f"live: ws://127.0.0.1:{publisher.port}")
        publisher.run(rate)
    except KeyboardInterrupt:
        pass
    finally:
        publisher.close()
