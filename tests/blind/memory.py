"""Loops over samples for states with memory, which cannot be vectorised."""

from __future__ import annotations

import numpy as np
from numba import njit

Array = np.ndarray


@njit(cache=True)
def direction(velocity: Array) -> Array:
    """Return the sign of the velocity, (n,).

    At standstill it is the last sign; before the first motion it is the first sign.
    """
    n = velocity.size
    out = np.zeros(n)
    last = 0.0
    first = n
    for i in range(n):
        if velocity[i] > 0.0:
            last = 1.0
        elif velocity[i] < 0.0:
            last = -1.0
        if last != 0.0 and first == n:
            first = i
        out[i] = last
    for i in range(min(first, n)):
        out[i] = out[first] if first < n else 0.0
    return out


@njit(cache=True)
def bristle(displacement: Array, distance: float, start: float) -> Array:
    """Return the state z of the Dahl model, (n,).

    z relaxes to the direction of motion over `distance`. Each step is exact.
    """
    n = displacement.size
    out = np.empty(n)
    z = start
    out[0] = z
    for i in range(1, n):
        step = displacement[i] - displacement[i - 1]
        if step > 0.0:
            z = 1.0 - (1.0 - z) * np.exp(-step / distance)
        elif step < 0.0:
            z = -1.0 + (1.0 + z) * np.exp(step / distance)
        out[i] = z
    return out


@njit(cache=True)
def slip_elements(displacement: Array, distance: float, count: int, start: float) -> Array:
    """Return the mean state of `count` elastic sliders, (n,).

    From rest, the i-th slider saturates after distance * i / count.
    """
    n = displacement.size
    out = np.empty(n)
    z = np.full(count, start)
    out[0] = start
    for i in range(1, n):
        step = displacement[i] - displacement[i - 1]
        total = 0.0
        for k in range(count):
            moved = z[k] + step * count / (distance * (k + 1))
            z[k] = min(1.0, max(-1.0, moved))
            total += z[k]
        out[i] = total / count
    return out


@njit(cache=True)
def engaged(angle: Array, sigma: Array, gap: float, first: int) -> Array:
    """Return 0 while the joint crosses the backlash after a reversal, else 1, (n,).

    Reversals up to `first` are ignored.
    """
    n = angle.size
    out = np.ones(n)
    turned = False
    turning_angle = 0.0
    for i in range(first + 1, n):
        if sigma[i] * sigma[i - 1] < 0.0:
            turned = True
            turning_angle = angle[i - 1]
        if turned and abs(angle[i] - turning_angle) < gap:
            out[i] = 0.0
    return out


@njit(cache=True)
def first_order_lag(signal: Array, step: float, time_constant: float) -> Array:
    """Return the signal filtered by 1/(1 + T s), exact for a signal that is linear between samples, (n,)."""
    n = signal.size
    out = np.empty(n)
    out[0] = signal[0]
    decay = np.exp(-step / time_constant)
    for i in range(1, n):
        slope = (signal[i] - signal[i - 1]) / step
        ramp_now = signal[i] - time_constant * slope
        ramp_before = signal[i - 1] - time_constant * slope
        out[i] = ramp_now + (out[i - 1] - ramp_before) * decay
    return out


@njit(cache=True)
def rest_time(velocity: Array, step: float, threshold: float) -> Array:
    """Return the duration of the last rest (s), held from the break-away until the end of the next rest, (n,)."""
    n = velocity.size
    out = np.zeros(n)
    resting = 0.0
    last = 0.0
    for i in range(n):
        if abs(velocity[i]) < threshold:
            resting += step
        elif resting > 0.0:
            last = resting
            resting = 0.0
        out[i] = last
    return out


@njit(cache=True)
def slid_since_rest(angle: Array, velocity: Array, threshold: float) -> Array:
    """Return the distance travelled since the joint last rested, (n,)."""
    n = angle.size
    out = np.zeros(n)
    for i in range(1, n):
        if abs(velocity[i]) >= threshold:
            out[i] = out[i - 1] + abs(angle[i] - angle[i - 1])
    return out
