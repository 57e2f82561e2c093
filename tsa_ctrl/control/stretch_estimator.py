"""Friction angle and pretension from the tendons' stretch: the estimator kind "stretch", no torque sensor, no load.

The observer of the joint torque (`tsa_ctrl.observer.stretch`) learns ln x beside it, at a given pretension:
it determines their product, the friction torque h = 2 T_p0 r_J f(x). That is parted here as every estimate is
(`attribution`), gated, bounded and rate-limited as every estimate is; where the law uses it, the observer is given the
pretension, too. The observer goes on while the drive is off; this does not. A joint torque sensor that contradicts the
stretch (`tsa_ctrl.observer.joint_torque`) makes the estimate invalid: it cannot be said which of them is wrong.

Friction stretches the tendons the other way when they turn; a torque, a zero or a time that is wrong does not, and on a
joint that goes one way for seconds looks like friction. So more than the model file's half loop is taken only as far as
both ways of late have shown it (and `ROOM`), and less at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from tsa_ctrl.control.estimator import EstimateState, Sample, Split, sooner_down
from tsa_ctrl.control.settings import EstimatorSettings
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding_by
from tsa_ctrl.model.stretch import stretch_line
from tsa_ctrl.observer.stretch import StretchObserver, StretchState

CERTAIN = 0.1  # 1, standard deviation of ln x below which it counts as estimated, as that of a half loop elsewhere
BOTH_WAYS = 0.1  # s that the tendon went one way, after which what is estimated is what that way shows
ROOM = 0.05  # 1, beyond the lesser of both: what a compensation of 0.95 leaves; without, 40 % more is followed late
_EVERY = 64  # cycles between two looks: parameters move slowly, and the split of a bent sheath costs
_FORGET = 0.5  # s over which the residual is averaged


class StretchEstimator:
    """The outputs hold while the observer determines nothing; invalid, they fall to the model file's and never rise."""

    why = ""

    def __init__(
        self,
        model: TendonSheath,
        settings: EstimatorSettings,
        observer: StretchObserver,
        period: float,
        contradicted: Callable[[], bool] = lambda: False,
    ) -> None:
        """`period` in s."""
        self.use = bool(settings.use)
        self._contradicted = contradicted
        self._sliding = sliding_by(model)
        self._observer = observer
        self._split = Split(model, settings.attribute, False, settings.bounds)
        self._nominal = (model.friction_angle, model.pretension)
        self._steps = (settings.rate * model.friction_angle * period, settings.rate * model.pretension * period)
        self._least = max(1, round(BOTH_WAYS / period))
        self._per_stretch = stretch_line(model).per_stretch
        self._worst = settings.residual**2
        self._forget = period / _FORGET
        self.reset()

    def reset(self) -> None:
        """Back to the model file's values; the knowledge of the observer stays."""
        self.friction_angle, self.pretension = self._target = self._nominal
        self.state = EstimateState.UNESTIMATED
        self.residual = 0.0  # (N*m)^2 at the joint
        self._until = _EVERY
        self._shown = [0.0, 0.0]  # N*m of half loop, one way and the other
        self._way, self._went = 0, 0  # and for how many cycles

    @property
    def found(self) -> float:
        """1, the more of what both ways have shown last, over the model file's half loop; nan while not both have."""
        known = self.state is EstimateState.ESTIMATED and min(self._shown) > 0.0
        return max(self._shown) / self._split.nominal if known else math.nan

    def update(self, seen: Sample) -> None:
        """One cycle; the observer has already seen its measurements."""
        observer = self._observer
        if seen.admit and observer.state is StretchState.TOLD:
            error = self._per_stretch * observer.innovation
            self.residual += self._forget * (error * error - self.residual)
            way = int(seen.sigma > 0.0)
            self._went = self._went + 1 if way == self._way else 0
            self._way = way
            self._until -= 1
            if self._until <= 0:
                self._until = _EVERY
                self._judge()
        angle, tension = self._target
        for_angle, for_tension = self._steps
        if self.friction_angle != angle:
            self.friction_angle = sooner_down(self.friction_angle, angle, for_angle)
        if self.pretension != tension:
            self.pretension = sooner_down(self.pretension, tension, for_tension)

    def _judge(self) -> None:
        """A state holds until reliable data contradict it."""
        observer = self._observer
        if self.residual > self._worst or observer.at_bound or self._contradicted():
            self.state, self._target = EstimateState.INVALID, self._fallback()
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
        self.state = EstimateState.ESTIMATED if inside else EstimateState.INVALID
        self._target = (angle, pretension) if inside else self._fallback()

    def _fallback(self) -> tuple[float, float]:
        """The model file's values, but no more than was used last: it cannot be said which of them is wrong."""
        used = self._sliding(1.0, self.friction_angle, self.pretension).half_loop
        return self._nominal if used > self._split.nominal else (self.friction_angle, self.pretension)
