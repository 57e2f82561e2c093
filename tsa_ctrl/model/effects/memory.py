"""Define the effects with memory: the friction state after a reversal, backlash, and a delayed measurement.

Source: the catalogue.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import numpy.typing as npt

from tsa_ctrl.model.effects.search import Coordinate, Scales, Value, Variant, duration, geometric
from tsa_ctrl.model.effects.specification import (
    Columns,
    Draw,
    Kind,
    Motion,
    Parameter,
    Setting,
    Specification,
    Stage,
    Twins,
    non_negative,
    positive,
)
from tsa_ctrl.model.filters import Memory
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.monotonic_segments import MonotonicSegments, dahl, last_reversal, maxwell_slip
from tsa_ctrl.model.signals import Signals

_GRID_TOLERANCE = 0.02  # largest deviation of a step from a whole number of counts, because of rounding in the file
_REVERSAL = 2.5  # counts of a reversal: more than two, with a margin for rounding
_FIRST_MOMENT = 0.01  # s from the log's start in which a displacement is checked for motion
_STILL = 0.1  # of the RMS speed: a slower motion is standstill
_NOISE_TO_STEP = 3.0  # standard deviations of white noise that replace one count in a log without counts


def _followed(parameters: Mapping[str, Setting]) -> Columns:
    """Return the angle that the friction state follows in the loop, which does not integrate the velocity."""
    side = parameters.get("displacement")
    return (("q_m",),) if side == "motor" else (("q_j",),) if side == "joint" else (("q_m", "q_j"),)


def _distances(name: str, s: Scales) -> list[Variant]:
    def of(elements: int, follows: str, reach: float) -> Variant:
        def parameters(u: Array) -> dict[str, Value]:
            return {"presliding_distance": math.exp(u[0]), "elements": elements, "displacement": follows}

        low, high = 0.0002 * reach, 0.7 * reach
        coordinate = Coordinate("presliding_distance", math.log(low), math.log(high), 2e-2)
        starts = tuple((math.log(v),) for v in geometric(3.0 * low, 0.5 * reach, 8))
        return Variant(name, (coordinate,), starts, (), parameters, f"{elements} elements, {follows}")

    # With soft tendons, the motor hardly moves while a reversal of the joint reverses the friction.
    motor = [] if math.isnan(s.motor_step) else [("motor", s.motor_reach)]
    return [of(n, follows, reach) for follows, reach in (*motor, ("joint", s.reach)) for n in (1, 2, 4, 8)]


@dataclass(frozen=True)
class PreslidingHysteresis:
    """Replace sigma by z: dz/ds = (1 - sign(ds) z)/q_p (Dahl), or the mean of N > 1 Maxwell-slip elements.

    Maxwell-slip element i of N slips at +-1, at a distance q_p i/N from rest. z starts at sigma if the log starts in
    motion, otherwise at 0. s is the motor angle, or the joint angle if the log has no motor angle.
    """

    presliding_distance: Annotated[float, positive("rad")]  # q_p
    elements: Annotated[int, Parameter("1", low=1, integer=True)] = 1  # N
    displacement: Annotated[str | None, Parameter(optional=True, choices=("motor", "joint"), fitted=False)] = None

    specification: ClassVar = Specification(
        name="presliding_hysteresis",
        stage=Stage.DIRECTION,
        summary="friction builds up over a displacement after a reversal",
        search=_distances,
        unresolved="the motion is too small to show a build-up after reversals",
        twins=(Twins(("velocity_lag", "stribeck_friction"), (Motion.SPEEDS,)),),
        columns=(("q_m", "q_j", "omega_j"),),
        live_columns=_followed,
        equation="dz/ds = (1 − sign(ds) z)/q_p",
        demo={"presliding_distance": Draw(0.05, 0.1), "displacement": "motor"},
    )

    def path(self, signals: Signals) -> Array:
        """Return the displacement s, rad, (n,); it is integrated from omega_j if the log lacks the angle."""
        if self.displacement != "joint" and signals.q_m is not None:
            return signals.q_m
        if signals.q_j is not None:
            return signals.q_j
        return integrate(signals.omega_j, signals.t)

    def start(self, displacement: Array, t: Array, omega: Array) -> float:
        """Return z(0): the direction of the joint if the displacement s moves at the start, otherwise 0.

        If a load is applied to the joint while the motor rests, the friction state does not change.
        """
        return float(np.sign(omega[0])) if _moves_at_start(displacement, t) else 0.0

    def state(self, displacement: Array | MonotonicSegments, start: float) -> Array:
        """Return z, shape (n,), along a displacement of shape (n,)."""
        legs = displacement if isinstance(displacement, MonotonicSegments) else MonotonicSegments.of(displacement)
        if self.elements == 1:
            return dahl(legs, self.presliding_distance, start)
        return maxwell_slip(legs, self.presliding_distance, self.elements, start)


class PreslidingState:
    """The friction state of `PreslidingHysteresis`, sample by sample, for the control loop."""

    def __init__(self, effect: PreslidingHysteresis) -> None:
        self._distance = effect.presliding_distance
        self._elements = effect.elements
        self.reset()

    def reset(self) -> None:
        self.z = math.nan
        self._last = math.nan
        self._states: list[float] = []

    def update(self, displacement: float, start: float) -> float:
        """Return z after the motion to `displacement` (rad; nan keeps the state); `start` is z at the first call."""
        if self.z != self.z:
            self.z, self._states = start, [start] * self._elements
        if displacement != displacement:
            return self.z
        step = displacement - self._last if self._last == self._last else 0.0
        self._last = displacement
        if self._elements == 1:
            if step > 0.0:
                self.z = 1.0 + (self.z - 1.0) * math.exp(-step / self._distance)
            elif step < 0.0:
                self.z = -1.0 + (self.z + 1.0) * math.exp(step / self._distance)
            return self.z
        step *= self._elements / self._distance
        states = [min(1.0, max(-1.0, z + step / (k + 1))) for k, z in enumerate(self._states)]
        self._states, self.z = states, sum(states) / self._elements
        return self.z


def _gaps(name: str, s: Scales) -> list[Variant]:
    def parameters(u: Array) -> dict[str, Value]:
        return {"gap": math.exp(u[0])}

    low, high = 0.002 * s.reach, 0.5 * s.reach
    coordinate = Coordinate("gap", math.log(low), math.log(high), 4e-2)
    starts = tuple((math.log(v),) for v in geometric(0.004 * s.reach, 0.3 * s.reach, 10))
    return [Variant(name, (coordinate,), starts, (), parameters)]


@dataclass(frozen=True)
class Backlash:
    """The tendons' part of tau_J is 0 while abs(q - q_r) < gap, with q_r the joint angle at the last reversal."""

    gap: Annotated[float, positive("rad")]

    specification: ClassVar = Specification(
        name="backlash",
        stage=Stage.BACKLASH,
        summary="lost motion after each reversal",
        search=_gaps,
        twins=(Twins(("velocity_lag", "stribeck_friction", "presliding_hysteresis"), (Motion.SPEEDS,)),),
        columns=(("q_j",),),
        kinds=(Kind.TENDON_SHEATH, Kind.GEARED_DRIVE),  # a plain drive has no separate joint
        feedforward="not compensated: no torque crosses the backlash of {gap} rad",
        equation="tendon part 0 while |q − q_r| < gap",
    )

    @staticmethod
    def last_reversal(q_j: Array) -> Array:
        """Return the angle of the joint's last reversal, (n,); nan before the first one.

        Reversals of up to two encoder counts do not count.
        """
        return last_reversal(MonotonicSegments.of(q_j), _REVERSAL * resolution(q_j))

    def inside(self, q_j: Array, reversal: Array) -> npt.NDArray[np.bool_]:
        """Return a mask, shape (n,), of the samples with open backlash; `reversal`: result of `last_reversal`."""
        return np.asarray(np.abs(q_j - reversal) < self.gap)


@dataclass(frozen=True)
class TorqueSensorLag:
    """Low-pass the joint torque by 1/(1 + T s); the log starts in steady state."""

    time_constant: Annotated[float, non_negative("s")]  # T

    specification: ClassVar = Specification(
        name="torque_sensor_lag",
        stage=Stage.DELAY,
        summary="the joint torque sensor responds slowly",
        search=duration("time_constant", 0.5, (0.003, 0.3, 9)),
        twins=(
            Twins(
                ("transport_delay", "velocity_lag", "presliding_hysteresis", "stribeck_friction", "backlash"),
                (Motion.SPEEDS,),
            ),
        ),
        kinds=(Kind.TENDON_SHEATH, Kind.GEARED_DRIVE),  # a plain drive has no such sensor
        feedforward="not compensated: the sensor's lag of {time_constant} s does not change the joint torque",
        equation="τ_J ← τ_J / (1 + T s)",
    )

    def apply(self, torque: Array, t: Array) -> Array:
        return Memory("lag", (self.time_constant,)).over(torque, t) if self.time_constant > 0.0 else torque


@dataclass(frozen=True)
class TransportDelay:
    """Delay the measured torque: y(t) = y_true(t - T_d), linear between samples, constant before the first sample."""

    delay: Annotated[float, non_negative("s")]  # T_d

    specification: ClassVar = Specification(
        name="transport_delay",
        stage=Stage.DELAY,
        summary="the measured joint torque is delayed",
        search=duration("delay", 0.2, (0.003, 0.1, 8)),
        twins=(Twins(("velocity_lag", "stribeck_friction", "presliding_hysteresis", "backlash"), (Motion.SPEEDS,)),),
        feedforward="not compensated: a delay of {delay} s cannot be compensated in advance",
        equation="τ_J(t) ← τ_J(t − T_d)",
    )

    def apply(self, torque: Array, t: Array) -> Array:
        return np.asarray(np.interp(t - self.delay, t, torque))


def _moves_at_start(displacement: Array, t: Array) -> bool:
    """Return True if the first moment is faster than _STILL of the log's RMS speed."""
    if len(t) < 2:
        return True
    first = max(1, min(int(np.searchsorted(t, t[0] + _FIRST_MOMENT)), len(t) - 1))
    speed = abs(float(displacement[first] - displacement[0])) / float(t[first] - t[0])
    typical = float(np.sqrt(np.mean(np.square(np.diff(displacement))))) * (len(t) - 1) / float(t[-1] - t[0])
    return speed > _STILL * typical


def integrate(omega: Array, t: Array) -> Array:
    """Return the angle, rad, from a velocity by the trapezoidal rule; it is 0 at the first sample."""
    steps = 0.5 * (omega[1:] + omega[:-1]) * np.diff(t)
    return np.concatenate([[0.0], np.cumsum(steps)])


def resolution(q: Array) -> float:
    """Return one encoder count, rad: the grid of the angles, or an equivalent for a log without counts.

    Without a grid the result is a multiple of the noise (from second differences), so that noise at standstill does not
    count as a reversal.
    """
    steps = np.abs(np.diff(q))
    steps = steps[steps > 0.0]
    if steps.size == 0:
        return 0.0
    count = float(steps.min())
    ratio = steps / count
    if ratio.max() < 1.0 / np.finfo(np.float64).eps and np.all(np.abs(ratio - np.round(ratio)) < _GRID_TOLERANCE):
        return count
    if q.size < 3:
        return 0.0
    noise = float(np.median(np.abs(np.diff(q, 2)))) / 0.6745 / math.sqrt(6.0)  # MAD of white noise, [1 -2 1]
    return _NOISE_TO_STEP * noise
