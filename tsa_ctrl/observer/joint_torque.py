"""Estimate the joint torque of one axis without its sensor, and compare the sensor with the estimate."""

from __future__ import annotations

import math
from typing import Protocol

from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.sliding import sliding_by
from tsa_ctrl.observer.by_elongation import ElongationTorque
from tsa_ctrl.observer.stretch import NEARLY, STIFF_FACTOR, StretchObserver, StretchState

STILL = 0.02  # rad/s of the joint, below which it may be at rest: a motor's oscillation moves a resting joint so fast


class ModelTorque:
    """Estimate the joint torque from motor torque, joint direction and model alone; about a microsecond per cycle.

    While the joint moves, the tendons slide: tau_J = a(sigma) (tau_M - J_M alpha_M) - sigma b(sigma) (`model.sliding`).
    At rest, the friction holds any torque between the two lines. The estimate is then their middle, and the band
    includes both.

    Attributes: `torque`, `low`, `high`: estimate and 95 % band, N*m at the joint; nan before the first measurement.
    """

    def __init__(self, model: TendonSheath, period: float, motor_inertia: float = 0.0, still: float = STILL) -> None:
        """Prepare the model; `period` in s; `motor_inertia` in kg*m^2, 0 if not known; `still`: fastest rest, rad/s."""
        self._sliding = sliding_by(model)
        self._period = period
        self._inertia = motor_inertia
        self._still = still
        # Relative error of the friction torque: the two parameters have independent errors with 95 % bounds.
        self._share = math.hypot(model.friction_angle_uncertainty, model.pretension_uncertainty)
        self.set_parameters(model.friction_angle, model.pretension)
        self.reset()

    def reset(self) -> None:
        """Forget the last velocity."""
        self.torque = self.low = self.high = self._omega = math.nan

    def set_parameters(self, friction_angle: float, pretension: float) -> None:
        """Use another friction angle (1) and pretension (N) from now on."""
        forward, backward = (self._sliding(sigma, friction_angle, pretension) for sigma in (1.0, -1.0))
        self._slopes = forward.slope, backward.slope
        self._half_loops = forward.half_loop, backward.half_loop
        self._doubts = self._share * abs(forward.half_loop), self._share * abs(backward.half_loop)

    def update(self, tau_m: float, omega_m: float, omega_j: float, fresh: bool = True) -> None:
        """Take the measurements of one cycle, N*m, rad/s and rad/s; without `fresh` ones the last estimate stays."""
        if not fresh or not math.isfinite(tau_m + omega_m + omega_j):
            self._omega = math.nan
            return
        if self._omega == self._omega:
            tau_m -= self._inertia * (omega_m - self._omega) / self._period
        self._omega = omega_m
        forward, backward = self._slopes
        least, most = self._half_loops
        low, high = forward * tau_m - least, backward * tau_m + most
        if omega_j > self._still:
            torque, half = low, self._doubts[0]
        elif omega_j < -self._still:
            torque, half = high, self._doubts[1]
        else:
            torque = 0.5 * (low + high)
            half = 0.5 * abs(high - low) * (1.0 + self._share)
        self.torque, self.low, self.high = torque, torque - half, torque + half


MEMORY = 2.0  # s over which sensor and stretch are compared: a turn or two, so that no reversal alone speaks
SENSOR = 0.03  # 1, of its torque, that a sound joint torque sensor may be off itself, beside the band
SOFT = 0.1  # s for which the tendons must give as much more than the model's as they may
OTHER = 2.0  # 1, times more or less friction than the file's: such an elongation is of another curvature profile
OFTEN, SELDOM = 0.5, 0.2  # of the samples outside the band: told above, told again only after it was below


class Measured(Protocol):
    """The image of an axis, as far as it is needed here; SI, nan where there is nothing."""

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
    """`torque`, `low`, `high`: N*m at the joint, from the tendon elongation, with its 95 % band; nan without one.

    `model`: the same from the model alone. `stretch`: the observer, None on a rig that cannot have it (`why_not`).
    """

    def __init__(
        self,
        model: ModelTorque,
        stretch: StretchObserver | None,
        why_not: str,
        period: float,
        elongation: ElongationTorque | None = None,
    ) -> None:
        """Combine the estimates; `period` in s; `elongation`: the estimate that does not use the reported torque."""
        self.model = model
        self.elongation = elongation
        self.torque = self.low = self.high = math.nan
        self._faulty = False
        self._enabled = False
        self._soft = 0.0  # s
        self._period = period
        self.stretch = stretch
        self._friction_angle = 0.0 if stretch is None else stretch.friction_angle  # 1, of the file
        self.why_not = why_not
        self.contradicted = False  # the joint torque sensor lies outside the stretch's band most of the time
        self.difference = 0.0  # N*m, of sensor less stretch, over the last seconds
        self._forget = period / MEMORY
        self._outside = 0.0

    def _combine(self) -> None:
        """Find the joint torque from the tendon elongation and the ends of its 95 % band; nan without one.

        The narrow band of the observer holds while the elongation is as the reported motor torque predicts. Afterwards
        the band without the reported torque is added, as the motor may give another torque than it reports.
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
        """Report no torque until the next enable: a signal of this axis was found wrong."""
        self._faulty = True
        self._combine()

    def _explained(self, friction_angle: float) -> bool:
        """Return True if a friction angle near the file's value and a stiffness explain the elongation."""
        return self._friction_angle < OTHER * friction_angle < OTHER * OTHER * self._friction_angle

    @property
    def contradiction(self) -> str | None:
        """Return the finding that the motor gives more than it reports, None without one."""
        if self._soft < SOFT or self.stretch is None:
            return None
        return (
            f"the tendons give {1.0 / self.stretch.stiffness:.1f} times as much as the reported motor torque explains, "
            "or more: the motor torque exceeds the reported one by this factor, or axial_stiffness is too high by it"
        )

    def reset(self) -> None:
        """Forget everything learned from the encoders, because their zero may have changed."""
        self.model.reset()
        if self.stretch is not None:
            self.stretch.reset()
        if self.elongation is not None:
            self.elongation.reset()
        self._outside = self.difference = 0.0
        self._combine()

    def set_parameters(self, friction_angle: float, pretension: float) -> None:
        """Use another friction angle (1) and pretension (N); the stretch takes the pretension, and finds its own x."""
        self.model.set_parameters(friction_angle, pretension)
        if self.stretch is not None:
            self.stretch.set_pretension(pretension)

    def pass_over(self, periods: int) -> None:
        """Count periods without a cycle."""
        if self.stretch is not None:
            self.stretch.pass_over(periods)
            self._combine()

    def update(
        self, image: Measured, omega_j: float, tau_j: float, command: float = math.nan, enabled: bool = True
    ) -> None:
        """Take one cycle.

        Args:
            image: the measurements of drive and encoder.
            omega_j: rad/s of the joint.
            tau_j: N*m of the joint torque sensor, or nan.
            command: N*m that the motor is commanded.
            enabled: torque is permitted.
        """
        if enabled and not self._enabled:
            self._faulty = False
        self._enabled = enabled
        tau_m, omega_m, fresh = image.tau_m, image.omega_m, image.fresh
        self.model.update(tau_m, omega_m, omega_j, fresh)
        stretch = self.stretch
        if stretch is None:
            return
        stretch.update(tau_m, omega_m, image.q_m, image.q_j, fresh)
        soft = stretch.stiffness * STIFF_FACTOR * NEARLY < 1.0 and self._explained(stretch.friction_angle)
        self._soft = self._soft + self._period if enabled and soft else 0.0
        if self.elongation is not None and fresh:
            self.elongation.update(image.q_m, image.q_j, command)
        if stretch.confirmation.confirmed and not self._faulty:
            self.torque, self.low, self.high = stretch.torque, stretch.low, stretch.high
        else:
            self._combine()
        if tau_j == tau_j and stretch.state is StretchState.TOLD and fresh:
            forget = self._forget
            self.difference += forget * (tau_j - stretch.torque - self.difference)
            room = SENSOR * abs(tau_j)
            agrees = stretch.low - room <= tau_j <= stretch.high + room
            self._outside += forget * ((0.0 if agrees else 1.0) - self._outside)
            if self._outside > OFTEN:
                self.contradicted = True
            elif self._outside < SELDOM:
                self.contradicted = False
