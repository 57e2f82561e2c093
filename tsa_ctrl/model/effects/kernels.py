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


@njit("float64[::1](float64[::1], float64[::1], float64)", cache=True)
def lag(x: Array, t: Array, constant: float) -> Array:
    """T dy/dt + y = x from rest, T = `constant` in s; exact for x that is linear between samples, t in s."""
    y = np.empty(x.size)
    state = x[0]
    y[0] = state
    for i in range(1, x.size):
        steps = (t[i] - t[i - 1]) / constant
        mean = -math.expm1(-steps) / steps  # of exp(-t/T) over the step
        decay = math.exp(-steps)
        state = decay * state + (mean - decay) * x[i - 1] + (1.0 - mean) * x[i]
        y[i] = state
    return y


@njit("float64[::1](float64[::1], float64[::1], float64, float64)", cache=True)
def ring(x: Array, t: Array, frequency: float, damping: float) -> Array:
    """y'' + 2 d w y' + w^2 y = w^2 x from rest, w = 2 pi f; exact for x that is linear between samples, t in s."""
    y = np.empty(x.size)
    omega = 2.0 * math.pi * frequency
    turn = omega * math.sqrt(max(1.0 - damping * damping, 0.0))
    behind = 2.0 * damping / omega  # s that y is behind a ramp; what it is beside that swings freely
    state, rate, elapsed = x[0], 0.0, -1.0
    wave = swing = 0.0
    y[0] = state
    for i in range(1, x.size):
        if t[i] - t[i - 1] != elapsed:
            elapsed = t[i] - t[i - 1]
            decay = math.exp(-damping * omega * elapsed)
            wave = decay * math.cos(turn * elapsed)
            swing = decay * (math.sin(turn * elapsed) / turn if turn > 0.0 else elapsed)
        slope = (x[i] - x[i - 1]) / elapsed
        off, off_rate = state - x[i - 1] + behind * slope, rate - slope
        state = x[i] - behind * slope + wave * off + swing * (damping * omega * off + off_rate)
        rate = slope + wave * off_rate - swing * omega * (omega * off + damping * off_rate)
        y[i] = state
    return y


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
