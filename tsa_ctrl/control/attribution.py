"""From the one number that sliding shows to friction angle and pretension, by an assumption that the user names.

    half loop at the joint  h = 2 T_p r_J sinh x      (N*m, from a joint torque sensor)
    half loop at the motor  k = 2 T_p r_M tanh x      (N*m, from an unloaded or known joint)

With `elongation_coupling` in the model both follow from where its sheath bends (`tsa_ctrl.model.sliding`).

One configuration gives only the product (model.md). The split needs an assumption about what changed: the friction
coefficient ("friction": T_p stays), the tensioner ("pretension": x stays), or the sheath's bending ("bending": x = mu
Theta and T_p = T_p0 + k_t (p + d/2)(Theta - Theta_0) move together, (3.52), (3.56)).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from enum import Enum

from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.sliding import sliding

SMALLEST_ANGLE = 1e-3  # 1, friction angle below which the split is not defined
POINTS = 256  # of the table by which the half loop is inverted: 1e-5 of it, and no iteration in the loop


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
        self._per_pretension = _half_loop_of(model, at_motor)
        self._mu = model.friction_coefficient
        self._angle = max(model.friction_angle, SMALLEST_ANGLE)
        self._pretension = model.pretension
        self._theta = max(model.bending_angle, SMALLEST_ANGLE)
        self._slope = model.pretension_slope
        low, high = 1.0 / (1.0 + bounds), 1.0 + bounds
        if attribution is Attribution.BENDING:  # a long way down the pretension may reach 0, where the map folds
            low = max(low, 1.0 - 0.95 * self._pretension / max(self._slope * self._theta, 1e-12))
        self._factors = tuple(low + (high - low) * k / POINTS for k in range(POINTS + 1))
        self._half_loops = tuple(self._half_loop(factor) for factor in self._factors)
        self.nominal = self._half_loop(1.0)

    def parameters(self, factor: float) -> tuple[float, float]:
        """Friction angle and pretension when the moving quantity is `factor` times its nominal value."""
        if self._attribution is Attribution.FRICTION:
            return self._angle * factor, self._pretension
        if self._attribution is Attribution.PRETENSION:
            return self._angle, self._pretension * factor
        theta = self._theta * factor
        return self._mu * theta, max(0.0, self._pretension + self._slope * (theta - self._theta))

    def _half_loop(self, factor: float) -> float:
        """N*m that `parameters(factor)` give."""
        angle, pretension = self.parameters(factor)
        return pretension * self._per_pretension(angle)

    def solve(self, half_loop: float) -> tuple[float, float, bool]:
        """Friction angle, pretension, and whether the half loop (N*m) lies inside the bounds; else at the bound."""
        factors, loops = self._factors, self._half_loops
        if half_loop <= loops[0]:
            return *self.parameters(factors[0]), False
        if half_loop >= loops[-1]:
            return *self.parameters(factors[-1]), False
        above = bisect.bisect_left(loops, half_loop)
        share = (half_loop - loops[above - 1]) / (loops[above] - loops[above - 1])
        return *self.parameters(factors[above - 1] + share * (factors[above] - factors[above - 1])), True


def _half_loop_of(model: TendonSheath, at_motor: bool) -> Callable[[float], float]:
    """m: half loop at the motor or the joint over the pretension, by the friction angle."""
    arm = 2.0 * (model.motor_pulley_radius if at_motor else model.joint_pulley_radius)
    if "elongation_coupling" not in model.effects:
        function = math.tanh if at_motor else math.sinh
        return lambda angle: arm * function(angle)
    if at_motor:
        return lambda angle: sliding(model, 1.0, angle, 1.0).motor_half_loop
    return lambda angle: sliding(model, 1.0, angle, 1.0).half_loop
