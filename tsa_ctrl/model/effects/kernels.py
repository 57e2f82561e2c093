# mypy: disallow-untyped-decorators=False
"""Provide compiled and cached loops over a path or a log for states with a memory.

The callers import this module only if a model uses such a state, because the import of numba takes half a second.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tsa_ctrl.model.functions import Array
from tsa_ctrl.system.compiling import announce

announce()


def plain(values: Array) -> Array:
    """Return the values, (n,), in the layout that the compiled functions require."""
    return np.require(values, np.float64, ["C", "W"])


@njit("float64[::1](float64[::1], float64, float64)", cache=True)
def dahl(path: Array, distance: float, start: float) -> Array:
    """Return the friction state z, (n,), of dz/ds = (1 - sign(ds) z)/q_p along the path s, from z = `start`.

    The result is exact over each step. `distance`: q_p, in the unit of the path.
    """
    out = np.empty(path.size)
    z = out[0] = start
    for i in range(1, path.size):
        step = path[i] - path[i - 1]
        if step > 0.0:
            z = 1.0 + (z - 1.0) * math.exp(-step / distance)
        elif step < 0.0:
            z = -1.0 + (z + 1.0) * math.exp(step / distance)
        out[i] = z
    return out


@njit("float64[::1](float64[::1], float64, int64, float64)", cache=True)
def maxwell_slip(path: Array, distance: float, elements: int, start: float) -> Array:
    """Return the mean (n,) of N elements that slip at +-1 after distances q_p i/N from rest, i = 1..N; exact.

    Each element starts at `start`.
    """
    out = np.empty(path.size)
    out[0] = start
    states = np.full(elements, start)
    for i in range(1, path.size):
        step = (path[i] - path[i - 1]) * elements / distance
        total = 0.0
        for k in range(elements):
            states[k] = min(1.0, max(-1.0, states[k] + step / (k + 1)))
            total += states[k]
        out[i] = total / elements
    return out


@njit("float64[::1](float64[::1], float64)", cache=True)
def last_reversal(path: Array, threshold: float) -> Array:
    """Return the position (n,) of the last reversal by more than `threshold`; nan before the first one.

    A reversal is confirmed only after the motion has returned by `threshold`, but it counts from its extreme on.
    """
    out = np.full(path.size, math.nan)
    extreme, reached, direction = path[0], 0, 0.0
    for i in range(path.size):
        away = path[i] - extreme
        if direction == 0.0:
            if abs(away) <= threshold:
                continue
            direction = math.copysign(1.0, away)
        elif away * direction < 0.0:
            if -away * direction <= threshold:
                continue
            out[reached + 1 :] = extreme
            direction = -direction
        extreme, reached = path[i], i
    return out


@njit("UniTuple(float64, 8)(boolean, float64, float64, float64)", cache=True)
def transition(rings: bool, first: float, second: float, elapsed: float) -> tuple[float, ...]:
    """Return the matrix of one step of `lag` or `ring`, which is exact for x that is linear within the step.

    The step is of `elapsed` s. The result has the factors of y, y', the x before and the x after the step, for the new
    y and then for the new y'.

    Args:
        rings: True for y'' + 2 d w y' + w^2 y = w^2 x, w = 2 pi f; False for T dy/dt + y = x, where y' stays 0.
        first, second: f in Hz and d in 1, or T in s and an unused number.
    """
    if not rings:
        steps = elapsed / first
        mean = -math.expm1(-steps) / steps  # mean of exp(-t/T) over the step
        decay = math.exp(-steps)
        return decay, 0.0, mean - decay, 1.0 - mean, 0.0, 0.0, 0.0, 0.0
    omega = 2.0 * math.pi * first
    turn = omega * math.sqrt(max(1.0 - second * second, 0.0))
    decay = math.exp(-second * omega * elapsed)
    swing = decay * (math.sin(turn * elapsed) / turn if turn > 0.0 else elapsed)
    wave, rub = decay * math.cos(turn * elapsed), second * omega * swing
    behind = 2.0 * second / omega  # s, delay of y behind a ramp; the difference y - x + behind x' oscillates freely
    stay, back = wave + rub, -omega * omega * swing
    by_slope = (-behind + stay * behind - swing) / elapsed  # the slope is (x after - x before)/elapsed
    rate_by_slope = (1.0 + back * behind - (wave - rub)) / elapsed
    return stay, swing, -stay - by_slope, 1.0 + by_slope, back, wave - rub, -back - rate_by_slope, rate_by_slope


@njit("float64[::1](float64[::1], float64[::1], boolean, float64, float64)", cache=True)
def linear(x: Array, t: Array, rings: bool, first: float, second: float) -> Array:
    """Return y, (n,), of `lag` or `ring` along a log, from rest; t in s, other arguments as in `transition`."""
    y = np.empty(x.size)
    value, rate, elapsed = x[0], 0.0, -1.0
    m = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    y[0] = value
    for i in range(1, x.size):
        if t[i] - t[i - 1] != elapsed:
            elapsed = t[i] - t[i - 1]
            m = transition(rings, first, second, elapsed)
        before, now = x[i - 1], x[i]
        new = m[0] * value + m[1] * rate + m[2] * before + m[3] * now
        rate = m[4] * value + m[5] * rate + m[6] * before + m[7] * now
        value = y[i] = new
    return y
