"""Check sign and gain of the motor torque by the tendon elongation and the joint torque sensor.

A torque stretches the tendons, so motor and joint move apart: q_m - (r_J/r_M) q_j follows tau_M with the sign of the
stiffness. This holds for a locked and for a moving joint and for every load. A joint torque sensor also follows tau_M.
On a locked joint its gain is at most the gain of sliding tendons. This gain is r_J/r_M, or r_J/r_M cosh x if all bends
are at the joint, because the friction decreases with the tensions there. On a moving joint friction reverses with the
motion, not with the torque, and the gain may be larger after a reversal. The sensor is therefore used on a locked joint
only.

All signals are filtered to a band without the motor's oscillation on its tendons and without the drift of the friction.
The low-pass continues through each pause, so a comparison never begins with one sample of an oscillating motor. They
are correlated over the last 0.2 s. Samples before the last friction reversal are excluded for two reasons:

* While a joint moves slowly, friction stretches the tendon against the new torque until the whole tendon slides. This
  takes some joint travel, and during slow motion more than a second.
* In a sheath that bends at the motor, friction may lock the motor until the torque has changed by twice the friction
  torque. If something else moves the joint, the elongation is then only the joint's motion, and contains no information
  on the motor. A reversed motor, however, moves in the wrong direction.

While friction locks the motor, the torque limit does not grow. A short joint motion releases the motor, and the limit
is reset to its small value. If the motor is not released within `FREES`, the limit grows (`HELD`). Otherwise a limit
below the friction torque would stay forever.

On a locked joint the elongation is at most tau_M/K, because friction only reduces it. An elongation 1.5 times as large
has one of three causes. The motor delivers more torque than it reports, a tendon is slack, or the file's stiffness is
too high. On a moving joint friction adds to the elongation, on healthy rigs with bends at the motor up to 1.7 times
tau_M/K.

On the simulated rig with each kind of joint, the measured correlation with the elongation is mostly above 0.8. With a
reversed motor it falls below -0.6 within 0.05 s after the enable. The gain of the joint torque sensor is at most
0.98 r_J/r_M, but 1.3 to 2 times r_J/r_M if the motor delivers twice the reported torque.

After every enable the torque stays small until the sign is confirmed, or until it should have been visible. The
elongation of a rig that is too stiff for its encoders shows no sign, and the rig is not delayed. A constant set-point
shows no sign either, so its torque is released slowly, and this ramp makes the sign visible. The encoders are not used
if one count exceeds the elongation, because a random change of a count would resemble a response. The motor's torque
may differ from the reported one by ripple and gear friction (`UNKNOWN`), which are unknown before `tsa tune`. They
change with motion, so on a joint that moves, a smaller torque shows no wrong sign.
"""

from __future__ import annotations

import math

from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.safety.debounce import Debounce
from tsa_ctrl.safety.residuals import GEARING

SMALL = 0.11  # of the limiter's absolute limit; plus 4 % until a reversed motor is detected: 15 % is safe for a person
COUNTED = 1.5  # counts of both encoders above which the elongation is used: one count of each may change by chance
RIPPLE = 0.005  # of that limit, RMS in the band above which a torque is used: a drive's reading fluctuates by less
SMOOTH = 0.01  # s, low-pass: a motor rings on its tendons at 40 Hz and more
DRIFT = 0.1  # s, high-pass: friction and posture change more slowly
MEMORY = 0.2  # s, time constant of the correlation
UNKNOWN = 0.012  # of that limit, RMS in the band: ripple and gear friction that the drive's reading does not contain
STRONG = 3.0  # times RIPPLE, least torque for a finding of soft tendons: a heavy motor's oscillation adds to less
ALIKE = 0.9  # least correlation of elongation and torque for that finding
SOFTER = 1.5  # of tau_M/K: 1.25 for a stiffness 20 % below the file's value, and the rest for a heavy motor's swing
SLOW = 50.0  # rad/s, largest RMS frequency of the elongation for that finding: a motor swings closer to its resonance
GIVING = 0.04  # s: a heavy motor that a wearer shakes looks the same for 0.025 s, on tendons that are 20 % softer
SHOWN = 0.5  # correlation above which the sign counts as right or wrong
CLEAR = 0.8  # correlation above which the gain at the joint is reported
EXCESS = 1.3  # of the largest gain that is possible at the joint
FAR = 3.0  # of that gain: no torque constant is that wrong, but a hand that starts to move a limb has the same effect
STILL = 0.05  # rad/s of a locked joint: three times the noise of a 16 bit encoder's velocity
AT_REST = 4.0 * DRIFT  # s at rest before the joint's sensor is compared: by then the stop has left the band
TURN = 0.1  # s after a friction reversal: by then the tendon friction, which also changes the elongation, has reversed
WOUND = 1.5  # of the travel that winds up the model's friction: friction and stiffness may each be wrong by 20 %
RESTING = 0.1  # of that travel: with less, the joint is locked, and only the torque elongates its tendons
OWN = 0.5  # share of the elongation by the motor's own motion: normally 1 or more, but 0 if friction locks the motor
LAST = 0.02  # s for which sign or gain must be wrong, on a joint that did not move before the motor pulled
SURE = 0.25  # s, on a joint that something else moves: friction looks the same for 0.18 s
SHAKEN = 0.4  # s, after the sign was confirmed: a heavy motor that is shaken on its tendons looks reversed for 0.3 s
GROWTH = 0.2  # s in which the torque may then grow to the limit, without a step that a person feels
RESTS = 0.1  # s after which a constant torque may grow slowly, so that this growth shows its sign
SLOWLY = 2.0  # s in which this growth would reach the limit: a reversed torque is detected within 20 ms of the ramp
FREES = 0.5  # s in which joint motion may release a motor locked by friction: its limit does not grow during this time
HELD = 0.5  # s to the limit while friction locks the motor: until the motor slides, no torque reaches the joint
PATIENCE = 0.15  # s with a torque above RIPPLE after which the torque grows although the sign was not confirmed


class PolarityCheck:
    """Check the polarity of one axis. Call `update` in each fresh cycle with torque permitted, and `reset` otherwise.

    Attributes:
        ceiling: present limit of the torque, N*m.
    """

    def __init__(
        self,
        limit: float,
        geared: float,
        period: float,
        wound: float,
        counts: float,
        stiffness: float,
        slope: float,
    ) -> None:
        """Prepare the check.

        Args:
            limit: torque limit of the limiter, N*m.
            geared: r_J/r_M, 1.
            period: control period, s.
            wound: change of the elongation by friction between the two directions of sliding, rad at the motor.
            counts: one count of each encoder, rad at the motor.
            stiffness: stiffness at the motor, N*m/rad; 0 if it is too uncertain for this check.
            slope: largest d tau_J/d tau_M over r_J/r_M, 1.
        """
        self._stiffness = stiffness
        self._strong = (STRONG * RIPPLE * limit) ** 2
        self._slow = (SLOW * period) ** 2
        self._limit = limit
        self._finest = COUNTED * counts
        self._unknown = UNKNOWN * limit
        self._least = (RIPPLE * limit) ** 2
        self._arrives = (geared * RIPPLE * limit) ** 2
        self._gain = geared * slope
        self._way = WOUND * wound
        self._travel_step = geared * period
        self._period = period
        self._rates = tuple(1.0 - math.exp(-period / time) for time in (SMOOTH, DRIFT))
        self._memory = 1.0 - math.exp(-period / MEMORY)
        self._reversed, self._turned, self._excessive = Debounce(LAST), Debounce(SURE), Debounce(LAST)
        self._altered, self._gives = Debounce(SHAKEN), Debounce(GIVING)
        self.reset()

    def reset(self) -> None:
        """Reset the check while torque is not permitted. The next enable repeats it."""
        self.ceiling = SMALL * self._limit
        self._waited = 0.0
        self._resting = False  # True while nothing is compared
        self._held_for = 0.0  # s since friction locked the motor; inf once the joint's motion has released it
        self._shown = False
        self._judged = 0.0  # s for which signals were compared
        self._begun = math.inf
        self._moved = -math.inf
        self._pulled = self._driven = self._suspect = self._fast = False
        for clock in (self._reversed, self._turned, self._altered, self._gives, self._excessive):
            clock.reset()
        self._start_filters()
        self._begin(0.0, -math.inf)

    def _start_filters(self) -> None:
        self._torque, self._apart, self._joint = (_Band(*self._rates) for _ in range(3))

    def _begin(self, direction: float, until: float) -> None:
        """Pause the comparison until the time `until` (s), and then start it again."""
        self._direction = direction
        self._until = until
        self._travel = 0.0  # rad at the motor since the last friction reversal
        self._winding = False
        self._forget()

    def _forget(self) -> None:
        """Discard all observations."""
        for band in (self._torque, self._apart, self._joint):
            band.restart()
        self._yields = _Band(*self._rates)
        self._least_apart, self._most_apart = math.inf, -math.inf
        self._tt = self._ta = self._aa = self._dd = self._tj = self._jj = self._ty = self._ay = self._yy = 0.0
        self._stretch = 0.0
        self._forget_sensor()

    def _forget_sensor(self) -> None:
        """Discard the sensor data of a locked joint, because the joint moves."""
        self._held_tt = self._held_tj = self._held_jj = 0.0

    def update(
        self, now: float, torque: float, apart: float, tau_j: float, sigma: float, omega_j: float
    ) -> Finding | None:
        """Return the finding, or None without one. Each measurement is nan if unknown.

        Args:
            now: time, s.
            torque: motor torque that the drive reports, N*m.
            apart: motor angle minus geared joint angle, rad.
            tau_j: torque of the joint torque sensor, N*m.
            sigma: direction of the tendon's motion in the law, 1.
            omega_j: joint velocity, rad/s.
        """
        if not abs(omega_j) < STILL:
            self._moved = now
            if not self._pulled:
                self._driven = True
        if self._shown:
            self.ceiling += self._limit * self._period / GROWTH
            if self.ceiling >= self._limit:
                self.ceiling = math.inf
        else:
            self._begun = min(self._begun, now)
            if 0.0 < self._held_for < FREES:
                self._held_for += self._period
                if abs(self._travel) > self._way:  # the motor is released, so the torque now shows its sign
                    self._held_for = math.inf
                    self.ceiling = SMALL * self._limit
            elif self._held_for == 0.0 and self._fast:
                self._held_for = self._period
            if now - self._begun > RESTS and not self._suspect and not 0.0 < self._held_for < FREES:
                self.ceiling += self._limit * self._period / (HELD if self._fast else SLOWLY)
        direction = (sigma > 0.0) - (sigma < 0.0)
        if direction != self._direction:
            self._driven = self._driven or self._pulled  # joint and tendons still oscillate from before the reversal
            self._begin(direction, now + TURN)
        if omega_j == omega_j:
            self._travel += self._travel_step * omega_j
        held = now - self._moved > AT_REST
        if self.ceiling == math.inf and not held:  # `residuals` checks a moving joint
            self._resting = True
            return None
        if self._resting:
            self._resting = False
            self._start_filters()
            self._forget()
        if now < self._until:
            for band, value in ((self._torque, torque), (self._apart, apart), (self._joint, tau_j)):
                band.of(value)
                band.restart()
            return None
        winds_up = self._winds_up()
        if winds_up is not self._winding:  # observations of one state are not valid in the other
            self._winding = winds_up
            self._forget()
        if apart == apart:
            self._least_apart = min(self._least_apart, apart)
            self._most_apart = max(self._most_apart, apart)
        memory = self._memory
        t, a, j = self._torque.of(torque), self._apart.of(apart), self._joint.of(tau_j)
        self._tt += memory * (t * t - self._tt)
        self._ta += memory * (t * a - self._ta)
        y = self._yields.of(self._travel)
        self._ty += memory * (t * y - self._ty)
        self._ay += memory * (a * y - self._ay)
        self._yy += memory * (y * y - self._yy)
        self._aa += memory * (a * a - self._aa)
        self._dd += memory * ((a - self._stretch) ** 2 - self._dd)
        self._stretch = a
        self._tj += memory * (t * j - self._tj)
        self._jj += memory * (j * j - self._jj)
        if held:
            self._held_tt += memory * (t * t - self._held_tt)
            self._held_tj += memory * (t * j - self._held_tj)
            self._held_jj += memory * (j * j - self._held_jj)
        else:
            self._forget_sensor()
        if self._tt < self._least:
            self._suspect = self._fast = False  # a constant torque shows no sign, so an earlier suspicion is dropped
            return None
        self._pulled = True
        by_stretch = self._by_stretch()
        seen = self._most_apart - self._least_apart > self._finest
        sense = by_stretch if seen else 0.0
        if not seen and self._jj > self._arrives:
            sense = _correlation(self._tj, self._tt * self._jj)
        opposes = sense < -SHOWN
        self._fast = opposes and seen and self._held_fast()
        self._suspect = opposes and not self._fast
        if not opposes:
            self._waited += self._period
        if (sense > SHOWN and not winds_up) or self._waited > PATIENCE:
            self._shown = True
        if winds_up:
            return None
        self._judged = now = self._judged + self._period  # these clocks stop while nothing is compared
        self._driven = self._driven or (self._fast and abs(self._travel) > RESTING * self._way)
        wrong = self._altered if self._shown else self._turned if self._driven else self._reversed
        enough = wrong is self._reversed or self._tt > self._unknown * self._unknown  # ripple changes only with motion
        if wrong.update(now, self._suspect and enough):
            return Finding(
                Cause.POLARITY, "the motor turns the wrong way, or the sign of a torque or of an encoder is reversed"
            )
        softer = self._stiffness * self._ta / self._tt
        beyond = SOFTER * (1.0 + self._unknown / math.sqrt(self._tt))
        slow = self._dd < self._slow * self._aa and self._tt > self._strong and seen
        if self._gives.update(now, held and slow and softer > beyond and by_stretch > ALIKE):
            return Finding(
                Cause.SOFT_TENDONS,
                f"the tendons give {softer:.1f} times the elongation expected from the motor torque: the motor gives "
                "more than it reports, a tendon hangs, or axial_stiffness is that much too high",
            )
        gain = self._held_tj / self._held_tt if self._held_tt > self._least else 0.0
        most = EXCESS * self._gain * (1.0 + self._unknown / math.sqrt(self._held_tt)) if gain > 0.0 else math.inf
        follows = _correlation(self._held_tj, self._held_tt * self._held_jj) > CLEAR
        if self._excessive.update(now, follows and most < gain < FAR * self._gain):
            return Finding(
                Cause.TORQUE_GAIN,
                f"the joint torque sensor follows the motor's torque by {gain:.2f}, the pulleys give "
                f"{self._gain:.2f}: the motor gives more than it reports, or a torque's scale is wrong",
            )
        return None

    def _by_stretch(self) -> float:
        """Return the correlation of torque and elongation, corrected for an error of the radii."""
        share = self._ay / self._yy if self._yy > 0.0 else 0.0
        share = min(max(share, -GEARING), GEARING)
        product = self._ta - share * self._ty
        return _correlation(product, self._tt * (self._aa - 2.0 * share * self._ay + share * share * self._yy))

    def _held_fast(self) -> bool:
        """Return True if only the joint's motion causes the elongation, before the whole tendons slide again."""
        return abs(self._travel) < self._way and self._ta + self._ty > OWN * self._ta

    def _winds_up(self) -> bool:
        """Return True while an externally moved joint has not yet moved far enough for its whole tendons to slide."""
        driven = self._shown or self._driven
        return driven and RESTING * self._way < abs(self._travel) < self._way


def _correlation(product: float, squares: float) -> float:
    return product / math.sqrt(squares) if squares > 0.0 else 0.0


class _Band:
    """A low-pass and a high-pass filter, initialised with the first sample that is not nan."""

    def __init__(self, quick: float, slow: float) -> None:
        self._quick = quick
        self._slow = slow
        self._smooth = self._drift = math.nan

    def restart(self) -> None:
        """Restart the high-pass at the present value of the low-pass."""
        self._drift = self._smooth

    def of(self, value: float) -> float:
        if value != value:
            return 0.0
        if self._smooth != self._smooth:
            self._smooth = self._drift = value
        self._smooth += self._quick * (value - self._smooth)
        self._drift += self._slow * (self._smooth - self._drift)
        return self._smooth - self._drift
