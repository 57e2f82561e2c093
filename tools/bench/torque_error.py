"""What a run on a joint is judged by: the error of the delivered torque, its jerk at reversals, motion at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.virtual.result import AxisResult

WINDOW = 0.05  # s on either side of a reversal: longer than any turn of the friction term takes
LEAST_SPEED = 0.05  # rad/s that a joint must have had on both sides of a reversal: less is creep

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Measures:
    """RMS, 99th percentile and peak of the error in N*m; its jerk in N*m/s; joint speed at set-point 0 in rad/s."""

    rms: float
    p99: float
    peak: float
    jerk: float | None  # None without a reversal
    resting_speed: float


def measure(axis: AxisResult, playing: float, rests: float) -> Measures:
    """Of one run: set-point until `playing` s of the log's time, none and at rest from `rests` s on."""
    t = axis.log["t"]
    counted = axis.counted & (t < playing)
    error = (axis.delivered - axis.log["tau_j_des"])[counted]
    rate = np.gradient(error, t[counted])
    near = near_reversals(t[counted], axis.log["omega_j"][counted], axis.log["tau_j_des"][counted])
    truth = axis.truth
    resting = (truth["clock"] - axis.start >= rests) & (truth["clock"] - axis.start < axis.until)
    size = np.abs(error)
    return Measures(
        rms=_rms(error),
        p99=float(np.percentile(size, 99.0)),
        peak=float(size.max()),
        jerk=_rms(rate[near]) if near.any() else None,
        resting_speed=_rms(truth["omega_j"][resting]),
    )


def near_reversals(t: FloatArray, omega: FloatArray, wanted: FloatArray) -> NDArray[np.bool_]:
    """Samples within `WINDOW` of a reversal of the joint, or of the wanted torque where the joint stands still."""
    direction = omega if np.abs(omega).max() > LEAST_SPEED else np.gradient(wanted, t)
    fast = np.flatnonzero(np.abs(direction) > LEAST_SPEED)
    turns = fast[:-1][np.diff(np.sign(direction[fast])) != 0]
    ends = fast[1:][np.diff(np.sign(direction[fast])) != 0]
    near = np.zeros(t.size, dtype=bool)
    for before, after in zip(turns.tolist(), ends.tolist(), strict=True):
        near |= (t >= t[before] - WINDOW) & (t <= t[after] + WINDOW)
    return near


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
