"""Determine the slip direction of the tendon, sigma in {-1, 0, 1}: friction follows the tendon, not the joint.

If the sheath bends at the distance d from its joint end, tendon b slips at the velocity v, to first order in x and with
T2 + T4 constant:

    v = r_J omega_J + d/(E A) (d tau_J/dt) / (2 r_J)          (tendon a: -v)          sigma = sign(v)

The first term is the joint motion. The second is the tendon elongation when the torque changes. A locked joint has only
the second term, and its torque must be compensated as well. Friction does not depend on the rate, so each term has a
separate rule:

* The joint motion is evaluated by its velocity, extrapolated by the lead, omega_J + L alpha_J, so that the change of
  sigma is centred on the reversal. A velocity within `zone` counts as 0. The zone is at least the velocity noise of one
  encoder count.
* The elongation is evaluated by its travel. While the joint rests, sigma reverses when the desired torque has changed
  back by `play` metres of tendon, at any rate. That torque is known in advance, so the reversal is complete in time.
  After every enable the torque starts from 0, as the set-point does, even if it is already large when it is first
  known.

* The joint torque sensor can contradict. If the delivered torque already exceeds the desired one in the new direction,
  the elongation does not reverse sigma. A joint that creeps back releases as much as the elongation takes up. At rest,
  the sensor also corrects the direction. Sliding tendons deliver at most the desired torque in their direction, because
  the friction term does not exceed the friction (`law`). More torque than that at rest shows that they stick, and that
  they will slide in the other direction. This happens when a hand moves the joint by less than one encoder count. The
  sensor is used only beyond its uncertainty, `UNSURE`, and beyond the error of sensor and model. That error is measured
  while the joint moves, and after the sensor has changed the direction. If the elongation also shows the direction of a
  locked joint, a reversal with a wrong friction delivers too much torque once. The sensor is then used only beyond
  `OVERSHOOT`. If all bends are at the joint, the elongation is the same in both directions, and the sensor alone
  decides.

If a joint comes to rest within `LITTLE` of the travel that reverses the tendons, the tendons have not reversed. This
happens with a trembling hand, or with a sudden stop, whose prediction looks like a reversal. The previous sigma then
applies again.

While nothing slips, friction keeps its last direction. Before the first motion sigma is 0.
Source: (3.29) with the tendon's xi' instead of omega_J; T2 + T4 changes only in second order.
"""

from __future__ import annotations

import math

from tsa_ctrl.control.motion_filter import Motion
from tsa_ctrl.control.settings import DirectionSettings

NOISE = 1.5  # least zone over the velocity noise of one count, because the mechanics also vibrate
LEAST_ZONE = 0.002  # rad/s, smallest zone that may be set while running
LITTLE = 0.05  # of the travel after which the whole tendons slide: a shorter motion has not reversed them
STANDING = 0.05  # s of rest after which a joint counts as standing; a swinging leg reverses in less time
# 1, of that travel, and of the friction torque: a standing joint that moves less, with a smaller set-point, only
# crosses its backlash. On 4 random rigs with 1.1 to 1.9 mrad of it, a small sine has an error of 10 to 29 mN*m instead
# of 76 to 87.
BACKLASH, UNLOADED = 0.1, 0.1
# rad, of that motion: the backlash of a usual joint. Without this bound, a joint with much friction could move five
# times as far, and a human-in-the-loop load had up to 18 % more error on 13 random rigs.
MOST_CROSSED = 3e-3
UNSURE = 0.04  # N*m of a sensor's mean over `MEAN`: three times its noise and delay at 10 N*m/s, as in a gait
# Share of the friction torque. With 0.12, a random rig with prescribed motion had twice the error, and a
# human-in-the-loop load had no smaller error.
OVERSHOOT = 0.25
MEAN = 0.01  # s, time constant of the mean: a motor on its tendons oscillates at 40 Hz and more
SLOWLY = 0.05  # of the mean's rate, at which the error of sensor and model is averaged: 0.2 s
SETTLED = 3.0  # times `MEAN` without a reversal, after which the mean is used
AT_REST = 5e-3  # s of rest after which rest is certain, because a reversal passes the zone in less time
TREMOR = 0.04  # s between two reversals of a trembling hand: the fastest human tremor has 12 Hz (Deuschl 1998)
QUICK = 3  # successive reversals that no hand makes, or that begin before the previous one has acted
BEYOND = 1.5  # of the travel between them, because the term moves the joint farther at some reversals than at others
MOST_PLAY = 0.02  # rad; a joint with more backlash is loose
REMEMBERED = 5.0  # s, memory of the measured backlash; a limit cycle that returns shows it again within 0.1 s


class Direction:
    """Track `sigma`. `age`: periods since a reversal in this cycle, 0 to 1. `rest`: s since the joint last moved."""

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
        unsure: float = math.inf,
        friction: float = 0.0,
    ) -> None:
        """Prepare the rules.

        Args:
            settings: [axis.direction].
            motion: velocity and acceleration of the joint.
            lead: s by which the velocity is extrapolated.
            reach: d/(2 r_J EA), m of tendon per N*m of desired torque, joint at rest.
            joint_radius: r_J, m.
            period: s.
            give: like `reach`, with the joint moving; None if it is the same.
            way: joint travel after which the whole tendons slide, rad.
            unsure: excess of the delivered over the desired torque above which the joint torque sensor decides at rest
                (`measure`), N*m.
            friction: friction torque at the joint, N*m.
        """
        self.lead = lead
        self._motion = motion
        self._floor = NOISE * motion.noise
        self._zone = max(settings.zone, self._floor)
        self._play = settings.play
        self._reach = reach
        self._give = reach if give is None else give
        self._unsure = unsure
        self._radius = joint_radius
        self._period = period
        self._little = LITTLE * way
        self._play_of_joint = min(BACKLASH * way, MOST_CROSSED)
        self._unloaded = UNLOADED * friction
        self._fade = math.exp(-period / REMEMBERED)
        self._mean = period / MEAN if period < MEAN else 1.0
        self._settled = max(1, round(SETTLED * MEAN / period))
        self.reset()

    @property
    def zone(self) -> float:
        """Return the joint speed below which the joint counts as at rest, rad/s."""
        return self._zone

    @zone.setter
    def zone(self, value: float) -> None:
        self._zone = max(value, self._floor)

    @property
    def follows(self) -> bool:
        """Return True within `TREMOR` after a reversal by the joint motion, if none came within `TREMOR` before it."""
        return self._follows and self._since < TREMOR

    @property
    def moving(self) -> bool:
        """Return True if the joint motion, and not the elongation, determines the slip direction."""
        return self.rest == 0.0

    @property
    def missing(self) -> float:
        """Return the joint torque that the sensor shows to be missing because the tendons stick, N*m, 0 or more."""
        return abs(self._excess) if self._needed * self.sigma > 0.0 else 0.0

    def reset(self) -> None:
        """Return to the state before the first motion."""
        self.sigma = 0.0
        self.age = 0.0
        self.rest = math.inf  # the joint has never moved
        self._stood_at = math.nan  # rad, angle of a joint that has rested for `STANDING`
        self._before, self._turned_at = 0.0, math.nan  # direction before the joint's last reversal, and its angle there
        self._follows = False
        self._since = TREMOR  # s since the last reversal
        self._gap, self._quick, self._swung_at = 0.0, 0, math.nan  # rad of backlash, quick reversals in a row, rad
        self.forget()

    def forget(self) -> None:
        """Let the next desired torque start from 0, and keep sigma."""
        self._edge = math.nan
        self._lasting = 0.0  # N*m, mean of the excess over `SETTLED`, reversals included
        self._doubt = 0.0  # N*m, of sensor and model
        self._tried = False  # the sensor has changed the direction, and the effect is not measured yet
        self._needed = 0.0  # direction whose friction the sensor shows to be missing
        self._await()

    def measure(self, excess: float, turning: bool) -> None:
        """Process the difference of the delivered and the desired joint torque of this cycle.

        Args:
            excess: N*m by the joint torque sensor; nan without one.
            turning: True while the friction term reverses.
        """
        if self._unsure == math.inf:
            return
        if excess != excess:
            self._lasting = 0.0
        else:
            self._lasting += self._mean / SETTLED * (excess - self._lasting)
        if turning or excess != excess:
            self._await()
            return
        self._excess += self._mean * (excess - self._excess) if self._counted else excess
        self._counted += 1
        if self._counted < self._settled:
            return
        mean = self._excess
        if self.rest == 0.0:  # the tendons slide
            self._doubt += SLOWLY * self._mean * (abs(mean) - self._doubt)
            return
        if self._tried:
            self._tried = False
            self._doubt = max(self._doubt, abs(mean))
        self._needed = 0.0 if abs(mean) < self._unsure + self._doubt else -1.0 if mean > 0.0 else 1.0

    def _await(self) -> None:
        self._excess = 0.0
        self._counted = 0

    def update(self, ahead: float, rate: float) -> float:
        """Return sigma for this cycle.

        Args:
            ahead: desired joint torque at the end of a reversal that starts now, N*m; nan without torque.
            rate: slope of the desired torque in the middle of that reversal, N*m/s.
        """
        motion = self._motion
        alpha = motion.acceleration
        omega = motion.velocity + self.lead * alpha
        stretch = self._reach * ahead
        self.age = 0.0
        self._since += self._period
        self._gap *= self._fade
        if self._crosses_play(ahead):
            omega = 0.0
        if omega > self._zone or omega < -self._zone:
            self.rest = 0.0
            self._stood_at = math.nan
            if self._needed != 0.0 or self._tried:
                self._needed, self._tried = 0.0, False
            if not abs(motion.angle - self._turned_at) < self._little:
                self._edge = stretch
            slip = self._radius * omega + self._give * rate
            if slip * omega < 0.0 and self._enough(1.0 if slip > 0.0 else -1.0):
                slip = -slip
            if slip * self.sigma <= 0.0 and slip != 0.0:
                turned = 1.0 if slip > 0.0 else -1.0
                if self._in_play() and not self._enough(self.sigma):
                    return self.sigma
                if not self._little_since_turn():
                    self._before, self._turned_at = self.sigma, motion.angle
                elif turned == self._before:
                    self._turned_at = math.nan  # back in the previous direction
                self.sigma = turned
                self._follows, self._since = self._since >= TREMOR, 0.0
                since = abs(omega / alpha) if alpha != 0.0 else 0.0
                self.age = since / self._period if since < self._period else 1.0
            return self.sigma
        self.rest += self._period
        if self.rest > STANDING and self._stood_at != self._stood_at:
            self._stood_at = motion.angle
        if self.rest > AT_REST and self._little_since_turn():
            self._turn(self._before or self.sigma, self._follows)
        if ahead != ahead:
            return self.sigma
        edge = self._edge if self._edge == self._edge else 0.0
        needed = self._needed
        if needed * self.sigma < 0.0:
            self._edge = stretch
            self._turn(needed)
            self._tried = True
        elif stretch > edge + self._play:
            self._edge = stretch - self._play
            if needed >= 0.0 and not self._enough(1.0):
                self._turn(1.0)
        elif stretch < edge - self._play:
            self._edge = stretch + self._play
            if needed <= 0.0 and not self._enough(-1.0):
                self._turn(-1.0)
        else:
            self._edge = edge
        return self.sigma

    def _enough(self, sigma: float) -> bool:
        """Return True if the sensor shows that more than the desired torque is delivered in the direction `sigma`."""
        return self._lasting * sigma > UNSURE

    def _in_play(self) -> bool:
        """Return True if the joint has moved only within its backlash since the last reversal by its motion.

        The friction term itself causes reversals that are faster than a tremor, or that begin before the previous one
        has acted completely, after twice the lead. Each one throws the joint across its backlash, which looks like
        motion in the other direction. The travel between them is the backlash.
        """
        angle = self._motion.angle
        way = abs(angle - self._swung_at)  # nan before the first one
        if way < self._gap:
            return True
        self._quick = self._quick + 1 if self._since < max(TREMOR, 2.0 * self.lead) else 0
        if self._quick >= QUICK:
            self._gap = min(MOST_PLAY, BEYOND * way)
        self._swung_at = angle
        return False

    def _crosses_play(self, ahead: float) -> bool:
        """Return True if a joint that stood has moved only within its backlash, which it crosses with little torque."""
        return abs(ahead) < self._unloaded and abs(self._motion.angle - self._stood_at) < self._play_of_joint

    def _turn(self, sigma: float, follows: bool = False) -> None:
        if sigma != self.sigma:
            self._follows, self._since = follows, 0.0
            self._await()
        self.sigma, self._turned_at = sigma, math.nan

    def _little_since_turn(self) -> bool:
        """Return True if the joint has moved so little since its reversal that the tendons have not reversed."""
        return abs(self._motion.angle - self._turned_at) < self._little
