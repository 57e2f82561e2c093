"""Hold the results of a simulated run: log and truth as arrays, and the error of the delivered joint torque."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.daemon.build import STATES
from tsa_ctrl.daemon.summary import Summary
from tsa_ctrl.display import Displayed, axis_label, lines
from tsa_ctrl.outputs import json_types
from tsa_ctrl.safety.limiter import Reason

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Columns = dict[str, NDArray[np.float64]]

SCHEMA = 1


@dataclass(frozen=True, repr=False)
class AxisResult(Displayed):
    """Hold the results of one axis.

    `log` and `truth` by column name, (n,) and (m,); `start` is the truth's `clock` at t = 0 of the log.
    """

    name: str
    log: Columns
    truth: Columns
    start: float  # s
    fade_in: float  # s
    until: float  # s of the log, at which the run began to stop
    faults: tuple[str, ...]

    @cached_property
    def delivered(self) -> NDArray[np.float64]:
        """Return the joint torque that the plant delivers at each cycle's SYNC, N*m, (n,)."""
        clock = self.truth["clock"]
        rows = np.searchsorted(clock, self.start + self.log["t"] + self.log["lateness"])
        return self.truth["tau_j"][np.minimum(rows, clock.size - 1)]

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """Return the mask (n,) of cycles whose errors count: with torque, after a fade-in and before the stop."""
        t, reason = self.log["t"], self.log["limit_reason"]
        on = (reason != Reason.DISABLED.value) & (t < self.until)
        begins = np.flatnonzero(on & ~np.concatenate(([False], on[:-1])))
        counted: NDArray[np.bool_] = on.copy()
        for begin in begins.tolist():
            counted &= ~((t >= t[begin]) & (t < t[begin] + self.fade_in))
        return counted

    @cached_property
    def error(self) -> NDArray[np.float64]:
        """Return the delivered minus the desired joint torque in the cycles that count, N*m."""
        return (self.delivered - self.log["tau_j_des"])[self.counted]

    def facts(self) -> dict[str, str]:
        """Return the errors of the delivered joint torque, the joint's speed, and the faults."""
        found = self.to_dict()
        errors = " / ".join("-" if found[key] is None else f"{1e3 * found[key]:.4g}" for key in ("rms", "p99", "peak"))
        speed = found["joint_speed_peak"]
        return {
            "axis": self.name,
            "error RMS / 99 % / peak": f"{errors} mN·m",
            "peak joint speed": "-" if speed is None else f"{speed:.4g} rad/s",
            "faults": "; ".join(self.faults) or "none",
        }

    def plot(self) -> Figure:
        """Return a picture of desired and delivered joint torque, and of the joint's velocity, over time."""
        torques = {"desired": self.log["tau_j_des"], "delivered": self.delivered}
        panels = ((axis_label("tau_j"), torques), (axis_label("omega_j"), {"joint": self.log["omega_j"]}))
        errors = self.facts()["error RMS / 99 % / peak"]
        return lines(panels, self.log["t"], f"Torque error: RMS / 99 % / peak {errors}")

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready object; errors are null if no cycle counts."""
        error, speed = np.abs(self.error), np.abs(self.truth["omega_j"])
        reasons = Counter(Reason(int(code)).name for code in self.log["limit_reason"].tolist())
        states = self.log["state"][self.log["t"] <= self.until]  # before the drive was disabled at the end of the run
        return {
            "name": self.name,
            "rms": _rms(error),
            "p99": float(np.percentile(error, 99.0)) if error.size else None,
            "peak": float(error.max()) if error.size else None,
            "joint_speed_rms": _rms(speed),
            "joint_speed_peak": float(speed.max()) if speed.size else None,
            "unit": "N*m",
            "state": STATES[int(states[-1])].value if states.size else None,
            "faults": list(self.faults),
            "limit_reasons": {name: reasons[name] for name in sorted(reasons)},
        }


@dataclass(frozen=True, repr=False)
class Simulation(Displayed):
    """Hold the results of one run, with `axes` in the controller's order. `log` and `truth` are of the first axis."""

    seconds: float
    axes: tuple[AxisResult, ...]
    summary: Summary
    record: Path | None
    notes: tuple[str, ...] = ()

    @property
    def log(self) -> Columns:
        return self.axes[0].log

    @property
    def truth(self) -> Columns:
        return self.axes[0].truth

    def axis(self, name: str) -> AxisResult:
        """Return the axis of this name; raises KeyError."""
        return {axis.name: axis for axis in self.axes}[name]

    def facts(self) -> dict[str, str]:
        """Return the end of the run, and the facts of each axis."""
        found = {"seconds": f"{self.seconds:.4g} s", "ended": self.summary.cause}
        for axis in self.axes:
            found |= {f"{axis.name}: {name}": value for name, value in axis.facts().items() if name != "axis"}
        return found

    def plot(self) -> Figure:
        """Return the picture of the first axis; `axis(NAME).plot()` draws another axis."""
        return self.axes[0].plot()

    def to_dict(self) -> dict[str, Any]:
        """Return the public JSON object of `tsa simulate-loop --json`."""
        return {
            "schema": SCHEMA,
            "seconds": self.seconds,
            "axes": [axis.to_dict() for axis in self.axes],
            "log": self.summary.log,
            "record": None if self.record is None else str(self.record),
            "cause": self.summary.cause,
            "failed": self.summary.failed,
            "events": json_types(self.summary.events),
            "notes": list(self.notes),
        }


def _rms(values: NDArray[np.float64]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else None
