"""Friction angle and pretension from the tendons' stretch: the estimator kind "stretch", no torque sensor, no load.

The observer of the joint torque (`tsa_ctrl.observer.stretch`) learns ln x beside it, at a pretension that it is given:
what it knows is their product, the half loop h = 2 T_p0 r_J f(x). That is parted here as every estimate is
(`attribution`), gated, bounded and rate-limited as every estimate is; where the law uses it, the observer is given the
pretension, too. The observer goes on while the drive is off; this does not. A joint torque sensor that contradicts the
stretch (`tsa_ctrl.observer.joint_torque`) makes the estimate invalid: it cannot be said which of them is wrong.
"""

from __future__ import annotations

from collections.abc import Callable

from tsa_ctrl.control.attribution import Split
from tsa_ctrl.control.estimator import EstimateState, EstimatorSettings, Sample, toward
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.sliding import sliding
from tsa_ctrl.model.stretch import stretch_line
from tsa_ctrl.observer.stretch import StretchObserver, StretchState

CERTAIN = 0.1  # 1, standard deviation of ln x below which it counts as estimated, as that of a half loop elsewhere
_EVERY = 64  # cycles between two looks: parameters move slowly, and the split of a bent sheath costs
_FORGET = 0.5  # s over which the residual is averaged


class ByStretch:
    """The outputs hold while the observer tells nothing; while invalid they return to the model file's."""

    def __init__(
        self,
        model: TendonSheath,
        settings: EstimatorSettings,
        observer: StretchObserver,
        period: float,
        contradicted: Callable[[], bool] = lambda: False,
        sure: float = 1.0,
    ) -> None:
        """`period` in s; `sure`: 1, of the half loop found, that is there at least, whatever the shape's bound."""
        self.use = bool(settings.use)
        self.sure = sure
        self._contradicted = contradicted
        self._model = model
        self._observer = observer
        self._split = Split(model, settings.attribute, False, settings.bounds)
        self._nominal = (model.friction_angle, model.pretension)
        self._steps = (settings.rate * model.friction_angle * period, settings.rate * model.pretension * period)
        self._per_stretch = stretch_line(model).per_stretch
        self._worst = settings.residual**2
        self._forget = period / _FORGET
        self.reset()

    def reset(self) -> None:
        """Back to the model file's values; what the observer knows stays."""
        self.friction_angle, self.pretension = self._target = self._nominal
        self.state = EstimateState.UNESTIMATED
        self.residual = 0.0  # (N*m)^2 at the joint
        self._until = _EVERY

    def update(self, seen: Sample) -> None:
        """One cycle; the observer has already seen its measurements."""
        observer = self._observer
        if seen.admit and observer.state is StretchState.TOLD:
            error = self._per_stretch * observer.innovation
            self.residual += self._forget * (error * error - self.residual)
            self._until -= 1
            if self._until <= 0:
                self._until = _EVERY
                self._judge()
        steps, target = self._steps, self._target
        self.friction_angle = toward(self.friction_angle, target[0], steps[0])
        self.pretension = toward(self.pretension, target[1], steps[1])

    def _judge(self) -> None:
        """A state holds until certain data say otherwise."""
        observer = self._observer
        if self.residual > self._worst or observer.at_bound or self._contradicted():
            self.state, self._target = EstimateState.INVALID, self._nominal
            return
        if not observer.friction_deviation < CERTAIN:
            return
        half_loop = sliding(self._model, 1.0, observer.friction_angle, observer.pretension).half_loop
        angle, pretension, inside = self._split.solve(half_loop)
        self.state = EstimateState.ESTIMATED if inside else EstimateState.INVALID
        self._target = (angle, pretension) if inside else self._nominal
