"""Estimate the pretension from the tendon tensions at the motor, load cells t1 and t3 (kind "tension").

While both tendons slide in one direction their lengths add up, (3.31)-(3.41), at any torque:

    T_p0 = (T1 alpha + T3 beta) / 2,     alpha, beta at sigma x, over the length of tendon and spring

x enters only with the bends between motor and joint, and with opposite signs in the two directions. The mean of both
is therefore used, limited to the lower one plus `ROOM`, because too much compensation moves the joint. Tensions do not
identify the friction coefficient, which stays constant. A change is attributed to the tensioner ("pretension": x stays
constant) or to the wrap angle ("bending": Theta by (3.56), x = mu Theta).

The two cells are compared with the motor's torque, T3 - T1 = tau_M/r_M. A cell that is stuck, drifts or has a wrong
gain makes the estimate invalid. The outputs then fall to the model file's values, and never rise. An equal drift of
both cells is detected only at the bounds.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from tsa_ctrl.control.estimator import EstimateState, GatedEstimator, Sample
from tsa_ctrl.control.kalman import EffectRemoval
from tsa_ctrl.control.settings import Attribution, EstimatorSettings
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import elongations

SLIDING = 0.999  # 1, |sigma| above which the tendons are certain to slide
BOTH_WAYS = 0.1  # s of admitted motion, within memory, that each direction needs
ROOM = 0.05  # 1, above the lower of both directions: an error of the file's friction angle causes no more
MEAN = 0.125  # of `memory`, over which the tensions of a direction are averaged to reduce the noise of the cells
BALANCE = 0.1  # 1, of the pretension, RMS of T3 - T1 - tau_M/r_M: a cell error of this size changes T_p by half of it
BALANCED_FOR = 0.5  # s over which that is averaged
AGREES = 0.5  # of that limit, below which contradictory cells are used again
ABSENT = 0.2  # s without a value of either cell: twice the time-out of a line


class TensionEstimator(GatedEstimator):
    """Estimate by two load cells; the outputs do not change while no data are admitted."""

    def __init__(self, model: TendonSheath, settings: EstimatorSettings, period: float) -> None:
        """Prepare the estimator; `period` in s."""
        super().__init__(model, settings, period)
        self._model = model
        self._removal = EffectRemoval(model, period) if model.effects else None
        self._bends = settings.attribute is Attribution.BENDING
        self._bounds = (1.0 / (1.0 + settings.bounds), 1.0 + settings.bounds)
        self._period = period
        self._settle, self._least_speed = settings.settle, settings.least_speed
        self._lengths = elongations(model, model.friction_angle)
        self._per_radius = 1.0 / model.motor_pulley_radius
        self._mean = period / (MEAN * settings.memory)
        self._forget = period / BALANCED_FOR
        self._worst = (BALANCE * model.pretension) ** 2
        self.reset()

    def reset(self) -> None:
        """Return to the model file's values, and discard all data."""
        super().reset()
        self.residual = 0.0  # N^2, of the balance
        self._shown = [math.nan, math.nan]  # N, mean pretension of each direction
        self._seen = [0.0, 0.0]  # s, admitted motion of each direction
        self._since = self._gap = 0.0
        self._way = -1
        if self._removal is not None:
            self._removal.reset()

    @property
    def half_loop_ratio(self) -> float:
        """Return the friction torque over the model file's value, 1; nan while it is not estimated."""
        if self.state is not EstimateState.ESTIMATED:
            return math.nan
        return self._sliding(1.0, *self._target).half_loop / self._half_loop

    def update(self, seen: Sample) -> None:
        """Process the data of one cycle."""
        removal, tau_m = self._removal, seen.tau_m
        if removal is not None:
            removal.measure(seen)
            tau_m = removal.motor(tau_m)
        if math.isfinite(seen.t1 + seen.t3):
            self._gap = 0.0
            if seen.admit and math.isfinite(tau_m):
                self._take(seen, tau_m)
        else:
            self._gap += self._period
            if self._gap > ABSENT:
                missing = [name for name in ("t1", "t3") if not math.isfinite(getattr(seen, name))]
                self._refuse(f"no value of {' and '.join(missing)}; check the load cell's serial connection")
        self._approach()

    def _take(self, seen: Sample, tau_m: float) -> None:
        """Process a sample in which both cells and the motor have a value."""
        unbalanced = seen.t3 - seen.t1 - self._per_radius * tau_m
        self.residual += self._forget * (unbalanced * unbalanced - self.residual)
        if not self.residual <= self._worst:
            self._refuse(
                f"T3 - T1 differs from the motor's torque by {math.sqrt(self.residual):.2g} N, allowed are "
                f"{math.sqrt(self._worst):.2g}; check zero and gain of both load cells"
            )
            return
        if self.reason and self.residual > AGREES * self._worst:
            return
        way = 1 if seen.sigma > SLIDING and seen.omega_j > self._least_speed else -1
        if seen.sigma < -SLIDING and seen.omega_j < -self._least_speed:
            way = 0
        self._since = self._since + self._period if way == self._way else 0.0
        self._way = way
        if way < 0 or self._since <= self._settle:
            return
        longer, shorter = self._lengths if way else self._lengths[::-1]
        tension = 0.5 * (seen.t1 * longer + seen.t3 * shorter)
        known = self._shown[way]
        self._shown[way] = tension if known != known else known + self._mean * (tension - known)
        self._seen[way] += self._period
        if min(self._seen) > BOTH_WAYS:
            self._judge(min(0.5 * sum(self._shown), (1.0 + ROOM) * min(self._shown)))

    def _judge(self, tension: float) -> None:
        """Derive both parameters from a pretension (N), if they are within the bounds."""
        model, (low, high) = self._model, self._bounds
        angle, nominal = self._nominal
        if self._bends:
            theta = model.bending_angle + (tension - nominal) / model.pretension_slope
            factor, angle = theta / model.bending_angle, model.friction_coefficient * theta
            what = f"the sheath bent {factor:.2f} times as much"
        else:
            factor = tension / nominal
            what = f"{factor:.2f} times the pretension"
        if not low < factor < high:
            self._refuse(
                f"the load cells show {tension:.3g} N of pretension, {what} as the model file has, allowed are "
                f"{low:.2f} to {high:.2f} (estimator.bounds); check tensioner and cells, or calibrate again"
            )
            return
        self._accept(angle, tension)

    def _refuse(self, reason: str = "") -> None:
        """Stop using the tensions measured so far."""
        super()._refuse(reason)
        self._shown, self._seen = [math.nan, math.nan], [0.0, 0.0]


def unsupported_reason(attribute: Attribution, measured: Collection[str]) -> str:
    """Return the obstacle with its remedy, or an empty text; `measured`: quantities that have a sensor."""
    missing = [name for name in ("t1", "t3") if name not in measured]
    if missing:
        return f"without a serial sensor of {' and '.join(missing)}; it takes both t1 and t3: give it, or another kind"
    if attribute is Attribution.FRICTION:
        return 'with attribute "friction", which tensions do not show; give "pretension" or "bending"'
    return ""
