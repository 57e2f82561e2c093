"""What somebody else on the bus or the computer does, where the plant has no fault for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tools.campaign.phase.stage import Stage

HANG = 0.3  # s: longer than every time-out
HITCH = 0.01  # s: shorter than the shortest, 20 ms
DEAD = 0.6  # s that are looked on after the loop died
REBOOT = 0.03  # s of a drive without power


class DiedError(Exception):
    """Nobody controls any more; the trial is over."""


def _foreign(stage: Stage, can_id: int, data: bytes) -> None:
    """A frame that everybody hears."""
    stage.machine.inject(can_id, data)
    stage.machine.handle(can_id, data, stage.wire.now)


def sync(stage: Stage) -> None:
    _foreign(stage, 0x080, b"")


def counted_sync(stage: Stage) -> None:
    _foreign(stage, 0x080, b"\x05")


def command(stage: Stage) -> None:
    _foreign(stage, 0x201, bytes.fromhex("0f00e803"))  # enabled, at rated torque


def reset(stage: Stage) -> None:
    _foreign(stage, 0x000, bytes((0x82, 32)))


def sdo(stage: Stage) -> None:
    _foreign(stage, 0x601, bytes.fromhex("2b00140500000000"))  # 0x1400:5 = 0: no time-out of commands


def hang(stage: Stage) -> None:
    stage.wire.pass_until(stage.wire.now + HANG)


def hitch(stage: Stage) -> None:
    stage.wire.pass_until(stage.wire.now + HITCH)


def die(stage: Stage) -> None:
    stage.wire.pass_until(stage.wire.now + DEAD)
    stage.over = True
    raise DiedError


def recover(stage: Stage) -> None:
    stage.recover()


def exchange(stage: Stage) -> None:
    """Two equal drives lose their power, and somebody exchanges their plugs."""
    one, two = (unit.drive for unit in stage.machine.axes[:2])
    nodes = [unit.by_kind["drive"] for unit in stage.machine.axes[:2]]
    for node in nodes:
        node.power_off()
    one.readings, two.readings = two.readings, one.readings
    one.command, two.command = two.command, one.command
    one.before_change, two.before_change = two.before_change, one.before_change
    numbers = [node.values[0x1018, 4] for node in nodes]
    for node, number in zip(nodes, reversed(numbers), strict=True):
        node.values[0x1018, 4] = number

    def on(now: float) -> None:
        for node in nodes:
            node.boot(now)

    stage.machine.later(stage.wire.now + REBOOT, on)


ACTS: dict[str, Callable[[Stage], None]] = {
    act.__name__: act for act in (sync, counted_sync, command, reset, sdo, hang, hitch, die, recover, exchange)
}
