"""`tsa set`."""

from __future__ import annotations

import json
import time

import click

from tsa_ctrl.cli.options import Finite
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.parameters import of_unit

RECOVERY = 15.0  # s: a bring-up of a slow drive, and the cycles that settle
HELD = 2.0  # s of torque in which a remaining fault shows: a torn tendon throws the joint in less


@click.command(
    "set",
    context_settings={"ignore_unknown_options": True},  # a negative VALUE is not an option
    epilog="Example: tsa set knee.compensation 0.9",
)
@click.argument("name")
@click.argument("value", type=Finite())
@click.option(
    "--against", type=Finite(), help="Compare VALUE (A) with this one (B) in alternating blocks, then put back."
)
@click.option("--with", "more", multiple=True, metavar="NAME=A,B", help="A further parameter of the two sets compared.")
@click.option("--blocks", default=12, show_default=True, type=click.IntRange(6, 1000), help="Of a comparison.")
@click.option(
    "--block-seconds", default=4.0, show_default=True, type=Finite(1.0, 3600.0), help="Duration of each block, s."
)
@click.option("--json", "as_json", is_flag=True, help="The comparison as one JSON object on stdout.")
@click.option("--socket", "path", default=protocol.default_path, show_default="this user's", help="Its socket.")
def command(
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
        raise UsageError("--with belongs to a comparison; also give --against")
    with Client(path) as client:
        if against is not None:
            sets = {"a": {name: value}, "b": {name: against}}
            for text in more:
                other, a, b = _pair(text)
                if other in sets["a"]:
                    raise UsageError(f"--with {text}: {other} has two values already; name each parameter once")
                sets["a"][other], sets["b"][other] = a, b
            _compare(client, sets, blocks, block_seconds, as_json)
            return
        if name == "recover":
            if value != 1.0:
                raise UsageError(f"recover {value:g}: only 1 is possible, it asks for a new start after a fault")
            click.echo(_recovered(client))
            return
        answer = client.ask(protocol.Set(name, value))
    stage = answer.get("waiting_for")
    waits = f"; takes effect when the axis runs, startup waits for: {stage}" if stage else ""
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
            reasons = [event["text"] for event in status["events"] if event["text"].startswith("recovery failed")]
            reason = (reasons or [fault["text"] for fault in status["faults"]] or ["see its events"])[-1]
            raise BusError(f"the recovery failed, phase {status['phase']}: {reason}; remedy that, then repeat")
        if status["phase"] == "running":
            running = running or now
            if now - running >= HELD:
                return f"recovered: running, and nothing was found for {HELD:g} s"
        elif running or now > end:
            causes = "; ".join(str(fault["text"]) for fault in status["faults"][-2:]) or "no fault is reported"
            how = "recovered, but not for long" if running else f"not recovered after {RECOVERY:g} s"
            raise BusError(f"{how}, phase {status['phase']}: {causes}; remove its reason, then recover again")
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
