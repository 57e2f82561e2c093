"""Estimate friction angle x and pretension T_p while the loop runs.

There are six kinds of estimator:

* "fixed": the model file's values.
* "map": x = mu Theta and T_p by (3.52), (3.56), from a measured or commanded bending angle Theta.
* "sensor" and "motor": recursive, see `kalman`.
* "stretch": from two encoders, see `stretch_estimator`.
* "tension": from two load cells, see `tension_estimator`.

All kinds have the same three outputs. Every disable resets them. No parameter changes faster than its rate. The kinds
that use measurements of the torque share their outputs, bounds on the rate, and reaction to contradictory data
(`GatedEstimator`).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from tsa_ctrl.control.settings import Attribution, EstimatorSettings
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding, sliding_by

SMALLEST_ANGLE = 1e-3  # 1, friction angle below which the split is not defined
POINTS = 256  # of the table that inverts the friction torque to 1e-5 of it, without an iteration in the loop


class Split:
    """Split a friction torque into friction angle (1) and pretension (N), by an attribution that the user selects.

    The friction torque is 2 T_p r_J sinh x at the joint, and 2 T_p r_M tanh x at the motor, N*m. With
    `elongation_coupling` it follows from the position of the bends (`tsa_ctrl.model.steady_sliding`).
    """

    def __init__(self, model: TendonSheath, attribution: Attribution, at_motor: bool, bounds: float) -> None:
        """Tabulate the friction torque; `bounds`: largest factor of the changing quantity up or down, minus 1."""
        self._attribution = attribution
        self._per_pretension = _half_loop_of(model, at_motor)
        self._mu = model.friction_coefficient
        self._angle = max(model.friction_angle, SMALLEST_ANGLE)
        self._pretension = model.pretension
        self._theta = max(model.bending_angle, SMALLEST_ANGLE)
        self._slope = model.pretension_slope
        low, high = 1.0 / (1.0 + bounds), 1.0 + bounds
        if attribution is Attribution.BENDING:  # far below, the pretension may reach 0, where the map folds
            low = max(low, 1.0 - 0.95 * self._pretension / max(self._slope * self._theta, 1e-12))
        self._factors = tuple(low + (high - low) * k / POINTS for k in range(POINTS + 1))
        self._half_loops = tuple(self._half_loop(factor) for factor in self._factors)
        self.nominal = self._half_loop(1.0)

    def parameters(self, factor: float) -> tuple[float, float]:
        """Return friction angle and pretension if the changing quantity is `factor` times its nominal value."""
        if self._attribution is Attribution.FRICTION:
            return self._angle * factor, self._pretension
        if self._attribution is Attribution.PRETENSION:
            return self._angle, self._pretension * factor
        theta = self._theta * factor
        return self._mu * theta, max(0.0, self._pretension + self._slope * (theta - self._theta))

    def _half_loop(self, factor: float) -> float:
        """Return the friction torque for `parameters(factor)`, N*m."""
        angle, pretension = self.parameters(factor)
        return pretension * self._per_pretension(angle)

    def solve(self, half_loop: float) -> tuple[float, float, bool]:
        """Return friction angle, pretension, and True if the friction torque (N*m) is within the bounds.

        Outside the bounds, the parameters at the nearest bound are returned.
        """
        factors, loops = self._factors, self._half_loops
        if half_loop <= loops[0]:
            return *self.parameters(factors[0]), False
        if half_loop >= loops[-1]:
            return *self.parameters(factors[-1]), False
        above = bisect.bisect_left(loops, half_loop)
        share = (half_loop - loops[above - 1]) / (loops[above] - loops[above - 1])
        return *self.parameters(factors[above - 1] + share * (factors[above] - factors[above - 1])), True


def _half_loop_of(model: TendonSheath, at_motor: bool) -> Callable[[float], float]:
    """Return a function from the friction angle to the friction torque at motor or joint over the pretension, m."""
    arm = 2.0 * (model.motor_pulley_radius if at_motor else model.joint_pulley_radius)
    if "elongation_coupling" not in model.effects:
        function = math.tanh if at_motor else math.sinh
        return lambda angle: arm * function(angle)
    if at_motor:
        return lambda angle: sliding(model, 1.0, angle, 1.0).motor_half_loop
    return lambda angle: sliding(model, 1.0, angle, 1.0).half_loop


JUMP = 0.1  # rad of the bending angle between two values: 2 rad/s of a sensor with 20 values per second


class EstimateState(IntEnum):
    """List the states of an estimate; the values are the codes in the log."""

    FIXED = 0
    UNESTIMATED = 1  # too little excitation so far; the outputs are nominal
    ESTIMATED = 2
    INVALID = 3  # the data contradict the model or require a parameter beyond its bounds; each kind defines the outputs


@dataclass(slots=True)
class Sample:
    """Hold the inputs of an estimator in one cycle; nan if not measured. An axis reuses one object in all cycles."""

    sigma: float  # 1, direction of the tendon
    omega_j: float  # rad/s
    theta: float  # rad, bending angle
    tau_m: float  # N*m
    tau_j: float  # N*m
    admit: bool  # false while the drive is off or a value is stale
    q_j: float = math.nan  # rad
    q_m: float = math.nan  # rad
    t1: float = math.nan  # N, of tendon a at the motor
    t3: float = math.nan  # N, of tendon b
    fading: bool = False  # the change of theta is already a fade
    temperature: float = math.nan  # degC, as the law uses it
    t: float = 0.0  # s since the enable, as the law uses it


class Estimator(Protocol):
    """Define the interface of all kinds of estimators."""

    friction_angle: float  # 1
    pretension: float  # N
    state: EstimateState
    use: bool  # True if the law may use both values
    reason: str  # explanation of the state INVALID; empty if the state is sufficient

    @property
    def half_loop_ratio(self) -> float:
        """Return the friction torque estimated in both directions over the file's value, 1; nan without an estimate."""

    def update(self, seen: Sample) -> None: ...

    def reset(self) -> None: ...


class Fixed:
    """Use the model file's values, or the values that a client sets."""

    state = EstimateState.FIXED
    use = True
    reason = ""
    half_loop_ratio = math.nan

    def __init__(self, model: TendonSheath) -> None:
        self.friction_angle = model.friction_angle
        self.pretension = model.pretension

    def update(self, seen: Sample) -> None:
        """Do nothing, because the values are constant."""

    def reset(self) -> None:
        """Do nothing, because no state is stored."""


class ConfigurationMap:
    """Derive x and T_p from the measured bending angle Theta, whose motion is followed without delay.

    A jump is not motion. It is a client's command or the first value after a gap, and is approached at the rate.

    The map is invalid and frozen while Theta is missing. It is invalid and held at its bound while Theta exceeds 1 +
    bounds times the model file's value. A straight sheath is valid, because less friction needs less compensation.
    """

    use = True
    reason = ""
    half_loop_ratio = math.nan

    def __init__(
        self, model: TendonSheath, settings: EstimatorSettings, period: float, most_theta: float | None = None
    ) -> None:
        """Prepare the map; `period` in s; `most_theta` in rad, by default from the bounds of the settings."""
        self._mu = model.friction_coefficient
        self._theta = model.bending_angle
        self._most_theta = (1.0 + settings.bounds) * model.bending_angle if most_theta is None else most_theta
        self._pretension = model.pretension
        self._slope = model.pretension_slope
        self._step = settings.rate * model.bending_angle * period
        self._nominal = model.friction_angle
        self.reset()

    def reset(self) -> None:
        self.friction_angle = self._nominal
        self.pretension = self._pretension
        self.state = EstimateState.UNESTIMATED
        self._gap = 0.0  # rad by which the angle in use is behind the measured one
        self._last = math.nan  # rad

    def update(self, seen: Sample) -> None:
        """Follow the bending angle."""
        theta, last = seen.theta, self._last
        if not math.isfinite(theta):
            self.state = EstimateState.INVALID
            return
        self.state = EstimateState.ESTIMATED
        if theta > self._most_theta:
            theta, self.state = self._most_theta, EstimateState.INVALID
        if abs(theta - last) > JUMP and not seen.fading:
            self._gap += last - theta
        self._last = theta
        self._gap = rate_limit(self._gap, 0.0, self._step)
        self.friction_angle, self.pretension = self.parameters(theta + self._gap)

    def parameters(self, theta: float) -> tuple[float, float]:
        """Return friction angle (1) and pretension (N) at the wrap angle `theta` (rad), by (3.52) and (3.56)."""
        return self._mu * theta, max(0.0, self._pretension + self._slope * (theta - self._theta))


DOWN = 5.0  # times the rate for a falling parameter, because too much compensation moves the joint in the meantime


class GatedEstimator:
    """Hold the outputs of an estimator that uses measurements; they approach a target at the rate of the settings.

    Contradictory data never raise the friction torque, because it is unknown which signal is wrong.
    """

    def __init__(self, model: TendonSheath, settings: EstimatorSettings, period: float, down: float = DOWN) -> None:
        """Prepare the outputs; `period` in s; `down`: ratio of the rates of a falling and a rising parameter."""
        self.use = bool(settings.use)
        self._down = down
        self._sliding = sliding_by(model)
        self._nominal = (model.friction_angle, model.pretension)
        self._half_loop = self._sliding(1.0, *self._nominal).half_loop
        self._steps = (settings.rate * model.friction_angle * period, settings.rate * model.pretension * period)

    def reset(self) -> None:
        """Return to the model file's values without an estimate."""
        self.friction_angle, self.pretension = self._target = self._nominal
        self.state = EstimateState.UNESTIMATED
        self.reason = ""

    def _approach(self) -> None:
        """Move the outputs towards the target by one cycle."""
        (angle, pretension), (for_angle, for_pretension) = self._target, self._steps
        if self.friction_angle != angle:
            down = self._down if angle < self.friction_angle else 1.0
            self.friction_angle = rate_limit(self.friction_angle, angle, down * for_angle)
        if self.pretension != pretension:
            down = self._down if pretension < self.pretension else 1.0
            self.pretension = rate_limit(self.pretension, pretension, down * for_pretension)

    def _accept(self, angle: float, pretension: float) -> None:
        """Use an estimate of friction angle (1) and pretension (N)."""
        self.state, self.reason, self._target = EstimateState.ESTIMATED, "", (angle, pretension)

    def _refuse(self, reason: str = "") -> None:
        """Use the model file's values, or the present ones if they have less friction: either may be wrong."""
        if self.state is not EstimateState.INVALID:
            self.state, self.reason = EstimateState.INVALID, reason
            used = self._sliding(1.0, self.friction_angle, self.pretension).half_loop
            self._target = self._nominal if used > self._half_loop else (self.friction_angle, self.pretension)


def rate_limit(value: float, target: float, step: float) -> float:
    """Return `value` moved towards `target` by at most `step`."""
    change = target - value
    if change > step:
        return value + step
    return value - step if change < -step else target
