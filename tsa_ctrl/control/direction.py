"""Direction of the tendon's slip, sigma in {-1, 0, 1}: friction follows the tendon in its sheath, not the joint.

Where the bending sits at the distance d from the joint end, tendon b slips, to first order in x and with T2 + T4
constant, with

    v = r_J omega_J + d/(E A) (d tau_J/dt) / (2 r_J)          (tendon a: -v)          sigma = sign(v)

The first term is what the joint moves, the second what the tendon stretches when the torque changes; a held joint has
the second alone, and torque must reach it, too. Friction does not depend on rate, so each has a rule of its own:

* the joint's motion by speed, taken ahead by the lead, omega_J + L alpha_J, so that a turn is centred on the reversal.
  Within `zone` it counts as 0; the zone is never narrower than what one count of the encoder makes of it.
* the stretch by travel: with the joint at rest sigma turns when the torque wanted has turned back by `play` metres of
  tendon, however slowly. That torque is known ahead, so the turn is over when it is needed. After every enable it
  begins from none, as the set-point does, even where all of it lies ahead when it is first seen.

A joint that comes to rest within `LITTLE` of the way that it takes to turn the tendons has turned nothing: a hand's
trembling, or a stop at once, which looks like a reversal when that must be foretold. Then all is as before.

Where nothing slips, friction keeps its last direction. Before anything has moved there is none: 0.
Source: (3.29) with its own xi' instead of omega_J; T2 + T4 moves in the second order alone.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
from msgspec import Meta

# How the joint moves now: velocity and acceleration from its angles, not late while the acceleration is steady.
#
# q' = q + dt omega + dt^2 alpha / 2,    omega' = omega + dt alpha,    r = angle - q'
# q = q' + (1 - m^3) r,    omega = omega' + 3/2 (1 - m)^2 (1 + m) r / dt,    alpha = alpha' + (1 - m)^3 r / dt^2
#
# This is the parabola through all angles, each of which weighs m times what the next one weighs: a fading-memory
# filter of second degree (N. Morrison, Introduction to Sequential Smoothing and Prediction, 1969, chapter 13). A low-
# pass on differences is late instead, and a reversal must be seen before it comes. A memory dt/(1 - m) is as long as
# the encoder's steps ask: one count moves `noise` (rad/s) at most, found by feeding it one.

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


NOISE = 1.5  # times one count's velocity that the zone is at least: a count and the mechanics' own trembling
LEAST_ZONE = 0.002  # rad/s, that may be set while running
LITTLE = 0.05  # of the way in which the tendons slide all along: a joint that went no further has turned nothing
AT_REST = 5e-3  # s of rest after which that is said: a reversal passes the zone in less
TREMOR = 0.04  # s between two turns of a hand that trembles: 12 Hz is the fastest tremor of people (Deuschl 1998)


class DirectionSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.direction]."""

    zone: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.005  # rad/s of the joint that count as 0; more with few counts
    play: Annotated[float, Meta(gt=0.0, le=1e-3)] = 1e-6  # m of tendon that the torque wanted must turn back


class Direction:
    """`sigma`, and how it was found: `age`: periods since the reversal, 0 to 1; `rest`: s since the joint moved."""

    def __init__(
        self,
        settings: DirectionSettings,
        motion: Motion,
        lead: float,
        reach: float,
        joint_radius: float,
        period: float,
        give: float | None = None,
        way: float = 0.0,
    ) -> None:
        """`lead` and `period` in s; `reach`: d/(2 r_J EA), m of tendon per N*m wanted; `joint_radius` r_J in m.

        `give`: the same while the joint moves, where it is not as much; at rest even tendons that are bent at the joint
        alone turn by what the motor winds up. `way`: rad of the joint, in which the tendons slide all along.
        """
        self.lead = lead
        self._motion = motion
        self._floor = NOISE * motion.noise
        self._zone = max(settings.zone, self._floor)
        self._play = settings.play
        self._reach = reach
        self._give = reach if give is None else give
        self._radius = joint_radius
        self._period = period
        self._little = LITTLE * way
        self.reset()

    @property
    def zone(self) -> float:
        """rad/s of the joint that count as standstill."""
        return self._zone

    @zone.setter
    def zone(self, value: float) -> None:
        self._zone = max(value, self._floor)

    @property
    def follows(self) -> bool:
        """Whether the last turn followed the joint of late, and none came sooner before it than a hand trembles."""
        return self._follows and self._since < TREMOR

    @property
    def moving(self) -> bool:
        """Whether the joint's motion, and not the stretch, says where the tendon slips."""
        return self.rest == 0.0

    def reset(self) -> None:
        """Nothing has moved."""
        self.sigma = 0.0
        self.age = 0.0
        self.rest = math.inf  # it has never moved
        self._before, self._turned_at = 0.0, math.nan  # the direction before the joint's last turn, and its angle then
        self._follows = False
        self._since = TREMOR  # s since the last turn
        self.forget()

    def forget(self) -> None:
        """There is no torque wanted, and the next one begins from none; the last direction stays."""
        self._edge = math.nan

    def update(self, ahead: float, rate: float) -> float:
        """sigma for this cycle.

        `ahead`: the torque wanted at the joint, N*m, when a turn that begins now is over, nan without one; `rate`: how
        fast it changes in the middle of that turn, N*m/s.
        """
        motion = self._motion
        alpha = motion.acceleration
        omega = motion.velocity + self.lead * alpha
        stretch = self._reach * ahead
        self.age = 0.0
        self._since += self._period
        if omega > self._zone or omega < -self._zone:
            self.rest = 0.0
            if not abs(motion.angle - self._turned_at) < self._little:
                self._edge = stretch
            slip = self._radius * omega + self._give * rate
            if slip * self.sigma <= 0.0 and slip != 0.0:
                turned = 1.0 if slip > 0.0 else -1.0
                if not self._little_since_turn():
                    self._before, self._turned_at = self.sigma, motion.angle
                elif turned == self._before:
                    self._turned_at = math.nan  # back again: as before
                self.sigma = turned
                self._follows, self._since = self._since >= TREMOR, 0.0
                since = abs(omega / alpha) if alpha != 0.0 else 0.0
                self.age = since / self._period if since < self._period else 1.0
            return self.sigma
        self.rest += self._period
        if self.rest > AT_REST and self._little_since_turn():
            self._turn(self._before or self.sigma, self._follows)
        if ahead != ahead:
            return self.sigma
        edge = self._edge if self._edge == self._edge else 0.0
        if stretch > edge + self._play:
            self._edge = stretch - self._play
            self._turn(1.0)
        elif stretch < edge - self._play:
            self._edge = stretch + self._play
            self._turn(-1.0)
        else:
            self._edge = edge
        return self.sigma

    def _turn(self, sigma: float, follows: bool = False) -> None:
        if sigma != self.sigma:
            self._follows, self._since = follows, 0.0
        self.sigma, self._turned_at = sigma, math.nan

    def _little_since_turn(self) -> bool:
        """Whether the joint has gone so little since it turned that its tendons still lie as they did."""
        return abs(self._motion.angle - self._turned_at) < self._little
