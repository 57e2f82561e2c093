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

from tsa_ctrl.control.motion import Motion

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
            if not self._little_since_turn():
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
