"""Position counts to unwrapped angle and angular velocity.

Velocity: the difference of two positions over the measured interval, through a first-order low-pass of cutoff f_c,
    omega += (1 - exp(-2 pi f_c dt)) (dq/dt - omega),
so its delay is 1 / (2 pi f_c) and a missed sample only makes dt longer.
"""

from __future__ import annotations

import math


class PositionTracker:
    """Follows a counter that wraps.

    `radians_per_count` carries the sign. `zero`: the count at angle 0; the first angle is the one nearest to 0.
    `cutoff`: Hz. `angle` (rad) and `velocity` (rad/s) are nan and 0 until the first sample.
    """

    __slots__ = ("_half", "_last", "_range", "_scale", "_time", "_total", "_w", "_zero", "angle", "velocity")

    def __init__(self, radians_per_count: float, counts_range: int, zero: int, cutoff: float) -> None:
        self._scale = radians_per_count
        self._range = counts_range
        self._half = counts_range // 2
        self._zero = zero
        self._w = -2.0 * math.pi * cutoff
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next sample is the first."""
        self._last: int | None = None
        self._total = 0
        self._time = 0.0
        self.angle = math.nan
        self.velocity = 0.0

    def follow(self, count: int) -> int:
        """Take a position alone; returns the step in counts since the last one."""
        last = self._last
        self._last = count
        if last is None:
            step = 0
            self._total = (count - self._zero + self._half) % self._range - self._half
        else:
            step = count - last
            if not -self._half <= step < self._half:
                step = (step + self._half) % self._range - self._half
            self._total += step
        self.angle = self._total * self._scale
        return step

    def update(self, count: int, t: float) -> None:
        """Take a position sampled at `t` in s, and derive the velocity."""
        first = self._last is None
        step = self.follow(count)
        dt = t - self._time
        if first:
            self._time = t
        elif dt > 0.0:
            self._time = t
            self.velocity += (1.0 - math.exp(self._w * dt)) * (step * self._scale / dt - self.velocity)
