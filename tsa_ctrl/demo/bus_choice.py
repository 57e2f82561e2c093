"""The best bus that this machine has: a vcan that is there, one that this user may make, else UDP multicast."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

from tsa_ctrl.bus.wire.link import can_interfaces, make_vcan, set_up
from tsa_ctrl.errors import UsageError


@dataclass(frozen=True)
class BusChoice:
    """An interface and channel of python-can, or virtual time; `name` is said to people."""

    interface: str
    channel: str
    virtual: bool = False  # no bus at all; interface and channel are what the files name, to be run on one later

    @property
    def name(self) -> str:
        if self.virtual:
            return "virtual time"
        return self.channel if self.interface == "socketcan" else f"{self.interface} {self.channel}"


VIRTUAL = BusChoice("socketcan", "vcan0", virtual=True)


def choose(asked: str | None = None, say: Callable[[str], None] = lambda line: None) -> BusChoice:
    """The bus asked for (a CAN interface, or INTERFACE:CHANNEL of python-can), else the best there is.

    A vcan that is down is brought up; where this user may not, `say` is told, and another bus is taken. Raises
    UsageError when a CAN interface that was asked for does not exist or is down.
    """
    there = can_interfaces()
    up = [name for name, link in there.items() if link.up]
    if asked is not None:
        if ":" in asked:
            interface, _, channel = asked.partition(":")
            return BusChoice(interface, channel)
        if asked in there and asked not in up:
            raise UsageError(
                f"demo: CAN interface {asked} is down; bring it up (ip link set {asked} up), or leave --bus out"
            )
        if asked not in there:
            names = ", ".join(up) or "none"
            raise UsageError(f"demo: no CAN interface {asked}; up are: {names}; or leave --bus out")
        return BusChoice("socketcan", asked)
    named = os.environ.get("TSA_VCAN")
    virtual = sorted((name for name, link in there.items() if link.kind == "vcan"), key=lambda name: name != named)
    for name in sorted(virtual, key=lambda name: name not in up):
        try:
            if name not in up:
                set_up(name, True)
        except OSError as error:
            reason = error.strerror or error
            say(f"demo: {name} is down and cannot be brought up ({reason}): ip link set {name} up; goes on without it")
        else:
            return BusChoice("socketcan", name)
    if not virtual:
        try:
            make_vcan("vcan0")
        except OSError:  # no right to it, or no such kind of link: nobody was promised one
            pass
        else:
            return BusChoice("socketcan", "vcan0")
    return BusChoice("udp_multicast", "239.255.{}.{}".format(*os.urandom(2)))  # RFC 2365; no two demos hear each other
