"""Define the parameters that a client may change while the loop runs: name, unit, bounds and rate of each.

`Tuner` moves the parameters of one axis to their requested values, a step per cycle, so that the torque never jumps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.direction import LEAST_ZONE
from tsa_ctrl.control.estimator import Fixed, rate_limit
from tsa_ctrl.control.kalman import KalmanEstimator
from tsa_ctrl.control.stretch_estimator import StretchEstimator
from tsa_ctrl.control.tension_estimator import TensionEstimator

_NONE: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True)
class Parameter:
    """Describe one live parameter of one axis, which is an attribute of one of its parts."""

    name: str
    unit: str
    low: float | None
    high: float | None
    rate: float  # unit/s; inf: at once
    doc: str
    part: Any
    attribute: str
    restores: bool = False  # its highest value releases a latch; no other value may raise it
    switch: bool = False  # 0 or 1; values in between mean the same as 1

    @property
    def value(self) -> float:
        return float(getattr(self.part, self.attribute))


def parameters_of(axis: ControlAxis) -> tuple[Parameter, ...]:
    """Return the live parameters of an axis, with the same names for each axis.

    No value weakens the protection that the files define. A limit stays at or below the file's value. The zone can only
    be widened. An estimate in use stays in use. Only a release restores the guard's share.
    A parameter without bounds cannot be set on this axis; its text names the key that permits it.
    """
    law, limiter, estimator, model = axis.law, axis.limiter, axis.estimator, axis.model
    fixed = isinstance(estimator, Fixed)
    angle, pretension = model.friction_angle, model.pretension  # may only rise within [uncertainty]
    angles = (0.0, angle * (1.0 + model.friction_angle_uncertainty)) if fixed else _NONE
    tensions = (0.0, pretension * (1.0 + model.pretension_uncertainty)) if fixed else _NONE
    use = _NONE
    if isinstance(estimator, KalmanEstimator | StretchEstimator | TensionEstimator):
        use = _NONE if estimator.use else (0.0, 1.0)  # it may have found less friction than the file has
    bends = (0.0, 2.0 * max(axis.bending.commanded, model.bending_angle)) if axis.bending.settable else _NONE
    zone = max(LEAST_ZONE, axis.direction.zone)
    damps = (0.0, law.plan.damping) if law.plan.damping > 0.0 else _NONE
    why = "" if fixed else '; the estimator determines it, kind = "fixed" in [axis.estimator] lets a client set it'
    damped = "" if damps is not _NONE else "; give [axis.law] motor_inertia"
    used = "" if use is not _NONE else "; an estimate in use stays in use, and a fixed value is not an estimate"
    bent = "" if bends is not _NONE else '; source = "command" in [axis.bending] lets a client set it'
    p, inf = Parameter, math.inf
    return (
        p("compensation", "1", 0.0, 1.2, 0.5, "share of the friction term that is compensated", law, "compensation"),
        p("slew", "N*m/s", 1.0, 10_000.0, inf, "fastest change of the friction term", law, "slew"),
        p("damping", "N*m*s/rad", *damps, inf, f"of the motor's swing on its tendons{damped}", law.damping, "gain"),
        p("friction_angle", "1", *angles, 0.5 * angle, f"x = mu Theta{why}", estimator, "friction_angle"),
        p("pretension", "N", *tensions, 0.5 * pretension, f"T_p0{why}", estimator, "pretension"),
        p("use_estimate", "1", *use, inf, f"whether the law uses the estimates{used}", estimator, "use", switch=True),
        p("bending_angle", "rad", *bends, 2.0, f"commanded Theta, without joints{bent}", axis.bending, "commanded"),
        p("direction_zone", "rad/s", zone, 10.0, inf, "joint speed that counts as 0", axis.direction, "zone"),
        p("setpoint_gain", "1", -2.0, 2.0, 0.5, "scales the set-point", axis.set_point, "gain"),
        p("back_off", "1", 0.0, 1.0, inf, "of the guard; 1 releases its latch", axis.guard, "back_off", restores=True),
        p(
            "torque_limit",
            "N*m",
            0.0,
            limiter.torque,
            4.0 * limiter.torque,
            "absolute, at the motor",
            limiter,
            "torque",
        ),
        p("rate_limit", "N*m/s", 1.0, limiter.rate, inf, "of the motor torque", limiter, "rate"),
    )


class Tuner:
    """Move the parameters of one axis to their requested values."""

    def __init__(self, parameters: tuple[Parameter, ...], period: float) -> None:
        self.parameters = parameters
        self._period = period
        self._moving: dict[int, float] = {}

    def set(self, index: int, value: float) -> None:
        """Request a value; a value outside the bounds or nan is ignored."""
        parameter = self.parameters[index]
        if parameter.low is not None and parameter.high is not None and parameter.low <= value <= parameter.high:
            self._moving[index] = value

    def update(self) -> None:
        """Move every pending parameter by the step of one cycle."""
        if not self._moving:
            return
        for index, target in list(self._moving.items()):
            parameter = self.parameters[index]
            value = rate_limit(parameter.value, target, parameter.rate * self._period)
            setattr(parameter.part, parameter.attribute, value)
            if value == target:
                del self._moving[index]
