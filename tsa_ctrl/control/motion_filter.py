"""Estimate the motion of the joint from the encoders of joint and motor.

`Motion` is the filter. `JointAngle` refines a coarse joint encoder by the motor encoder. The tendons connect both, so
while they slide in one direction, the motor shows how far the joint moves within one count of its encoder.
"""

from __future__ import annotations

import math

SHORTEST, LONGEST = 1.0 / 300.0, 0.02  # s of memory: ten periods of 3 kHz; a gait reverses within two of the longest
FEWEST = 1.5  # least periods of memory, because with fewer the acceleration is only noise
STEP = 1.1  # ratio of successive memories in the search
# rad/s^3 at the reversals of a gait (0.3 rad at 1 Hz: 74). The memory that this value gives has the smallest errors
# with a prescribed gait and a human-in-the-loop load at 250 to 1000 Hz and encoders of 12 to 20 bit.
JERK = 50.0
QUIET = 0.04  # rad/s: human joints hardly move more slowly
MOST_EXPECTED = 50  # periods without an angle that end the extrapolation: the watchdogs have then removed the torque
_SETTLED = 40  # memories after which a step has no effect


class Motion:
    """Estimate velocity (rad/s) and acceleration (rad/s^2) of the joint at the last angle; both are 0 at the first one.

    A fading-memory filter of second degree fits a parabola in which each angle weighs m times as much as the next. A
    low-pass filter of differences would delay the reversal, which must be predicted. The memory is dt/(1 - m). A short
    one amplifies the encoder's counts, and a long one delays a change of the acceleration. The chosen memory has the
    smallest sum of squares of two errors of the extrapolated velocity: `noise` (rad/s), its largest change by one
    count, and its error at the jerk `JERK`.

    The parabola also replaces missing angles. After `MOST_EXPECTED` of them, both values are 0, and the next angle is
    the first one.

    Source: N. Morrison, Introduction to Sequential Smoothing and Prediction, 1969, chapter 13.
    """

    __slots__ = ("_g", "_h", "_k", "_missing", "_period", "acceleration", "angle", "memory", "noise", "velocity")

    def __init__(self, period: float, resolution: float, horizon: float, shortest: float = SHORTEST) -> None:
        """Choose the memory.

        Args:
            period: s.
            resolution: rad of one encoder count.
            horizon: s by which the velocity will be extrapolated.
            shortest: shortest memory, s.
        """
        self._period = period
        memory = max(shortest, FEWEST * period)
        longest = max(LONGEST, memory)
        best = math.inf
        while memory <= longest:
            self._use(memory)
            noise = resolution * self._step_response(horizon)
            error = math.hypot(noise, JERK * self._jerk_response(horizon))
            if error >= best:
                break
            best, self.noise, chosen = error, noise, memory
            memory *= STEP
        self._use(chosen)
        self.reset()

    def _use(self, memory: float) -> None:
        m = 1.0 - self._period / memory
        self._g = 1.0 - m**3
        self._h = 1.5 * (1.0 - m) ** 2 * (1.0 + m) / self._period
        self._k = (1.0 - m) ** 3 / self._period**2
        self.memory = memory

    def reset(self) -> None:
        """Reset the filter; the next angle is the first one."""
        self.angle = math.nan
        self.velocity = self.acceleration = 0.0
        self._missing = 0  # periods in a row without an angle

    def update(self, angle: float, fresh: bool = True) -> None:
        """Process the angle (rad) of this cycle; the prediction replaces an angle that is not `fresh` or is nan."""
        known = fresh and angle == angle
        q = self.angle
        if q != q or (known and self._missing >= MOST_EXPECTED):
            self.angle, self._missing = angle, 0
            return
        dt = self._period
        omega, alpha = self.velocity, self.acceleration
        q += dt * (omega + 0.5 * dt * alpha)
        omega += dt * alpha
        if known:
            r = angle - q
            q += self._g * r
            omega += self._h * r
            alpha += self._k * r
            self._missing = 0
        else:
            self._missing += 1
            if self._missing >= MOST_EXPECTED:
                omega = alpha = 0.0
        self.angle, self.velocity, self.acceleration = q, omega, alpha

    def _jerk_response(self, horizon: float) -> float:
        """Return the error of the velocity, extrapolated by `horizon` (s), at a jerk of 1 rad/s^3, rad/s."""
        dt = self._period
        residual = dt / self._k  # of the angle; it changes the acceleration by the jerk in each period
        acceleration = (self._h * residual - dt**2 / 2.0) / dt
        velocity = (self._g * residual - dt**2 / 2.0 * acceleration - dt**3 / 6.0) / dt
        return velocity + horizon * acceleration + horizon**2 / 2.0

    def _step_response(self, horizon: float) -> float:
        """Return the largest velocity, extrapolated by `horizon` (s), after a step of the angle by 1 rad; rad/s."""
        self.reset()
        self.update(0.0)
        largest = 0.0
        for _ in range(round(_SETTLED * self.memory / self._period)):
            self.update(1.0)
            largest = max(largest, abs(self.velocity + horizon * self.acceleration))
        return largest


# Parts of a joint encoder's count that the motor resolves. With 8, ripple and elongation of random rigs look like
# motion of the joint.
FINER = 4.0
WORTH = 2.0  # least parts, because a motor encoder that is hardly finer than the joint encoder is no improvement
HALF = 0.6  # counts of the joint encoder: largest difference from its reading, half a count and the noise
# Counts at `QUIET`. If the encoder takes longer for the next count, the joint hardly moves, and the motor mainly
# stretches the tendons. With 1.2, a slow joint of a random rig appears to reverse. Values of 0.1 to 0.6 have similar
# errors.
STILL = 0.3
AFTER_TURN = 2.0 * SHORTEST  # s after a reversal of the friction term, in which the motor moves without the joint


class JointAngle:
    """Refine the angle of a joint encoder by the motor angle, within one count.

    The angle follows the motor, or the last velocity while the friction term reverses. It stays within `HALF` counts of
    the encoder's reading, so neither an error of the elongation nor a slipped tendon adds up. A joint at rest does not
    follow the motor, which only stretches the tendons.
    """

    def __init__(self, count: float, period: float) -> None:
        """Prepare the refinement; `count`: rad of one count of the joint encoder; `period`: s."""
        self._half = HALF * count
        self._period = period
        self._longest = STILL * count / QUIET  # s
        self._angle = self._reading = self._motor = math.nan  # rad
        self._since = math.inf  # s since the encoder's last new count
        self._blind = 0.0  # s

    def update(self, reading: float, motor: float, velocity: float, turning: bool) -> float:
        """Return the refined angle, rad.

        Args:
            reading: angle of the joint encoder, rad.
            motor: motor angle minus the elongation, as an angle of the joint, rad.
            velocity: joint velocity, rad/s.
            turning: True while the friction term reverses.
        """
        step = motor - self._motor
        self._motor = motor
        if reading != self._reading:
            self._reading, self._since = reading, 0.0
        self._since += self._period
        self._blind = AFTER_TURN if turning else self._blind - self._period
        if self._since > self._longest or step != step:
            step = 0.0
        elif self._blind > 0.0:
            step = velocity * self._period
        low, high = reading - self._half, reading + self._half
        angle = self._angle + step
        self._angle = angle = reading if angle != angle else min(high, max(low, angle))
        return angle
