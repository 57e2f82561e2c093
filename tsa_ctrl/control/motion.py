"""How the joint moves now: velocity and acceleration from its angles, not late while the acceleration is steady.

    q' = q + dt omega + dt^2 alpha / 2,    omega' = omega + dt alpha,    r = angle - q'
    q = q' + (1 - m^3) r,    omega = omega' + 3/2 (1 - m)^2 (1 + m) r / dt,    alpha = alpha' + (1 - m)^3 r / dt^2

This is the parabola through all angles, each of which weighs m times what the next one weighs: a fading-memory filter
of second degree (N. Morrison, Introduction to Sequential Smoothing and Prediction, 1969, chapter 13). A low-pass on
differences is late instead, and a reversal must be seen before it comes. A memory dt/(1 - m) is as long as the
encoder's steps ask: one count moves `noise` (rad/s) at most, found by feeding it one.
"""

from __future__ import annotations

import math

SHORTEST, LONGEST = 1.0 / 300.0, 0.02  # s of memory: ten periods of 3 kHz; a gait turns round within two of the longest
FEWEST = 10.0 / 3.0  # periods of memory, at least: below it the acceleration is noise
STEP = 1.2  # between the memories that are tried
QUIET = 0.04  # rad/s: slower than that a joint of a person hardly moves; longer memories are not worth their lateness
_SETTLED = 40  # memories after which a step is forgotten


class Motion:
    """Velocity (rad/s) and acceleration (rad/s^2) of the joint at the last angle; nan-free, 0 until there are two."""

    __slots__ = ("_g", "_h", "_k", "_period", "acceleration", "angle", "memory", "noise", "velocity")

    def __init__(self, period: float, resolution: float, horizon: float, shortest: float = SHORTEST) -> None:
        """`resolution`: rad of one count; `horizon`: s for which the velocity will be taken ahead; times in s."""
        self._period = period
        memory = max(shortest, FEWEST * period)
        longest = max(LONGEST, memory)
        self._use(memory)
        while (noise := resolution * self._step_response(horizon)) > QUIET and memory < longest:
            memory = min(longest, STEP * memory)
            self._use(memory)
        self.memory = memory
        self.noise = noise
        self.reset()

    def _use(self, memory: float) -> None:
        m = 1.0 - self._period / memory
        self._g = 1.0 - m**3
        self._h = 1.5 * (1.0 - m) ** 2 * (1.0 + m) / self._period
        self._k = (1.0 - m) ** 3 / self._period**2
        self.memory = memory

    def reset(self) -> None:
        """Forget the past: the next angle is the first."""
        self.angle = math.nan
        self.velocity = self.acceleration = 0.0

    def update(self, angle: float, fresh: bool = True) -> None:
        """Take the angle (rad) of this cycle; one that is not `fresh`, or nan, is replaced by what was expected."""
        q = self.angle
        if q != q:
            self.angle = angle
            return
        dt = self._period
        omega, alpha = self.velocity, self.acceleration
        q += dt * (omega + 0.5 * dt * alpha)
        omega += dt * alpha
        if fresh and angle == angle:
            r = angle - q
            q += self._g * r
            omega += self._h * r
            alpha += self._k * r
        self.angle, self.velocity, self.acceleration = q, omega, alpha

    def _step_response(self, horizon: float) -> float:
        """Largest velocity, taken ahead by `horizon`, that an angle makes which moves by 1 rad at once; rad/s."""
        self.reset()
        self.update(0.0)
        largest = 0.0
        for _ in range(round(_SETTLED * self.memory / self._period)):
            self.update(1.0)
            largest = max(largest, abs(self.velocity + horizon * self.acceleration))
        return largest
