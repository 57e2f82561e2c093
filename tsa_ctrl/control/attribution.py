"""From the one number that sliding shows to friction angle and pretension, by an assumption that the user names.

    half loop at the joint  h = 2 T_p r_J sinh x      (N*m, from a joint torque sensor)
    half loop at the motor  k = 2 T_p r_M tanh x      (N*m, from an unloaded or known joint)

One configuration gives only the product (model.md). The split needs an assumption about what changed: the friction
coefficient ("friction": T_p stays), the tensioner ("pretension": x stays), or the sheath's bending ("bending": x = mu
Theta and T_p = T_p0 + k_t (p + d/2)(Theta - Theta_0) move together, (3.52), (3.56)).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum

from tsa_ctrl.model.parameters import TendonSheath

SMALLEST_ANGLE = 1e-3  # 1, friction angle below which the split is not defined


class Attribution(Enum):
    """What is taken to have changed when the half loop has."""

    FRICTION = "friction"
    PRETENSION = "pretension"
    BENDING = "bending"


class Split:
    """friction angle (1) and pretension (N) that give a half loop, within a factor of nominal either way."""

    def __init__(self, model: TendonSheath, attribution: Attribution, at_motor: bool, bounds: float) -> None:
        """`bounds`: factor either way minus 1, of the one quantity that moves."""
        self._attribution = attribution
        self._function: Callable[[float], float] = math.tanh if at_motor else math.sinh
        self._arm = 2.0 * (model.motor_pulley_radius if at_motor else model.joint_pulley_radius)
        self._mu = model.friction_coefficient
        self._angle = max(model.friction_angle, SMALLEST_ANGLE)
        self._pretension = model.pretension
        self._theta = max(model.bending_angle, SMALLEST_ANGLE)
        self._slope = model.pretension_slope
        self.nominal = self.half_loop(1.0)
        low, high = 1.0 / (1.0 + bounds), 1.0 + bounds
        if attribution is Attribution.BENDING:  # a long way down the pretension may reach 0, where the map folds
            low = max(low, 1.0 - 0.95 * self._pretension / max(self._slope * self._theta, 1e-12))
        self._low, self._high = low, high

    def parameters(self, factor: float) -> tuple[float, float]:
        """Friction angle and pretension when the moving quantity is `factor` times its nominal value."""
        if self._attribution is Attribution.FRICTION:
            return self._angle * factor, self._pretension
        if self._attribution is Attribution.PRETENSION:
            return self._angle, self._pretension * factor
        theta = self._theta * factor
        return self._mu * theta, max(0.0, self._pretension + self._slope * (theta - self._theta))

    def half_loop(self, factor: float) -> float:
        """N*m that `parameters(factor)` give."""
        angle, pretension = self.parameters(factor)
        return self._arm * pretension * self._function(angle)

    def solve(self, half_loop: float) -> tuple[float, float, bool]:
        """Friction angle, pretension, and whether the half loop (N*m) lies inside the bounds; else at the bound."""
        if half_loop <= self.half_loop(self._low):
            return *self.parameters(self._low), False
        if half_loop >= self.half_loop(self._high):
            return *self.parameters(self._high), False
        low, high = self._low, self._high
        for _ in range(24):  # bisection: 1e-7 of the range, and nothing that could diverge in the loop
            middle = 0.5 * (low + high)
            if self.half_loop(middle) < half_loop:
                low = middle
            else:
                high = middle
        return *self.parameters(0.5 * (low + high)), True
