"""What an untouched measured log holds of an effect already, by least squares of this file alone.

A delay that is hidden in a log whose torque leads its motion first takes that lead away: what a diagnosis is to find is
the sum. Torque is fitted by columns of the motion: Coulomb, viscous, inertia, offset, and what the publication of the
set has beside them. Of an effect that is linear its own column comes on top, and its number is that column's; of a
delay the motion is shifted in time by steps, both ways, and the number is where a parabola through the least sum of
squares has its lowest point. The interval leaves out each of the blocks of time once (jackknife). Nothing here is the
package's but the reader of the file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt

from tsa_ctrl.identify.dataset import Dataset

Array = NDArray[np.float64]
CUTOFF = 100.0  # Hz, with zero phase: the filter with which the axis' publication fits by least squares
HIGHEST = 0.4  # of the rate: no cut-off above; a log at a few hertz is of steady speeds
BLOCKS = 24  # of time, of all logs together
T = 2.07  # Student's t for 95 % at BLOCKS - 1 degrees of freedom
STEP, STEPS = 1e-4, 60  # s, and how many either way: 6 ms, six samples of the log that tells most
ENDS = 0.3  # s at either end of a log, where filter and shift have no data
MOVING = 0.05  # of the largest speed, from which on a motion is away from its reversals
PENDULUM = {"bam"}  # sets whose publication has a weight in it
BY_DIRECTION = {"emps"}  # and whose friction is published by direction


@dataclass(frozen=True)
class Motion:
    """One log: time (s), angle (rad), velocity, acceleration, SI, (n,); all shifted and sampled alike."""

    t: Array
    q: Array
    omega: Array
    acceleration: Array


Column = Callable[[Motion], Array]
COLUMNS: dict[str, Column] = {
    "gravity_load": lambda log: np.sin(log.q + 0.4),
    "joint_stiffness": lambda log: log.q,
    "viscous_friction": lambda log: log.omega,
    "inertia": lambda log: log.acceleration,
    "direction_asymmetric_friction": lambda log: np.abs(log.omega),
}
DELAY = "transport_delay"


@dataclass(frozen=True)
class Own:
    """A number that the log has without anything hidden in it, and its 95 % interval, in the effect's own unit."""

    value: float
    low: float
    high: float


def motion_of(log: Dataset) -> Motion:
    """Of what was recorded; of a recorded velocity alone the angle is the integral."""
    t = log["t"]
    period = float(np.median(np.diff(t)))

    def filtered(y: Array) -> Array:
        if 1.0 / period < CUTOFF / HIGHEST:  # nothing above the cut-off is in it
            return y
        return np.asarray(filtfilt(*butter(2, 2.0 * CUTOFF * period), y), dtype=np.float64)

    if "q_m" in log and "q_m" not in log.derived:
        q = filtered(log["q_m"])
        omega = np.gradient(q, t)
    else:
        omega = filtered(log["omega_m"])
        q = np.cumsum(omega) * period
    return Motion(t, q, omega, np.gradient(omega, t))


def shifted(log: Motion, late: float) -> Motion:
    """The motion so many seconds earlier: what a torque shows that is late by as much."""
    if late == 0.0:
        return log
    q, omega, acceleration = (np.interp(log.t - late, log.t, y) for y in (log.q, log.omega, log.acceleration))
    return replace(log, q=q, omega=omega, acceleration=acceleration)


def columns_of(name: str, log: Motion, effect: str, late: float = 0.0) -> Array:
    """What the torque of a set is fitted by, (n, k); the effect's own column last, where it has one."""
    moved = shifted(log, late)
    sign = np.interp(log.t - late, log.t, np.sign(log.omega))
    found = [sign, moved.omega, moved.acceleration, np.ones_like(sign)]
    found += [np.sin(moved.q), np.cos(moved.q)] if name in PENDULUM else []
    found += [np.abs(moved.omega)] if name in BY_DIRECTION else []
    return np.column_stack([*found, COLUMNS[effect](moved)] if effect in COLUMNS else found)


class Blocks:
    """Sums of squares and products by block of time of all logs, so that any block can be left out."""

    def __init__(self, columns: Sequence[Array], torques: Sequence[Array], used: Sequence[NDArray[np.bool_]]) -> None:
        whole, torque = np.concatenate(columns), np.concatenate(torques)
        inside = np.concatenate(used)
        number = np.arange(len(torque)) * BLOCKS // len(torque)
        parts = [inside & (number == k) for k in range(BLOCKS)]
        self._gram = np.array([whole[part].T @ whole[part] for part in parts])
        self._product = np.array([whole[part].T @ torque[part] for part in parts])
        self._square = np.array([torque[part] @ torque[part] for part in parts])

    def fit(self, without: int | None) -> tuple[Array, float]:
        """Coefficients and sum of squares that is left, of all blocks but one."""
        kept = [k for k in range(BLOCKS) if k != without]
        gram, product = self._gram[kept].sum(axis=0), self._product[kept].sum(axis=0)
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        found = np.linalg.lstsq(gram / np.outer(scale, scale), product / scale, rcond=1e-12)[0] / scale
        return found, float(self._square[kept].sum() - product @ found)


def jackknife(number: Callable[[int | None], float]) -> Own:
    """A number of all blocks, with the interval from leaving out each."""
    value = number(None)
    without = np.array([number(k) for k in range(BLOCKS)])
    half = T * float(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((without - without.mean()) ** 2)))
    return Own(value, value - half, value + half)


def own(name: str, logs: Sequence[Dataset], effect: str, moving: float = 0.0) -> Own:
    """What the logs of a set have of an effect; `moving`: only where faster than so much of the largest speed."""
    motions = [motion_of(log) for log in logs]
    fastest = max(float(np.max(np.abs(each.omega))) for each in motions)
    used = [
        (np.abs(each.omega) >= moving * fastest) & (each.t > each.t[0] + ENDS) & (each.t < each.t[-1] - ENDS)
        for each in motions
    ]
    torques = [log["tau_m"] for log in logs]

    def blocks(late: float) -> Blocks:
        return Blocks([columns_of(name, each, effect, late) for each in motions], torques, used)

    if effect != DELAY:
        still = blocks(0.0)
        return jackknife(lambda without: float(still.fit(without)[0][-1]))
    scanned = [blocks(k * STEP) for k in range(-STEPS, STEPS + 1)]
    return jackknife(lambda without: lowest([each.fit(without)[1] for each in scanned]))


def lowest(squares: Sequence[float]) -> float:
    """Where a scan of shifts is lowest, s: of the parabola through its lowest point and that point's neighbours."""
    k = min(max(int(np.argmin(squares)), 1), len(squares) - 2)
    before, here, after = squares[k - 1 : k + 2]
    return (k - STEPS + 0.5 * (before - after) / (before - 2.0 * here + after)) * STEP
