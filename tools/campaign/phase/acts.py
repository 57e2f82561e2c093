"""Acts of another node on the bus or of the computer for which the plant has no fault."""

from __future__ import annotations

from collections.abc import Callable

from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.virtual.lockstep import Wire

HANG = 0.3  # s: longer than every time-out
HITCH = 0.01  # s: shorter than the shortest, 20 ms
DEAD = 0.6  # s that are looked on after the loop died
REBOOT = 0.03  # s of a drive without power


class DiedError(Exception):
    """The loop is gone, and the trial is over."""


def _foreign(machine: Machine, wire: Wire, can_id: int, data: bytes) -> None:
    """A frame that everybody hears."""
    machine.inject(can_id, data)
    machine.handle(can_id, data, wire.now)


def sync(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x080, b"")


def counted_sync(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x080, b"\x05")


def command(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x201, bytes.fromhex("0f00e803"))  # enabled, at rated torque


def reset(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x000, bytes((0x82, 32)))


def sdo(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x601, bytes.fromhex("2b00140500000000"))  # 0x1400:5 = 0: no time-out of commands


def hang(machine: Machine, wire: Wire) -> None:
    wire.pass_until(wire.now + HANG)


def hitch(machine: Machine, wire: Wire) -> None:
    wire.pass_until(wire.now + HITCH)


def die(machine: Machine, wire: Wire) -> None:
    wire.pass_until(wire.now + DEAD)
    raise DiedError


def exchange(machine: Machine, wire: Wire) -> None:
    """Two equal drives lose their power, and somebody exchanges their plugs."""
    one, two = (unit.drive for unit in machine.axes[:2])
    nodes = [unit.by_kind["drive"] for unit in machine.axes[:2]]
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

    machine.later(wire.now + REBOOT, on)


ACTS: dict[str, Callable[[Machine, Wire], None]] = {
    act.__name__: act for act in (sync, counted_sync, command, reset, sdo, hang, hitch, die, exchange)
}
