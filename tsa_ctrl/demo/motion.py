"""Provide the desired joint torque and the joint motion of the demo, built in or from a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.waypoints import from_zero, read_waypoints

FloatArray = NDArray[np.float64]

PERIOD = 1.6  # s of one gait cycle
RATE = 200.0  # Hz of the built-in tables
SINE_PERIOD, SINE_TORQUE = 2.0, 0.5  # s, N*m: what no load answers with more than it may move
# Typical level walking over one cycle, of the literature: knee flexion in degrees, and an assisting torque in N*m as a
# small actuator gives it. Fraction of the cycle, value.
KNEE_ANGLE = (
    (0.00, 5.0), (0.07, 12.0), (0.15, 18.0), (0.25, 14.0), (0.40, 5.0),
    (0.50, 11.0), (0.60, 35.0), (0.72, 61.0), (0.85, 34.0), (0.95, 6.0),
)  # fmt: skip
KNEE_TORQUE = (
    (0.00, -0.25), (0.08, 0.35), (0.17, 0.90), (0.28, 0.35), (0.40, -0.35),
    (0.50, -0.10), (0.58, 0.30), (0.72, 0.05), (0.85, -0.30), (0.94, -0.40),
)  # fmt: skip


@dataclass(frozen=True)
class Play:
    """`t` (n) in s from 0; `tau_j_des` (n) in N*m; `q_j` (n) in rad, of an imposed joint. Repeats."""

    t: FloatArray
    tau_j_des: FloatArray
    q_j: FloatArray
    seconds: float = 11.0  # of torque that show it
    shown: float = 3.2  # s of it in the picture

    def write_setpoint(self, path: Path) -> None:
        """CSV as the controller's set-point file."""
        _write(path, "t,tau_j_des", self.t, self.tau_j_des)

    def write_motion(self, path: Path) -> None:
        """CSV as the plant's motion file."""
        _write(path, "t,q_j", self.t, self.q_j)


def _write(path: Path, header: str, *columns: FloatArray) -> None:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9g")


def gait() -> Play:
    """One cycle of the built-in gait."""
    t = np.arange(0.0, PERIOD + 0.5 / RATE, 1.0 / RATE)
    return Play(t, _cycle(KNEE_TORQUE)(t / PERIOD % 1.0), np.radians(_cycle(KNEE_ANGLE)(t / PERIOD % 1.0)))


def play_for(load: str) -> Play:
    """What is played on a joint with this load: the gait, and a sine where the torque moves the joint."""
    if load in ("imposed", "held"):
        return gait()
    t = np.arange(0.0, SINE_PERIOD + 0.5 / RATE, 1.0 / RATE)
    wanted = SINE_TORQUE * np.sin(2.0 * np.pi * t / SINE_PERIOD)
    if load == "wearer":  # its hand's script takes 12 s
        return Play(t, wanted, np.zeros_like(t), seconds=14.0, shown=12.0)
    return Play(t, wanted, np.zeros_like(t), shown=2.0 * SINE_PERIOD)


def _cycle(points: tuple[tuple[float, float], ...]) -> CubicSpline:
    table = np.array([*points, (1.0, points[0][1])])
    return CubicSpline(table[:, 0], table[:, 1], bc_type="periodic")


def from_file(path: Path, most_torque: float) -> Play:
    """A motion from a CSV with the columns t, tau_j_des and (else the built-in gait's motion) q_j.

    Raises UsageError naming file, column and row, also for a torque beyond `most_torque` N*m.
    """
    table = read_waypoints(path, ("tau_j_des",), ("q_j",))
    t, wanted = from_zero(table.columns["t"]), table.columns["tau_j_des"]
    high = int(np.argmax(np.abs(wanted)))
    if abs(wanted[high]) > most_torque:
        raise UsageError(
            f"{path}: column 'tau_j_des', {table.place(high)}: {wanted[high]:.3g} N*m is beyond the demo's "
            f"{most_torque:.2g} N*m; scale the file down"
        )
    angle = table.columns.get("q_j")
    angle = np.radians(_cycle(KNEE_ANGLE)(t / PERIOD % 1.0)) if angle is None else angle
    return Play(t, wanted, angle, shown=min(12.0, 2.0 * float(t[-1])))
