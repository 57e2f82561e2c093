# mypy: disallow-untyped-decorators=False
"""Provide compiled and cached loops over a log for functions with a memory; imported only if a model uses them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tsa_ctrl.model.functions import Array
from tsa_ctrl.system.compiling import announce

announce()


@njit("float64[::1](float64[::1], float64[::1], float64)", cache=True)
def lag(x: Array, t: Array, constant: float) -> Array:
    """Return y, (n,), of T dy/dt + y = x from rest, with T = `constant` in s.

    The result is exact for x that is linear between samples; t in s.
    """
    y = np.empty(x.size)
    state = x[0]
    y[0] = state
    for i in range(1, x.size):
        steps = (t[i] - t[i - 1]) / constant
        mean = -math.expm1(-steps) / steps  # mean of exp(-t/T) over the step
        decay = math.exp(-steps)
        state = decay * state + (mean - decay) * x[i - 1] + (1.0 - mean) * x[i]
        y[i] = state
    return y


@njit("float64[::1](float64[::1], float64[::1], float64, float64)", cache=True)
def ring(x: Array, t: Array, frequency: float, damping: float) -> Array:
    """Return y, (n,), of y'' + 2 d w y' + w^2 y = w^2 x from rest, with w = 2 pi f, f = `frequency`, d = `damping`.

    The result is exact for x that is linear between samples; t in s.
    """
    y = np.empty(x.size)
    omega = 2.0 * math.pi * frequency
    turn = omega * math.sqrt(max(1.0 - damping * damping, 0.0))
    behind = 2.0 * damping / omega  # s, delay of y behind a ramp; the difference oscillates freely
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
