"""Which samples a calibration may learn from: data admission, apart from the fit.

Learned from: sliding in a known direction. Refused: standstill, and the neighbourhood of each reversal, where sigma
is not known from a noisy velocity and the friction has not yet built up (presliding).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import TooStillError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

NOISE_FACTOR = 5.0  # a speed below so many times the velocity noise has no sure sign
SPEED_FRACTION = 0.05  # of the fast motion's speed: slower is called standstill
STROKE_FRACTION = 0.15  # of the stroke after a reversal: friction may still be building up
GUARD_TIME = 0.03  # s beside each reversal: sensor delays
MIN_SECONDS = 1.0  # admitted motion in each direction: twice the time within which noise is alike (prepared.LAG_LIMIT)
# Spread of the motor torque within a direction over its noise: below, noise bends the slope by more than a fifth
MIN_LOAD_TO_NOISE = 2.0


@dataclass(frozen=True)
class Admission:
    """`mask` (n) of admitted samples, `direction` sigma (n), and what was found lacking or refused."""

    mask: BoolArray
    direction: FloatArray
    refused: tuple[str, ...]
    seconds: float
    seconds_forward: float
    seconds_backward: float
    reversals: int


def noise_deviation(x: FloatArray) -> float:
    """Standard deviation of the fast part of a signal, robustly from third differences (white-noise scale 20)."""
    if x.size < 8:
        return 0.0
    d = np.diff(x, 3)
    scale = float(np.median(np.abs(d - np.median(d))) / 0.6745 / np.sqrt(20.0))
    if scale > 0.0:
        return scale
    return float(np.std(d) / np.sqrt(20.0))  # a coarse quantiser: most differences are 0


def admit(t: FloatArray, omega: FloatArray) -> Admission:
    """Admit the samples of one log in which the joint surely slides.

    `t` (n) in s at a constant rate, `omega` (n) in rad/s: joint velocity. A log that does not move is an admission of
    nothing; `require` turns that into an error.
    """
    period = float(t[-1] - t[0]) / max(1, t.size - 1)
    fast = float(np.quantile(np.abs(omega), 0.95))
    threshold = max(NOISE_FACTOR * noise_deviation(omega), SPEED_FRACTION * fast, 1e-9)
    direction = np.where(omega > threshold, 1.0, np.where(omega < -threshold, -1.0, 0.0))
    moving = np.flatnonzero(direction)
    if moving.size == 0:
        nothing = np.zeros(t.size, dtype=np.bool_)
        return Admission(nothing, direction, ("standstill",), 0.0, 0.0, 0.0, 0)
    held = _hold(direction)
    switches = np.flatnonzero(np.diff(held)) + 1
    mask = direction != 0.0
    guard = max(1, round(GUARD_TIME / period))
    travel = np.cumsum(np.abs(omega)) * period
    edges = np.concatenate([[0], switches, [t.size]])
    strokes = travel[edges[1:] - 1] - travel[edges[:-1]]
    typical = float(np.median(strokes[1:-1])) if strokes.size > 2 else float(np.max(strokes))
    for start in switches:
        mask[max(0, start - guard) : start + guard] = False
        stop = int(np.searchsorted(travel, travel[start] + STROKE_FRACTION * typical))
        mask[start:stop] = False
    refused = []
    if np.any(direction == 0.0):
        refused.append("standstill")
    if switches.size:
        refused.append("reversals")
    forward = float(np.sum(mask & (held > 0)) * period)
    backward = float(np.sum(mask & (held < 0)) * period)
    return Admission(mask, held, tuple(refused), forward + backward, forward, backward, int(switches.size))


def _hold(direction: FloatArray) -> FloatArray:
    """At standstill sigma keeps its last non-zero value; before the first motion it is the first one."""
    index = np.where(direction != 0.0, np.arange(direction.size), -1)
    last = np.maximum.accumulate(index)
    first = int(np.flatnonzero(direction)[0])
    return direction[np.where(last < 0, first, last)]


def require(admissions: list[Admission], tau_m: list[FloatArray], where: str) -> None:
    """Refuse data that cannot identify the half loop and the slope; raises TooStillError naming what is too little."""
    forward = sum(a.seconds_forward for a in admissions)
    backward = sum(a.seconds_backward for a in admissions)
    if forward + backward == 0.0:
        raise TooStillError(
            f"{where}: the joint hardly moves, so friction cannot be seen; record motion in both directions"
        )
    for name, seconds in (("forward", forward), ("backward", backward)):
        if seconds < MIN_SECONDS:
            raise TooStillError(
                f"{where}: only {seconds:.2f} s of steady {name} motion, at least {MIN_SECONDS:g} s are needed in each "
                "direction; record longer or wider strokes both ways"
            )
    spread, noise = [], []
    for a, torque in zip(admissions, tau_m, strict=True):
        noise.append(noise_deviation(torque))
        for sign in (1.0, -1.0):
            part = torque[a.mask & (a.direction == sign)]
            if part.size:
                spread.append(float(np.std(part)))
    if max(spread) < MIN_LOAD_TO_NOISE * float(np.median(noise)) or max(spread) == 0.0:
        raise TooStillError(
            f"{where}: the motor torque varies by {max(spread):.2g} N*m within a direction of motion, hardly above its "
            f"noise of {float(np.median(noise)):.2g} N*m, so the slope cannot be seen; record with a load that varies"
        )
