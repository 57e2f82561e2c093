"""Estimate friction angle and pretension from the tendon elongation (kind "stretch"), without torque sensor or load.

The observer of the joint torque (`tsa_ctrl.observer.stretch`) also estimates ln x, at a given pretension. Both together
determine the friction torque h = 2 T_p0 r_J f(x). Like every estimate, it is split into friction angle and pretension
(`attribution`), gated, bounded and rate-limited here. If the law uses it, the observer receives the pretension. The
observer continues while the drive is off; this estimator does not. A joint torque sensor that contradicts the
elongation (`tsa_ctrl.observer.joint_torque`) makes the estimate invalid, because the faulty one is not identifiable.

When the tendons reverse, friction changes the sign of its share of the elongation. An error of torque, zero or time
does not, so on a joint that moves in one direction for seconds, it looks like friction. An estimate above the model
file's friction torque is therefore used only as far as recent motion in both directions confirms it (plus `ROOM`). A
lower estimate is used immediately.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from tsa_ctrl.control.estimator import EstimateState, GatedEstimator, Sample, Split
from tsa_ctrl.control.settings import EstimatorSettings
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import stretch_line
from tsa_ctrl.observer.stretch import StretchObserver, StretchState

CERTAIN = 0.1  # 1, standard deviation of ln x below which it counts as estimated; same limit as for friction torque
BOTH_WAYS = 0.1  # s of motion in one direction, after which the estimate is valid for this direction
ROOM = 0.05  # 1, above the lower of both: the rest of a compensation of 0.95; without it, a rise of 40 % takes longer
_EVERY = 64  # cycles between two evaluations: parameters change slowly, and the split for a bent sheath takes time
_FORGET = 0.5  # s over which the residual is averaged


class StretchEstimator(GatedEstimator):
    """Estimate by the observer's elongation; the outputs do not change while the observer has no estimate."""

    def __init__(
        self,
        model: TendonSheath,
        settings: EstimatorSettings,
        observer: StretchObserver,
        period: float,
        contradicted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepare the estimator; `period` in s."""
        super().__init__(model, settings, period)
        self._contradicted = contradicted
        self._observer = observer
        self._split = Split(model, settings.attribute, False, settings.bounds)
        self._least = max(1, round(BOTH_WAYS / period))
        self._per_stretch = stretch_line(model).per_stretch
        self._worst = settings.residual**2
        self._forget = period / _FORGET
        self.reset()

    def reset(self) -> None:
        """Return to the model file's values; the observer keeps its state."""
        super().reset()
        self.residual = 0.0  # (N*m)^2 at the joint
        self._until = _EVERY
        self._shown = [0.0, 0.0]  # N*m, last friction torque of each direction
        self._way, self._went = 0, 0  # present direction, and its number of cycles

    @property
    def half_loop_ratio(self) -> float:
        """Return the larger friction torque of both directions over the file's value, 1; nan until both are known."""
        known = self.state is EstimateState.ESTIMATED and min(self._shown) > 0.0
        return max(self._shown) / self._split.nominal if known else math.nan

    def update(self, seen: Sample) -> None:
        """Process one cycle, whose measurements the observer has already processed."""
        observer = self._observer
        if seen.admit and observer.state is StretchState.ESTIMATED:
            error = self._per_stretch * observer.innovation
            self.residual += self._forget * (error * error - self.residual)
            way = int(seen.sigma > 0.0)
            self._went = self._went + 1 if way == self._way else 0
            self._way = way
            self._until -= 1
            if self._until <= 0:
                self._until = _EVERY
                self._judge()
        self._approach()

    def _judge(self) -> None:
        """Update state and target; a state holds until reliable data contradict it."""
        observer = self._observer
        if self.residual > self._worst or observer.at_bound or self._contradicted():
            self._refuse()
            self._shown = [0.0, 0.0]
            return
        if not observer.friction_deviation < CERTAIN:
            return
        half_loop = self._sliding(1.0, observer.friction_angle, observer.pretension).half_loop
        if self._went >= self._least:
            self._shown[self._way] = half_loop
        angle, pretension, inside = self._split.solve(half_loop)
        most = max(self._split.nominal, (1.0 + ROOM) * min(self._shown))
        if inside and half_loop > most:
            angle, pretension, _ = self._split.solve(most)
        if inside:
            self._accept(angle, pretension)
        else:
            self._refuse()
