"""The live inverse of (3.55) without any effect: what `feedforward` gives for such a model, in a third of the time.

    tau_M = r_M / cosh(sigma x) (tau_J* / r_J + 2 T_p sinh(sigma x)),     abs(tau_M) <= 2 T_p r_M

SI units, plain floats; sigma in [-1, 1], x = mu Theta and T_p those of the model, or set.
"""

from __future__ import annotations

import math

from tsa_ctrl.model.parameters import TendonSheath


class SimplifiedFeedforward:
    """tau_M for a wanted tau_J; measured angles and time are taken and not needed."""

    notes: tuple[str, ...] = ()

    def __init__(self, model: TendonSheath) -> None:
        self.friction_angle = model.friction_angle
        self.pretension = model.pretension
        self._r_m = model.motor_pulley_radius
        self._per_r_j = 1.0 / model.joint_pulley_radius
        self._prepare()

    def reset(self) -> None:
        """There is no memory; what was set stays."""

    def set(self, friction_angle: float | None = None, pretension: float | None = None) -> None:
        """Take over another x (1) or T_p0 (N) while running."""
        if friction_angle is not None:
            self.friction_angle = friction_angle
        if pretension is not None:
            self.pretension = pretension
        self._prepare()

    def _prepare(self) -> None:
        self._limit = 2.0 * self.pretension * self._r_m
        self._friction = 2.0 * self.pretension * math.sinh(self.friction_angle)
        self._gain = self._r_m / math.cosh(self.friction_angle)

    def domain_limit(self) -> float:
        """Largest abs(tau_M), N*m, at which both tendons still pull."""
        return self._limit

    def half_loop(self) -> float:
        """h = 2 T_p r_M tanh x, N*m: by how much tau_M differs from its mean of both directions at tau_J = 0."""
        return self._gain * self._friction

    def update(
        self,
        tau_j_des: float,
        sigma: float,
        omega_j: float = math.nan,
        q_j: float = math.nan,
        q_m: float = math.nan,
        t: float = math.nan,
    ) -> float:
        """tau_M, N*m, that delivers `tau_j_des` (N*m) in direction `sigma`; what is not finite stays so."""
        if sigma >= 1.0:
            tau_m = self._gain * (tau_j_des * self._per_r_j + self._friction)
        elif sigma <= -1.0:
            tau_m = self._gain * (tau_j_des * self._per_r_j - self._friction)
        else:
            x = sigma * self.friction_angle
            wanted = tau_j_des * self._per_r_j + 2.0 * self.pretension * math.sinh(x)
            tau_m = self._r_m / math.cosh(x) * wanted
        limit = self._limit
        return limit if tau_m > limit else -limit if tau_m < -limit else tau_m
