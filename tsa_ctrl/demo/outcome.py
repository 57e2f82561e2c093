"""Report the joint torque errors of a demo, from the daemon's logs, as table, JSON and picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tsa_ctrl import outputs
from tsa_ctrl.demo.rig import FADE_IN
from tsa_ctrl.log.table import load_run

FloatArray = NDArray[np.float64]

LEGEND = 0.22  # share of an axis above the curves, for a legend of one line


@dataclass(frozen=True)
class Course:
    """One run after the fade-in: `t` (n) in s since the enable, torques (n) in N*m."""

    t: FloatArray
    wanted: FloatArray
    delivered: FloatArray
    log: Path
    summary: dict[str, Any]
    angle: FloatArray  # of the joint, (n) in rad

    @property
    def error(self) -> FloatArray:
        return self.delivered - self.wanted

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.error))))

    @property
    def skipped(self) -> float:
        """Return the share of the cycles that the loop skipped, because the machine woke it too late."""
        cycles = self.summary["cycles"]
        return 1.0 - float(cycles["sent"]) / max(float(cycles["planned"]), 1.0)


def course_of(folder: Path, summary: dict[str, Any], seconds: float, axis: str = "") -> Course:
    """Return a run's log from the end of the fade-in to the start of the stop, `seconds` s after the enable.

    `axis` is the name of the axis if the log has several.

    Raises:
        BusError: the log has torque for too short a time.
    """
    log = folder / str(summary["log"])
    columns = load_run(f"{log}:{axis}" if axis else log, ("q_j",), FADE_IN, seconds, str(summary["cause"]))
    return Course(columns["t"], columns["tau_j_des"], columns["tau_j"], log, summary, columns["q_j"])


@dataclass(frozen=True)
class Outcome:
    """Runs without and with compensation; the motion is the same if it is prescribed."""

    bus: str
    load: str
    without: Course
    compensated: Course
    picture: Path
    rate: float  # of the loop, Hz

    @property
    def reduction(self) -> float:
        """Return the reduction of the RMS error by compensation, %."""
        return 100.0 * (1.0 - self.compensated.rms / self.without.rms)

    def to_dict(self) -> dict[str, Any]:
        """Return the public JSON object of `tsa demo --json`."""
        cycles = [run.summary["cycles"] for run in (self.without, self.compensated)]
        return {
            "schema": 1,
            "bus": self.bus,
            "load": self.load,
            "rate": self.rate,
            "rms": {
                "wanted": float(np.sqrt(np.mean(np.square(self.compensated.wanted)))),
                "without": self.without.rms,
                "with": self.compensated.rms,
                "unit": "N*m",
            },
            "reduction_percent": self.reduction,
            "picture": str(self.picture),
            "log": str(self.compensated.log),
            "cycles": {key: sum(c[key] for c in cycles) for key in ("planned", "sent", "late", "missed_pdo")},
        }

    def draw(self, seconds: float) -> None:
        """Write the picture of desired and delivered torque, the errors, and the motion over `seconds` s."""
        figure = Figure(figsize=(9.0, 7.5), layout="constrained")
        torque, error, motion = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
        first = self.compensated.t[0]
        wanted = self.compensated
        torque.plot(*window(wanted.t, wanted.wanted, first, seconds), "k", lw=2.2, label="desired")
        for run, colour, label, width in (
            (self.without, "tab:red", "without compensation", 2.6),  # wider, to be visible under the other
            (self.compensated, "tab:blue", "with compensation", 1.2),
        ):
            torque.plot(*window(run.t, run.delivered, first, seconds), colour, lw=1.0, label=f"delivered {label}")
            shown = f"{label}: RMS {1e3 * run.rms:.0f} mN·m"
            error.plot(*window(run.t, run.error, first, seconds), colour, lw=1.0, label=shown)
            motion.plot(*window(run.t, run.angle, first, seconds), colour, lw=width, label=label)
        torque.set_ylabel("joint torque (N·m)")
        error.set_ylabel("torque error (N·m)")
        motion.set_ylabel("joint angle (rad)")
        motion.set_xlabel("time since torque was enabled (s)")
        error.axhline(0.0, color="k", lw=0.5)
        for axes in (torque, error, motion):
            axes.grid(alpha=0.3)
            low, high = axes.get_ylim()
            axes.set_ylim(low, high + LEGEND * (high - low))
            axes.legend(loc="upper right", ncols=3, fontsize=8)
        torque.set_title(
            f"Friction compensation reduces the torque error by {self.reduction:.1f} % (load: {self.load})"
        )
        outputs.save_picture(figure, self.picture, dpi=130, keeping=False)


def window(t: FloatArray, y: FloatArray, first: float, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Return time and signal (n each) from `first` (s) on, for `seconds`."""
    chosen = (t >= first) & (t <= first + seconds)
    return t[chosen], y[chosen]
