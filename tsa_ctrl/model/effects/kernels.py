# mypy: disallow-untyped-decorators=False
"""Loops over a log that depend on their own last step, compiled and cached; imported only where memory is in play."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from tsa_ctrl.model.functions import Array


@njit("float64[::1](float64[::1], float64, float64)", cache=True)
def dahl(displacement: Array, distance: float, start: float) -> Array:
    """Friction state z of dz/ds = (1 - sign(ds) z)/q_p, exact over each sample's straight displacement."""
    z = np.empty(displacement.size)
    state = start
    z[0] = state
    for i in range(1, displacement.size):
        step = displacement[i] - displacement[i - 1]
        if step > 0.0:
            state = 1.0 + (state - 1.0) * math.exp(-step / distance)
        elif step < 0.0:
            state = -1.0 + (state + 1.0) * math.exp(step / distance)
        z[i] = state
    return z


@njit("float64[::1](float64[::1], float64, int64, float64)", cache=True)
def maxwell_slip(displacement: Array, distance: float, elements: int, start: float) -> Array:
    """Mean of N elements that slip at +-1 after distances q_p i/N from rest, i = 1..N; exact."""
    z = np.empty(displacement.size)
    states = np.full(elements, start)
    z[0] = start
    for i in range(1, displacement.size):
        step = (displacement[i] - displacement[i - 1]) * elements / distance
        total = 0.0
        for k in range(elements):
            states[k] = min(1.0, max(-1.0, states[k] + step / (k + 1)))
            total += states[k]
        z[i] = total / elements
    return z


@njit("boolean[::1](float64[::1], float64, float64)", cache=True)
def within_gap(q: Array, gap: float, threshold: float) -> npt.NDArray[np.bool_]:
    """True where abs(q - q_r) < gap, q_r the angle at the last reversal by more than `threshold`.

    A reversal is known only `threshold` later, and holds from after the extreme: what lies between is filled in.
    """
    inside = np.zeros(q.size, dtype=np.bool_)
    reversal = math.nan  # before the first reversal: nan compares false, the play is closed
    extreme = q[0]
    since = 0
    direction = 0
    for i in range(1, q.size):
        away = q[i] - extreme
        if direction == 0 and abs(away) > threshold:
            direction = 1 if away > 0.0 else -1
        if direction == 0:
            continue
        if away * direction >= 0.0:
            extreme, since = q[i], i
        elif -away * direction > threshold:
            reversal = extreme
            for k in range(since + 1, i):
                inside[k] = abs(q[k] - reversal) < gap
            direction = -direction
            extreme, since = q[i], i
        inside[i] = abs(q[i] - reversal) < gap
    return inside
