"""The best bus that this machine has: a vcan that is there, one that this user may make, else UDP multicast."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import dataclass

from tsa_ctrl.errors import UsageError

MULTICAST_GROUP = "239.74.163.2"  # python-can's udp_multicast; stays on this machine's networks


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
        if asked not in _up_interfaces():
            there = ", ".join(_up_interfaces()) or "none"
            raise UsageError(f"demo: no CAN interface {asked} that is up; up are: {there}; or leave --bus out")
        return BusChoice("socketcan", asked)
    named = os.environ.get("TSA_VCAN")
    virtual = [name for name, kind in _up_interfaces().items() if kind == "vcan"]
    if named in virtual:
        return BusChoice("socketcan", str(named))
    if virtual:
        return BusChoice("socketcan", virtual[0])
    if _make_vcan("vcan0"):
        return BusChoice("socketcan", "vcan0")
    return BusChoice("udp_multicast", MULTICAST_GROUP)


def _up_interfaces() -> dict[str, str]:
    """CAN interfaces that are up, with their kind ("vcan", "can", ...)."""
    if shutil.which("ip") is None:
        return {}
    run = subprocess.run(["ip", "-details", "-json", "link", "show"], capture_output=True, text=True, check=False)
    if run.returncode != 0:
        return {}
    return {
        link["ifname"]: link.get("linkinfo", {}).get("info_kind", "can")
        for link in json.loads(run.stdout or "[]")
        if link.get("link_type") == "can" and "UP" in link.get("flags", [])
    }


def _make_vcan(name: str) -> bool:
    """Whether this user could make a vcan; nothing is left behind where not."""
    if shutil.which("ip") is None:
        return False
    for command in (["ip", "link", "add", "dev", name, "type", "vcan"], ["ip", "link", "set", name, "up"]):
        if subprocess.run(command, capture_output=True, check=False).returncode != 0:
            return False
    return True
