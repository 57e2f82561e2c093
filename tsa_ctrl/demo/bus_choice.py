"""The best bus that this machine has: a vcan that is there, one that this user may make, else UDP multicast."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass

from tsa_ctrl.bus.wire.link import can_interfaces
from tsa_ctrl.errors import UsageError


@dataclass(frozen=True)
class BusChoice:
    """An interface and channel of python-can; `name` is said to people."""

    interface: str
    channel: str

    @property
    def name(self) -> str:
        return self.channel if self.interface == "socketcan" else f"{self.interface} {self.channel}"


def choose(asked: str | None = None) -> BusChoice:
    """The bus asked for (a CAN interface, or INTERFACE:CHANNEL of python-can), else the best there is.

    Raises UsageError when a CAN interface that was asked for does not exist or is down.
    """
    if asked is not None:
        if ":" in asked:
            interface, _, channel = asked.partition(":")
            return BusChoice(interface, channel)
        there = can_interfaces()
        if asked not in there:
            names = ", ".join(there) or "none"
            raise UsageError(f"demo: no CAN interface {asked} that is up; up are: {names}; or leave --bus out")
        return BusChoice("socketcan", asked)
    named = os.environ.get("TSA_VCAN")
    virtual = [name for name, link in can_interfaces().items() if link.kind == "vcan"]
    if named in virtual:
        return BusChoice("socketcan", str(named))
    if virtual:
        return BusChoice("socketcan", virtual[0])
    if _make_vcan("vcan0"):
        return BusChoice("socketcan", "vcan0")
    return BusChoice("udp_multicast", "239.255.{}.{}".format(*os.urandom(2)))  # RFC 2365; no two demos hear each other


def _make_vcan(name: str) -> bool:
    """Whether this user could make a vcan; nothing is left behind where not."""
    if shutil.which("ip") is None:
        return False
    for command in (["ip", "link", "add", "dev", name, "type", "vcan"], ["ip", "link", "set", name, "up"]):
        if subprocess.run(command, capture_output=True, check=False).returncode != 0:
            return False
    return True
