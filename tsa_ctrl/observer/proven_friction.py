"""Measure the present friction torque at the motor from the sensors of an axis, with 95 % bounds.

While the tendons slide in the direction sigma, the friction torque h (half the hysteresis width) is the part of the
motor torque that does not reach the joint:

    h = sigma (tau_M - J_M alpha_M - tau_J / a)                        joint torque sensor, a the slope of the model
    h = sigma (s_0 + kappa q_J + gamma tau - y) P_t / R                elongation, R = r_J/r_M

    y = s - (R + Q)/P tau,    s = r_M q_M - r_J q_J,    tau = tau_M - J_M alpha_M
    P_t = (R + Q) / ((R + Q)/P + gamma)

`tsa_ctrl.model.stretch` defines P and Q. The zero s_0, the error of the radii kappa, the error of the compliance
gamma and the mean friction g follow from least squares over the strokes so far, y = s_0 + kappa q_J + gamma tau -
sigma m g. m is the model's friction torque at the present wrap angle over its value at the nominal wrap angle. The fit
therefore determines the ratio of the true friction to the modelled one, also while other joints bend the sheath. One
direction alone determines only s_0 - g. The covariance then makes the lower bound 0 and the upper bound infinite. Once
a fit of whole strokes is certain enough, it changes only between two strokes, so that a loss of friction is detected
within a stroke.
One stroke in each direction determines only the sum of two frictions: g in both, or h in the first and 2 g - h in the
second. Until a third stroke agrees, h may be as large as the model file permits, and 2 g - h is the lower bound.
A third stroke that disagrees replaces the first one.

A reading is stored relative to the model's friction torque at that time, so that it is valid at other wrap angles.

Samples are weighted by joint travel, not by time: the work of a wrong torque grows with the travel, as does the
evidence of a stroke. After a reversal, the friction front must first run through the whole sheath. Until then, at rest,
and while the law reverses its friction term, the last values of both directions remain valid.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import reversal_travel, sliding
from tsa_ctrl.model.stretch import compliance_centre, stretch_line
from tsa_ctrl.observer.stretch import RESTART, StretchObserver, StretchState

SLIDES = 0.05  # rad/s of the joint above which it slides: three times the noise of a 16 bit encoder's velocity
GATE = 1.0  # of the joint travel in which a reversal runs through the sheath; samples are used only after it
SMOOTH = 0.01  # rad of the joint over which a reading is averaged: 6 mJ of a friction torque of 0.6 N*m
# s over which a reading is also averaged if the motor inertia is unknown. The motor's oscillation on its tendons, at
# 40 Hz and more, then looks like oscillating friction, and a limit that follows it excites the oscillation. 0.025 s is
# too short: on a rig that rings at 42 Hz, the motor still reached its speed limit.
RINGS = 0.1
SAMPLE = 0.05  # rad of the joint that count as one independent sample
NOISE = 0.03  # of the elongation that friction causes: standard deviation of a sample by creep, ripple, counts
MEMORY = 1.5  # rad of the joint after which older strokes have the weight 1/e
RADIUS_PRIOR = 0.01  # 1, standard deviation of r_J/r_M: the effective pulley radii are known within 1 %
# 1, error of the radii (95 %) up to which the stiffness of the elongation observer is used, because larger errors may
# mislead that observer
RIGHT_RADII = 0.001
LEARNED = 0.02  # 1, least standard deviation of that stiffness, because of an unknown curvature profile in reversals
SURE = 1.65  # standard deviations of a one-sided 95 % bound
CERTAIN = 0.1  # of the friction torque: standard deviation below which the fit of whole strokes is kept within a stroke
UNLIKE = 2.0  # times the variance of a sample: friction has changed in a stroke that adds more than this to the misfit
MOST_SKIPPED = 4  # successive strokes without a fit, after which the zero must have moved: a tendon or encoder slipped
REPEATED = 2  # strokes before the third one, which repeats a direction
AGREES = 3.0  # standard deviations by which the third stroke may differ from the first two
AVERAGED = 3.0 * SMOOTH  # rad of the joint after which 95 % of a reading come from the present stroke
FIT_EVERY = 32  # cycles between two fits within a stroke, which limits the computing time
ALIKE = 1.25  # largest ratio of the frictions in both directions: they use the same sheaths, so more is a wrong zero
LEAST = 0.05  # of the nominal friction torque: least scale of a reading, because a straight sheath has no friction
SENSOR_GAIN, SENSOR_ZERO = 0.03, 0.01  # 1, sensor errors by data sheet: of the joint torque, and of the friction torque


class ProvenFriction:
    """Measure the friction torque from a joint torque sensor, or without one from the elongation, in sliding tendons.

    Attributes: `low`, `high`: bounds of the friction torque at the motor, N*m; 0 and inf while unproven.
    `reads`: True if this cycle has a reading, False if the bounds come from earlier cycles.
    `modelled`: friction torque of the model file at the present wrap angle, N*m at the motor.
    `slopes`: d tau_J / d tau_M of the model with a joint that moves forward and backward, 1.
    `trusted`: True if a tuning of this joint wrote the model file, so that the interval of its calibration is used.
    """

    def __init__(
        self,
        model: TendonSheath,
        period: float,
        inertia: float,
        has_sensor: bool,
        observer: StretchObserver | None = None,
    ) -> None:
        """Prepare the lines of the model.

        Args:
            model: its radii, stiffness and curvature profile are used, not its friction.
            period: s, of the loop.
            inertia: kg*m^2 of the motor, 0 if unknown.
            has_sensor: True if the joint torque is measured.
            observer: the elongation observer, None without a joint encoder. It estimates the stiffness, which the
                strokes alone determine only while the set-point varies.
        """
        self._period = period
        self._inertia = inertia
        self._rings = 0.0 if inertia > 0.0 else RINGS
        r_m, r_j = model.motor_pulley_radius, model.joint_pulley_radius
        self._r_m, self._r_j = r_m, r_j
        self._expected = abs(sliding(model).motor_half_loop)
        self._least = LEAST * self._expected + 1e-9
        self.modelled = max(self._expected, self._least)
        self.slopes = sliding(model, 1.0).slope, sliding(model, -1.0).slope
        self._gate = GATE * reversal_travel(model)
        self._ratio = r_j / r_m
        self._has_sensor = has_sensor
        self._observer = observer
        self.usable = has_sensor
        self._shape = 0.0
        self._uncertain, self._calibrated = _most_friction(model)
        self.trusted = False
        if not has_sensor and observer is not None:
            line = stretch_line(model)
            self.usable = True
            self._compliance = (self._ratio + line.per_torque) / line.per_stretch  # m per N*m
            self._whole = self._ratio + line.per_torque
            self._shape = model.bending_centre_uncertainty / 1.96 / (1.0 - compliance_centre(model))
            gap = max(self._expected, 1e-6) * self._ratio / line.per_stretch  # m by friction, half the hysteresis
            self._noise = NOISE * gap
            self._stiffness = model.axial_stiffness_uncertainty
            error = max(self._stiffness / 1.96, 1e-6) * self._compliance
            spread = (40.0 * gap, RADIUS_PRIOR * r_j, error, 4.0 * gap)
            self._prior = np.array([(self._noise / each) ** 2 for each in spread])
        self.reset()

    def reset(self) -> None:
        """Reset all states, including the zero of the elongation."""
        self._origin = math.nan
        self._kept = _Sums(np.zeros((4, 4)), np.zeros(4), 0.0)
        self._variance = 0.0  # m^2, variance of a sample by the last fit
        self._skipped = 0  # successive strokes that no fit explains
        self._strokes = 0  # finished strokes; successive strokes in one direction count once
        self._counted = 0  # direction of the last finished stroke
        self._is_repeated = self._has_sensor  # True once the third stroke has been read
        self._repeated = 0.0  # rad, joint travel over which the third stroke was read
        self._last = _Sums(np.zeros((4, 4)), np.zeros(4), 0.0)  # the last finished stroke
        self._mean = math.nan  # 1, friction torque of both directions by the fit, over the file's value
        self._fit, self._scale = (0.0, 0.0, 0.0), 0.0
        self._covariance: tuple[float, ...] = ()  # upper triangle of the fit's covariance; empty before the first fit
        self._settled = False
        self._read = [math.nan, math.nan]  # 1, readings over the model's friction torque, by direction
        self._spread = [math.inf, math.inf]
        self._held = math.nan  # N*m, `modelled` of bounds that come from earlier readings; nan after a reading
        self.low, self.high, self.reads = 0.0, math.inf, False
        self._forward = True
        self._direction, self._gap, self._until = 0, 0.0, FIT_EVERY
        self._sums: tuple[float, ...] = ()
        self._begin_stroke()
        self.pause()

    @property
    def certain(self) -> bool:
        """Return True while strokes in both directions determine the friction to `CERTAIN`.

        A long motion in one direction ends this, because the zero of the elongation may depend on the angle.
        """
        return self._settled and self._spread[1 if self._forward else 0] < CERTAIN

    @property
    def sliding(self) -> int:
        """Return the direction in which the tendons slide, 1 or -1; 0 without a reading in this cycle."""
        return self._direction if self.reads else 0

    def pause(self) -> None:
        """Skip a cycle without torque; the gate after a reversal starts again."""
        self.reads = False
        self._omega = math.nan
        self._way = self._gap = 0.0

    def miss(self, seconds: float) -> None:
        """Skip `seconds` without measurements; reset after a long gap, because an encoder may have restarted."""
        self.reads = False
        self._omega = math.nan
        self._gap += seconds
        if self._gap > RESTART:
            self.reset()

    def update(
        self,
        tau_m: float,
        omega_m: float,
        q_m: float,
        q_j: float,
        tau_j: float,
        velocity: float,
        turning: bool,
        modelled: float,
    ) -> None:
        """Process the measurements of one cycle.

        Args:
            tau_m, omega_m, q_m: torque, speed and angle of the motor, N*m, rad/s, rad.
            q_j, velocity: angle and velocity of the joint, rad, rad/s.
            tau_j: torque of the joint torque sensor, N*m; nan without one.
            turning: True while the law reverses its friction term.
            modelled: friction torque of the model at the present wrap angle, N*m.
        """
        if not self.usable:
            return
        self.modelled = modelled if modelled > self._least else self._least
        self.reads = False
        self._gap = 0.0
        last, self._omega = self._omega, omega_m
        if not -SLIDES < velocity < SLIDES:
            direction = 1 if velocity > 0.0 else -1
            if direction != self._direction:
                self._way = 0.0
                self._end_stroke()
                self._direction = direction
            way = abs(velocity) * self._period
            self._way += way
            if self._way > self._gate and not turning and last == last:
                tau = tau_m - self._inertia * (omega_m - last) / self._period
                self._forward = direction > 0
                if self._has_sensor:
                    friction = direction * (tau - tau_j / self.slopes[direction < 0])
                    error = SENSOR_GAIN * abs(tau_j) / self._ratio + SENSOR_ZERO * self._expected
                    self._take(direction, friction, way, error / SURE)
                else:
                    self._take_elongation(direction, self._r_m * q_m - self._r_j * q_j, q_j, tau, way)
                return
        else:
            self._way = 0.0
        if self._held != self.modelled:
            self._held = self.modelled
            reads = [each for each in self._read if each == each]
            if reads:
                self._bound(min(reads), max(self._spread[k] for k in (0, 1) if self._read[k] == self._read[k]))

    def _take_elongation(self, direction: int, elongation: float, q_j: float, tau: float, way: float) -> None:
        if self._origin != self._origin:
            self._origin, self._angle = elongation, q_j
        y = elongation - self._origin - self._compliance * tau
        q = q_j - self._angle
        weight = way / SAMPLE
        bent = self.modelled / self._expected
        wq, wt, wy, wm = weight * q, weight * tau, weight * y, weight * bent
        n, sq, st, sqq, sqt, stt, sy, syq, syt, syy, sm, smm, smq, smt, smy = self._sums
        n += weight
        self._sums = (
            n, sq + wq, st + wt, sqq + wq * q, sqt + wq * tau, stt + wt * tau,
            sy + wy, syq + wy * q, syt + wy * tau, syy + wy * y,
            sm + wm, smm + wm * bent, smq + wm * q, smt + wm * tau, smy + wm * y,
        )  # fmt: skip
        if not self._settled and n >= 1.0:
            self._until -= 1
            if self._until <= 0:
                self._until = FIT_EVERY
                self._fit_to(self._kept.plus(self._stroke()), False)
        if not self._covariance:
            return
        zero, kappa, gamma = self._fit
        scale = self._scale
        friction = direction * (zero + kappa * q + gamma * tau - y) * scale
        a, b, c, d, e, f = self._covariance
        v = tau - direction * friction / (scale * (self._compliance + gamma))
        variance = a + q * (2.0 * b + d * q) + v * (2.0 * c + 2.0 * e * q + f * v)
        self._take(direction, friction, way, scale * math.sqrt(variance) if variance > 0.0 else 0.0)

    def _take(self, direction: int, friction: float, way: float, deviation: float) -> None:
        """Average a reading over the joint travel, and update the bounds.

        Args:
            direction: 1 or -1.
            friction: N*m at the motor.
            way: rad, joint travel in this cycle.
            deviation: N*m, standard deviation of the reading.
        """
        if not math.isfinite(friction):
            return
        side = 1 if direction > 0 else 0
        value, found = self._read[side], friction / self.modelled
        if value == value:
            smooth = SMOOTH + self._rings * way / self._period
            found = value + way / (smooth + way) * (found - value)
        value = found
        self._read[side], self._spread[side] = value, deviation / self.modelled
        if not self._is_repeated and self._strokes >= REPEATED and direction != self._counted:
            self._repeated += way
            agrees = abs(value - self._mean) <= AGREES * self._spread[side]
            self._is_repeated = self._repeated > AVERAGED and agrees and self._settled
        self.reads = True
        self._held = math.nan
        self._bound(value, self._spread[side])

    def _bound(self, share: float, deviation: float) -> None:
        modelled = self.modelled
        doubt = SURE * math.hypot(deviation, self._shape * share)
        if not self._is_repeated:
            most = self._calibrated if self.trusted else self._uncertain
            doubt += max(0.0, most - share)
        low, high = share - doubt, share + doubt
        if low > 0.0:  # a direction without a reading is nan and does not limit the bound
            for read in self._read:
                if low > ALIKE * read:
                    low = ALIKE * read
        self.low = low * modelled if low > 0.0 else 0.0
        self.high = high * modelled if high > 0.0 else 0.0

    def _begin_stroke(self) -> None:
        self._sums = (0.0,) * 15
        self._until = FIT_EVERY

    def _end_stroke(self) -> None:
        """Add the finished stroke to the fit of zero, radii and compliance, unless friction changed within it."""
        stroke, n = self._stroke(), self._sums[0]
        self._begin_stroke()
        if not n > 0.0:
            return
        last, again = self._last, self._counted == self._direction
        self._last, self._counted = (last.plus(stroke) if again else stroke), self._direction
        if not self._is_repeated:
            both = self._kept.faded(math.exp(-n * SAMPLE / MEMORY)).plus(stroke)
            changed = self._misfit(both) - self._misfit(self._kept) >= UNLIKE * max(n, 1.0)
            if changed and self._strokes >= REPEATED and not again:  # friction changed: use the last two strokes only
                both, self._settled = last.plus(stroke), False
            self._strokes += not again
            self._repeated = 0.0
            self._kept = both
            self._fit_to(both, True)
            return
        for before in (self._kept, _without_friction(self._kept)):
            both = before.faded(math.exp(-n * SAMPLE / MEMORY)).plus(stroke)
            if not self._settled or self._misfit(both) - self._misfit(before) < UNLIKE * max(n, 1.0):
                self._kept, self._skipped = both, 0
                self._fit_to(both, True)
                return
        self._kept = _without_friction(self._kept)
        self._skipped += 1
        if self._skipped > MOST_SKIPPED:
            self.reset()

    def _stroke(self) -> _Sums:
        n, q, t, qq, qt, tt, y, yq, yt, yy, m, mm, mq, mt, my = self._sums
        sigma = -float(self._direction)  # times m, the regressor of the friction
        normal = [
            [n, q, t, sigma * m],
            [q, qq, qt, sigma * mq],
            [t, qt, tt, sigma * mt],
            [sigma * m, sigma * mq, sigma * mt, mm],
        ]
        return _Sums(np.array(normal), np.array([y, yq, yt, sigma * my]), yy)

    def _misfit(self, sums: _Sums) -> float:
        """Return the residual sum of squares of a fit, prior included, over the variance of a sample."""
        found = np.linalg.solve(sums.normal + np.diag(self._prior), sums.target)
        return (sums.left(found) + float(found @ (self._prior * found))) / max(self._noise**2, self._variance)

    def _fit_to(self, sums: _Sums, whole: bool) -> None:
        """Fit zero, radii, compliance and friction; `whole`: True between strokes, False within one."""
        prior, mean = self._prior.copy(), np.zeros(4)
        samples = max(float(sums.normal[0, 0]), 1.0)
        for again in (False, True):
            covariance = np.linalg.inv(sums.normal + np.diag(prior))
            found = covariance @ (sums.target + prior * mean)
            self._variance = sums.left(found) / samples
            covariance = covariance * max(self._noise**2, self._variance)
            if again or not self._learned(float(found[1]), math.sqrt(float(covariance[1, 1])), mean, prior):
                break
        zero, kappa, gamma = (float(each) for each in found[:3])
        self._fit = (zero, kappa, max(gamma, -0.5 * self._compliance))
        self._scale = self._whole / (self._compliance + self._fit[2]) / self._ratio  # N*m per m of elongation
        self._covariance = tuple(float(covariance[i, j]) for i in range(3) for j in range(i, 3))
        if self._settled:
            return
        # Readings by an earlier, less certain fit are replaced by the mean friction of this fit.
        deviation = self._scale * math.sqrt(max(0.0, float(covariance[3, 3])))
        if deviation < CERTAIN * self._expected:
            self._settled = whole
            self._held = math.nan
            self._mean = self._scale * float(found[3]) / self._expected
            self._read = [self._mean] * 2
            self._spread = [deviation / self._expected] * 2

    def _learned(self, kappa: float, deviation: float, mean: Array, prior: Array) -> bool:
        """Set the prior of gamma from the stiffness of the observer and return True if that stiffness is usable.

        It is not usable without an estimate, if the radii may be wrong by more than `RIGHT_RADII`, or if it is outside
        [uncertainty]. `mean` and `prior` are changed in place.
        """
        observer = self._observer
        if observer is None or observer.state is not StretchState.ESTIMATED:
            return False
        if abs(kappa) > 1.96 * deviation + RIGHT_RADII * self._r_j:
            return False
        softer = 1.0 / observer.stiffness - 1.0
        if abs(softer) > self._stiffness:
            return False
        spread = max(LEARNED, observer.stiffness_deviation) * self._compliance
        mean[2], prior[2] = softer * self._compliance, max(prior[2], (self._noise / spread) ** 2)
        return True


def _most_friction(model: TendonSheath) -> tuple[float, float]:
    """Return the largest friction torque by [uncertainty] and by the calibration's interval, over the file's value (1).

    The interval is assumed to be symmetric. Without an interval, both values are equal.
    """
    uncertain = model.most_friction
    half_loop = abs(sliding(model).half_loop)
    if model.half_loop_low is None or not half_loop > 0.0:
        return uncertain, uncertain
    return uncertain, max(1.0, 2.0 - model.half_loop_low / half_loop)


class _Sums(NamedTuple):
    """Hold the normal equations of a fit: matrix, right-hand side, and the sum of squares of y."""

    normal: Array
    target: Array
    square: float

    def faded(self, keep: float) -> _Sums:
        return _Sums(keep * self.normal, keep * self.target, keep * self.square)

    def plus(self, other: _Sums) -> _Sums:
        return _Sums(self.normal + other.normal, self.target + other.target, self.square + other.square)

    def left(self, found: NDArray[np.floating[Any]]) -> float:
        return max(0.0, self.square - float(found @ (2.0 * self.target - self.normal @ found)))


def _without_friction(sums: _Sums) -> _Sums:
    """Return the sums without information on the friction: the fourth unknown is eliminated (Schur complement)."""
    n = float(sums.normal[3, 3])
    if not n > 0.0:
        return sums
    row = sums.normal[:, 3]
    return _Sums(
        sums.normal - np.outer(row, row) / n,
        sums.target - row * (sums.target[3] / n),
        sums.square - float(sums.target[3]) ** 2 / n,
    )
