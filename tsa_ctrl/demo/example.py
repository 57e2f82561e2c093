"""A log to try the diagnosis on: the real loop on the simulated plant in virtual time, with a cause hidden in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.hidden import SECONDS, Hidden, draw, motion
from tsa_ctrl.demo.rig import VIRTUAL, BusChoice
from tsa_ctrl.errors import BusError
from tsa_ctrl.system.process_supervisor import daemon, plant

Run = Callable[[Path, str, float, Callable[[float], None]], dict[str, Any]]  # folder, name, seconds, tick: a summary


def runs_on(bus: BusChoice) -> Run:
    """Return a function that runs `controller-NAME.toml` of a folder on a new plant, and returns the run's summary.

    Plant and daemon run as processes on the bus, or both in this process in virtual time.
    """
    if bus.virtual:
        from tsa_ctrl.virtual.simulation import play  # the loop and the plant in this process

        return play
    return _on_the_bus


def _on_the_bus(folder: Path, name: str, seconds: float, tick: Callable[[float], None]) -> dict[str, Any]:
    with plant(folder):
        return daemon(folder, name, seconds, tick)


RATE = 500.0  # Hz: what the diagnosis needs of these motions, at half the time of 1 kHz


@dataclass(frozen=True)
class Example:
    """Hold the paths of the log and of the model file without the hidden cause, and that cause."""

    log: Path
    model: Path
    hidden: Hidden

    def told(self) -> str:
        """What was hidden, for the end."""
        sizes = "; ".join(
            f"{name} with "
            + ", ".join(
                f"{key} {value}" if isinstance(value, str) else f"{key} {value:.3g}" for key, value in values.items()
            )
            for name, values in self.hidden.effects.items()
        )
        factors = ", ".join(
            f"{key.replace('_', ' ')} {100 * (value - 1):+.0f} %" for key, value in self.hidden.factors.items()
        )
        return f"{sizes}; and against the model file {factors}"


def make(folder: Path, seed: int) -> Example:
    """Write the files and run them; the same seed hides the same. Raises BusError when the loop ends in a fault."""
    hidden = draw(seed)
    controllers = {"example": rig.controller(VIRTUAL, "example", RATE, "nominal.toml", 0.0)}
    rig.write(folder, motion(), rig.plant(VIRTUAL, "full", hidden.axis()), controllers)
    summary = runs_on(VIRTUAL)(folder, "example", SECONDS, lambda share: None)
    if summary["log"] is None or summary["failed"]:
        raise BusError(f"diagnose --example: the run failed: {summary['cause']}")
    return Example(folder / str(summary["log"]), folder / "nominal.toml", hidden)
