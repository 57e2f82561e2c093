"""Accumulate the torque error of a run for its summary, with a few operations per cycle."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.safety.limiter import Reason

SENSOR, ELONGATION, UNKNOWN = "torque sensor", "tendon elongation", "not measured"


@dataclass(frozen=True)
class TorqueError:
    """Joint torque minus set-point, over the cycles with torque after each fade-in.

    Attributes:
        axis: name of the axis.
        source: source of the joint torque: SENSOR, ELONGATION or UNKNOWN.
        seconds: duration of these cycles, s.
        rms, mean, peak, desired_rms: N*m; nan without a measured cycle.
        limited: share of these cycles by name of the active limit.
    """

    axis: str
    source: str
    seconds: float
    rms: float
    mean: float
    peak: float
    desired_rms: float
    limited: dict[str, float]


class TorqueErrorCounter:
    """Accumulate the torque error of one axis; call `update` once per cycle."""

    def __init__(self, axis: ControlAxis, period: float) -> None:
        self._axis = axis
        self._period = period
        self._cycles = self._measured = self._by_sensor = 0
        self._sum = self._squares = self._peak = self._desired = 0.0
        self._reasons: Counter[int] = Counter()

    def update(self) -> None:
        """Add the values of this cycle."""
        axis = self._axis
        reason = axis.reason
        if reason == Reason.DISABLED or not axis.law.faded or axis.ramp < 1.0:
            return
        self._cycles += 1
        if reason:
            self._reasons[reason] += 1
        torque = axis.instruments.tau_j
        if torque == torque:
            self._by_sensor += 1
        else:
            torque = axis.joint_torque.torque
        desired = axis.terms.tau_j_des
        error = torque - desired
        if error == error:
            self._measured += 1
            self._sum += error
            self._squares += error * error
            self._desired += desired * desired
            self._peak = max(self._peak, abs(error))

    def result(self) -> TorqueError:
        """Return the results so far."""
        number = self._measured
        source = UNKNOWN if number == 0 else SENSOR if 2 * self._by_sensor > number else ELONGATION

        def share(total: float) -> float:
            return total / number if number else math.nan

        return TorqueError(
            self._axis.name,
            source,
            self._cycles * self._period,
            math.sqrt(share(self._squares)),
            share(self._sum),
            self._peak if number else math.nan,
            math.sqrt(share(self._desired)),
            {Reason(code).name: count / self._cycles for code, count in self._reasons.most_common()},
        )
