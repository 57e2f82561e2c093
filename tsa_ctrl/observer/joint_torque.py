"""Estimate the joint torque of one axis without its sensor, and compare the sensor with the estimate."""

from __future__ import annotations

import math
from typing import Protocol

from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding, sliding_by
from tsa_ctrl.model.stretch import compliance_centre
from tsa_ctrl.observer.stretch import NEARLY, STIFF_FACTOR, StretchObserver, StretchState

# Joint torque from the tendon elongation and the friction of the model file, without the reported motor torque 0x6077.
#
# The elongation s = r_M q_M - r_J q_J gives the mean of the tension differences at motor and joint, so that
#
# tau_J = 2 k_t r_J (s - s_0) - s_c z h_J,        -1 <= z <= 1
#
# h_J is the friction torque at the joint (half the hysteresis width), and s_c the centre of the bending. z is the
# direction of motion once both ends of the tendons have moved far enough in one direction. Otherwise it is unknown. The
# zero s_0 is known within two bounds: while the commanded motor torque is about 0, s - s_0 contains only friction. The
# band is wide, but an error of the torque constant or of 0x6077 does not change it.

IDLE = 0.05  # N*m of commanded torque that counts as about 0
SMOOTH = 0.003  # s, low-pass of both positions
SETTLED = 0.03  # s, memory of the commanded torque
STRANGE = 2.0  # 1, largest assumed ratio of the true motor torque to the commanded one
NOISE = 0.02  # N*m of the motor, cogging and offset of its current
CREEP = 2e-6  # m/s, fastest drift of the zero
GEARING = 2e-3  # 1, of the joint pulley's travel: error of the effective pulley radii


class ElongationTorque:
    """Compute bounds of the joint torque without the reported motor torque; a cycle takes about a microsecond.

    Attributes: `low`, `high`: N*m at the joint, nan before the first measurement.
    """

    def __init__(self, model: TendonSheath, period: float, counts: tuple[float, float]) -> None:
        """Prepare the estimate; `period`: s; `counts`: rad of one count at the motor's and the joint's pulley."""
        self._r_m, self._r_j = model.motor_pulley_radius, model.joint_pulley_radius
        friction = abs(sliding(model).half_loop)
        centre = compliance_centre(model)
        doubt = model.bending_centre_uncertainty
        self._most_friction = model.most_friction
        self._per_stretch = 2.0 * model.tendon_stiffness * model.joint_pulley_radius
        self._at_joint = friction * min(1.0, centre + doubt)
        self._at_motor = friction * min(1.0, 1.0 - centre + doubt) / self._per_stretch
        self._per_torque = model.joint_pulley_radius / model.motor_pulley_radius / self._per_stretch
        self._doubt = max(0.1, model.axial_stiffness_uncertainty) + 0.25 * model.friction_angle**2
        self._count = self._r_m * counts[0] + self._r_j * counts[1]  # m
        self._way = 2.0 * self._most_friction * friction / self._per_stretch + 4.0 * self._count
        self._smooth = 1.0 - math.exp(-period / SMOOTH)
        self._fade = math.exp(-period / SETTLED)
        self._creep = CREEP * period
        self.reset()

    def reset(self) -> None:
        """Reset all states and the zero of the elongation."""
        self.low = self.high = self._motor = math.nan
        self._joint = 0.0
        self._zero_low, self._zero_high = -math.inf, math.inf  # m
        self._slid = 0.0  # m, signed motion of both ends in one direction
        self._command = 0.0  # N*m, largest command of the last 30 ms

    def update(self, q_m: float, q_j: float, command: float) -> None:
        """Process the measurements of one cycle; ignore them if a value is not finite.

        Args:
            q_m, q_j: angles of motor and joint, rad.
            command: commanded motor torque, N*m.
        """
        motor, joint = self._r_m * q_m, self._r_j * q_j
        if not math.isfinite(motor + joint + command):
            return
        if self._motor != self._motor:
            self._motor, self._joint = motor, joint
        smooth, count = self._smooth, self._count
        step, went = smooth * (motor - self._motor), smooth * (joint - self._joint)
        self._motor += step
        self._joint += went
        size, recent = abs(command), self._fade * self._command
        self._command = size if size > recent else recent
        slid, jitter = self._slid, 0.1 * count
        if slid >= 0.0 and step > -jitter and went > -jitter:
            if step > 0.0 and went > 0.0:
                slid += step if step < went else went
        elif slid <= 0.0 and step < jitter and went < jitter:
            if step < 0.0 and went < 0.0:
                slid += step if step > went else went
        else:
            slid = 0.0
        self._slid = slid
        # Bounds of z, multiplied by the ratio of the true friction to the file's.
        forward, backward = self._most_friction, -self._most_friction
        if slid > self._way:
            backward = 0.0  # friction may be lost at any time, so the file provides no lower bound
        elif slid < -self._way:
            forward = 0.0
        stretch = self._motor - self._joint
        drift = self._creep + GEARING * abs(went)
        self._zero_low -= drift
        self._zero_high += drift
        if self._command < IDLE:
            room = self._per_torque * (STRANGE * self._command + NOISE) + count
            low = stretch + self._at_motor * backward - room
            high = stretch + self._at_motor * forward + room
            self._zero_low, self._zero_high = max(self._zero_low, low), min(self._zero_high, high)
            if self._zero_low > self._zero_high:  # the zero has moved: an encoder or a tendon has slipped
                self._zero_low, self._zero_high = low, high
        least = self._per_stretch * (stretch - self._zero_high)
        most = self._per_stretch * (stretch - self._zero_low)
        self.low = least - self._doubt * abs(least) - self._at_joint * forward
        self.high = most + self._doubt * abs(most) - self._at_joint * backward


STILL = 0.02  # rad/s of the joint, below which it may be at rest: a motor oscillation moves a resting joint this fast


class ModelTorque:
    """Estimate the joint torque from motor torque, joint direction and model alone, in about a microsecond per cycle.

    While the joint moves, the tendons slide: tau_J = a(sigma) (tau_M - J_M alpha_M) - sigma b(sigma),
    see `model.steady_sliding`. At rest, the friction holds any torque between the two lines. The estimate is then their
    mean, and the band includes both.

    Attributes: `torque`, `low`, `high`: estimate and 95 % band, N*m at the joint; nan before the first measurement.
    `slopes`: a(1) and a(-1), 1.
    """

    def __init__(self, model: TendonSheath, period: float, motor_inertia: float) -> None:
        """Prepare the estimate.

        Args:
            model: the tendons and their sheaths.
            period: s.
            motor_inertia: kg*m^2, 0 if unknown.
        """
        self._sliding = sliding_by(model)
        self._period = period
        self._inertia = motor_inertia
        # Relative error of the friction torque: the two parameters have independent errors with 95 % bounds.
        self._share = math.hypot(model.friction_angle_uncertainty, model.pretension_uncertainty)
        self.set_parameters(model.friction_angle, model.pretension)
        self.reset()

    def reset(self) -> None:
        """Reset the estimate and the last velocity."""
        self.torque = self.low = self.high = self._omega = math.nan

    @property
    def half_loop(self) -> float:
        """Return the friction torque at the joint, N*m."""
        return abs(self._half_loops[0])

    def set_parameters(self, friction_angle: float, pretension: float, imbalance: float = 0.0) -> None:
        """Use another friction angle (1), pretension (N) and imbalance (1) of the two tendons from now on."""
        forward, backward = (self._sliding(sigma, friction_angle, pretension, imbalance) for sigma in (1.0, -1.0))
        self.slopes = forward.slope, backward.slope
        self._half_loops = forward.half_loop, backward.half_loop
        self._doubts = self._share * abs(forward.half_loop), self._share * abs(backward.half_loop)

    def update(self, tau_m: float, omega_m: float, omega_j: float, fresh: bool = True) -> None:
        """Process the measurements of one cycle (N*m, rad/s, rad/s); hold the last estimate if they are not `fresh`."""
        if not fresh or not math.isfinite(tau_m + omega_m + omega_j):
            self._omega = math.nan
            return
        if self._omega == self._omega:
            tau_m -= self._inertia * (omega_m - self._omega) / self._period
        self._omega = omega_m
        forward, backward = self.slopes
        least, most = self._half_loops
        low, high = forward * tau_m - least, backward * tau_m + most
        if omega_j > STILL:
            torque, half = low, self._doubts[0]
        elif omega_j < -STILL:
            torque, half = high, self._doubts[1]
        else:
            torque = 0.5 * (low + high)
            half = 0.5 * abs(high - low) * (1.0 + self._share)
        self.torque, self.low, self.high = torque, torque - half, torque + half


MEMORY = 2.0  # s over which sensor and elongation are compared: one or two reversals, so that no single one decides
SENSOR = 0.03  # 1, error of a correct joint torque sensor over its torque, in addition to the band
SOFT = 0.1  # s for which the stiffness must be at its lower bound before a contradiction is reported
LEAST_FRICTION = 0.5  # 1, of the file's friction; a motor with twice the reported torque halves the apparent friction
OFTEN, SELDOM = 0.5, 0.2  # share of samples outside the band above which a contradiction is set, and below it cleared


class Measured(Protocol):
    """Define the measurements of an axis that this module uses, in SI units; a missing one is nan."""

    @property
    def tau_m(self) -> float: ...

    @property
    def omega_m(self) -> float: ...

    @property
    def q_m(self) -> float: ...

    @property
    def q_j(self) -> float: ...

    @property
    def fresh(self) -> bool: ...


class JointTorque:
    """Estimate the joint torque of one axis by the tendon elongation, and compare the joint torque sensor with it.

    Attributes: `torque`, `low`, `high`: estimate and 95 % band, N*m at the joint; nan without an estimate. `model`: the
    estimate from the model alone. `stretch`: the observer, or None on a rig that cannot have one
    (`unsupported_reason`).
    """

    def __init__(
        self,
        model: ModelTorque,
        stretch: StretchObserver | None,
        unsupported_reason: str,
        period: float,
        elongation: ElongationTorque | None = None,
        shape_known: bool = True,
    ) -> None:
        """Combine the estimates.

        Args:
            model: the estimate from the model alone.
            stretch: the observer, None on a rig that cannot have it.
            unsupported_reason: the reason why the rig cannot have it.
            period: s.
            elongation: the estimate that does not use the reported torque.
            shape_known: True if the model file states where the sheath bends. Otherwise a wrong shape looks like a
                wrong stiffness, and the stiffness cannot show an error of the motor torque.
        """
        self.model = model
        self.elongation = elongation
        self.torque = self.low = self.high = math.nan
        self._faulty = False
        self._enabled = False
        self._soft = 0.0  # s
        self._shape_known = shape_known
        self._period = period
        self.stretch = stretch
        self._friction_angle = 0.0 if stretch is None else stretch.friction_angle  # 1, of the file
        self._most_friction_angle = self._friction_angle if stretch is None else stretch.most_friction_angle
        self.unsupported_reason = unsupported_reason
        self.contradicted = False  # the joint torque sensor is outside the band of the elongation most of the time
        self.difference = 0.0  # N*m, sensor minus estimate by the elongation, averaged over the last seconds
        self._forget = period / MEMORY
        self._outside = 0.0

    def _combine(self) -> None:
        """Set the joint torque by the tendon elongation and its 95 % band; nan without an estimate.

        The narrow band of the observer is valid while the elongation confirms the reported motor torque. After that, it
        is extended to the band of `elongation`, which does not use the reported torque, because the motor may deliver
        another torque than it reports.
        """
        stretch, wide = self.stretch, self.elongation
        if stretch is None or self._faulty:
            self.torque = self.low = self.high = math.nan
            return
        torque, low, high = stretch.torque, stretch.low, stretch.high
        if not (stretch.confirmation.confirmed or wide is None or not wide.low < wide.high or torque != torque):
            torque = min(max(torque, wide.low), wide.high)
            low, high = min(low, wide.low), max(high, wide.high)
        self.torque, self.low, self.high = torque, low, high

    def distrust(self) -> None:
        """Report no torque until the next enable, because a signal of this axis is faulty."""
        self._faulty = True
        self._combine()

    def _explained(self, stretch: StretchObserver) -> bool:
        """Return True if the estimated friction is within the range that the file and a wrong motor torque allow.

        A motor that delivers more torque than it reports makes the friction look smaller, never larger. More friction
        than the file's uncertainty allows shows another curvature profile.
        """
        friction_angle = stretch.friction_angle * self._friction_angle / stretch.modelled
        return LEAST_FRICTION * self._friction_angle < friction_angle < self._most_friction_angle

    @property
    def contradiction(self) -> str | None:
        """Return the finding that the motor delivers more torque than it reports, or None without that finding."""
        if self._soft < SOFT or self.stretch is None:
            return None
        return (
            f"the tendons elongate at least {1.0 / self.stretch.stiffness:.1f} times as much as the reported motor "
            "torque "
            "explains: the motor torque exceeds the reported one, or axial_stiffness is too high, by this factor"
        )

    def reset(self) -> None:
        """Reset everything that was learned from the encoders, because their zero may have changed."""
        self.model.reset()
        if self.stretch is not None:
            self.stretch.reset()
        if self.elongation is not None:
            self.elongation.reset()
        self._outside = self.difference = 0.0
        self._combine()

    def set_parameters(
        self, friction_angle: float, pretension: float, imbalance: float = 0.0, bent: bool = False
    ) -> None:
        """Use another friction angle (1), pretension (N) and imbalance (1) of the two tendons.

        Args:
            friction_angle: 1.
            pretension: N.
            imbalance: 1.
            bent: True if the wrap angle changed both. The elongation observer then keeps its ratio to the model.
                Otherwise it uses the pretension, and estimates its own friction angle.
        """
        self.model.set_parameters(friction_angle, pretension, imbalance)
        if self.stretch is None:
            return
        if bent:
            self.stretch.bend(friction_angle, pretension)
        else:
            self.stretch.set_pretension(pretension)

    def skip_cycles(self, periods: int) -> None:
        """Account for `periods` without a cycle."""
        if self.stretch is not None:
            self.stretch.skip_cycles(periods)
            self._combine()

    def update(
        self,
        image: Measured,
        omega_j: float,
        tau_j: float,
        command: float = math.nan,
        enabled: bool = True,
        routed: float = 0.0,
    ) -> None:
        """Process one cycle.

        Args:
            image: the measurements of drive and encoder.
            omega_j: joint velocity, rad/s.
            tau_j: torque of the joint torque sensor, N*m, or nan.
            command: commanded motor torque, N*m.
            enabled: True if torque is permitted.
            routed: part of the motor angle that different path lengths of the tendons cause, rad.
        """
        if enabled and not self._enabled:
            self._faulty = False
        self._enabled = enabled
        tau_m, omega_m, fresh = image.tau_m, image.omega_m, image.fresh
        self.model.update(tau_m, omega_m, omega_j, fresh)
        stretch = self.stretch
        if stretch is None:
            return
        q_m = image.q_m - routed
        stretch.update(tau_m, omega_m, q_m, image.q_j, fresh)
        soft = stretch.stiffness * STIFF_FACTOR * NEARLY < 1.0 and self._explained(stretch)
        if soft and self.model.low <= tau_j <= self.model.high:  # the sensor confirms the reported torque
            soft = False
        self._soft = self._soft + self._period if enabled and soft and self._shape_known else 0.0
        if self.elongation is not None and fresh:
            self.elongation.update(q_m, image.q_j, command)
        if stretch.confirmation.confirmed and not self._faulty:
            self.torque, self.low, self.high = stretch.torque, stretch.low, stretch.high
        else:
            self._combine()
        if tau_j == tau_j and stretch.state is StretchState.ESTIMATED and fresh:
            forget = self._forget
            self.difference += forget * (tau_j - stretch.torque - self.difference)
            room = SENSOR * abs(tau_j)
            agrees = stretch.low - room <= tau_j <= stretch.high + room
            self._outside += forget * ((0.0 if agrees else 1.0) - self._outside)
            if self._outside > OFTEN:
                self.contradicted = True
            elif self._outside < SELDOM:
                self.contradicted = False
