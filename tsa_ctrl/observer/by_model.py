"""Joint torque from the motor's torque, the direction and the model alone: the estimate of a rig without more.

While the joint moves the tendons slide, tau_J = a(sigma) (tau_M - J_M alpha_M) - sigma b(sigma) (`model.sliding`), as
far as friction angle and pretension are known. At standstill the friction holds whatever lies between the two lines:
the middle is told, and the band is the friction's.
"""

from __future__ import annotations

import math

from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.sliding import sliding_by

STILL = 0.02  # rad/s of the joint below which it may stand still: what a motor's ringing leaves on a still joint


class ModelTorque:
    """`torque`, `low`, `high`: N*m at the joint, nan before the first measurement; about a microsecond a cycle."""

    def __init__(self, model: TendonSheath, period: float, motor_inertia: float = 0.0, still: float = STILL) -> None:
        """`period` in s, J_M in kg*m^2 (0: not known); `still`: rad/s of the joint that count as standstill."""
        self._sliding = sliding_by(model)
        self._period = period
        self._inertia = motor_inertia
        self._still = still
        # Of the half loop: what either parameter may be off is a 95 % bound, and the two are not off together.
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
        """One cycle's measurements, N*m, rad/s and rad/s; the last estimate stays while they are not `fresh`."""
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
