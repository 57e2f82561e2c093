"""Where the demo's runs take place: plant and daemon as processes on a bus, or both in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tsa_ctrl.demo.bus_choice import BusChoice
from tsa_ctrl.system.processes import daemon, plant

Run = Callable[[Path, str, float, Callable[[float], None]], dict[str, Any]]  # folder, name, seconds, tick: a summary


def runs_on(bus: BusChoice) -> Run:
    """What runs `controller-NAME.toml` on `plant.toml` of a folder, the plant anew, and returns the run's summary."""
    if bus.virtual:
        from tsa_ctrl.virtual.stage import play  # the loop and the plant in this process

        return play
    return _on_the_bus


def _on_the_bus(folder: Path, name: str, seconds: float, tick: Callable[[float], None]) -> dict[str, Any]:
    with plant(folder):
        return daemon(folder, name, seconds, tick)
