"""Define the effects at the motor, in the order that converts the reported torque to the torque on the pulley.

tau_M is the torque that the drive reports, N*m. `invert` is the inverse of `apply`. Source: the catalogue of effects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.search import (
    Coordinate,
    Scales,
    Value,
    Variant,
    duration,
    geometric,
    linear,
    one,
    wave,
)
from tsa_ctrl.model.effects.specification import (
    Draw,
    Kind,
    Motion,
    Parameter,
    Specification,
    Stage,
    Twins,
    non_negative,
    positive,
)
from tsa_ctrl.model.functions import Array, F, Functions

MOST_CYCLES = 40  # most cycles of torque ripple per motor turn for which a fit searches
LEAST_LIMIT = 0.2  # of the largest motor torque of a log; a lower limit means another motor
LINES_PER_RANGE = 0.6  # turns of the ripple's phase that a log must contain


def _derived(s: Scales) -> str:
    return f"{s.derived_velocity} was derived from the angle by a zero-phase filter" if s.derived_velocity else ""


@dataclass(frozen=True)
class VelocityLag:
    """Replace omega by omega + T domega/dt everywhere, because the logged omega is the true one after 1/(1 + T s)."""

    time_constant: Annotated[float, non_negative("s")]  # T

    specification: ClassVar = Specification(
        name="velocity_lag",
        stage=Stage.VELOCITY,
        summary="the measured velocity lags behind the true one",
        search=duration("time_constant", 0.3, (0.004, 0.15, 9), lambda s: max(0.3, 1.5 * s.period / 0.01)),
        untestable=_derived,
        columns=(("omega_j",),),
        feedforward="compensated in the velocity; the loop leads the direction",
        equation="σ = sign(ω + T dω/dt)",
    )

    def true_velocity(self, omega: F, acceleration: F) -> F:
        return omega + self.time_constant * acceleration


def _limits(name: str, s: Scales) -> list[Variant]:
    def parameters(u: Array) -> dict[str, Value]:
        return {"limit": math.exp(u[0])}

    low, high = LEAST_LIMIT * s.largest_motor_torque, s.largest_motor_torque
    if not low > 0.0:
        return []
    coordinate = Coordinate("limit", math.log(low), math.log(high), 1e-2)
    starts = tuple((math.log(v),) for v in geometric(1.05 * low, 0.97 * high, 10))
    return [Variant(name, (coordinate,), starts, (), parameters)]


@dataclass(frozen=True)
class TorqueSaturation:
    """Limit tau_M to +-limit: the drive reports more torque than the motor delivers."""

    limit: Annotated[float, positive("N*m")]

    specification: ClassVar = Specification(
        name="torque_saturation",
        stage=Stage.MOTOR_TORQUE,
        summary="the motor torque is limited, whatever torque the drive reports",
        search=_limits,
        unresolved="the motor torque is always 0",
        twins=(Twins(("torque_constant_error", "load_dependent_friction"), (Motion.SIGNS,)),),
        kinds=(Kind.TENDON_SHEATH, Kind.GEARED_DRIVE),  # the model of a plain drive predicts the reported torque
        feedforward="commands stay within the limit of {limit} N*m",
        equation="τ_M ← min(max(τ_M, −L), L)",
    )

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return self._within(functions, tau_m)

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        """Return the nearest torque that the motor can deliver."""
        return self._within(functions, tau_m)

    def _within(self, functions: Functions[F], tau_m: F) -> F:
        return -functions.at_least(-functions.at_least(tau_m, -self.limit), -self.limit)


@dataclass(frozen=True)
class TorqueConstantError:
    """tau_M *= 1 + e."""

    relative_error: Annotated[float, Parameter("1", low=-0.5, high=0.5)]  # e

    specification: ClassVar = Specification(
        name="torque_constant_error",
        stage=Stage.MOTOR_TORQUE,
        summary="the torque that the drive reports has a wrong scale",
        search=linear("relative_error", one, -0.5, 0.5),
        twins=(Twins(("parameter_error",), (Motion.GAIN,)),),
        equation="τ_M ← (1 + e) τ_M",
    )

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m * (1.0 + self.relative_error)

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m / (1.0 + self.relative_error)


def _ripples(name: str, s: Scales) -> list[Variant]:
    def of(cycles: int) -> Variant:
        choice = {"cycles_per_revolution": cycles}
        return wave(name, "amplitude", s.motor_torque, label=f"{cycles} cycles", choice=choice)

    def resolved(cycles: int) -> bool:  # false without a motor angle
        return cycles * s.motor_reach / math.pi > LINES_PER_RANGE and cycles * s.motor_step < 0.6 * math.pi

    first = 2 if s.plain else 1  # in a plain drive, one cycle per turn is the effect of a weight on the shaft
    return [of(cycles) for cycles in range(first, MOST_CYCLES + 1) if resolved(cycles)]


@dataclass(frozen=True)
class TorqueRipple:
    """tau_M += A sin(N q_M + phi)."""

    amplitude: Annotated[float, non_negative("N*m")]  # A
    cycles_per_revolution: Annotated[int, Parameter("1", low=1, integer=True)]  # N
    phase: Annotated[float, Parameter("rad", low=-math.pi, high=math.pi)] = 0.0  # phi

    specification: ClassVar = Specification(
        name="torque_ripple",
        stage=Stage.MOTOR_TORQUE,
        summary="cogging or torque ripple of the motor",
        search=_ripples,
        unresolved="the motor turns too little to show a torque ripple",
        columns=(("q_m",),),
        equation="τ_M ← τ_M + A sin(N q_M + φ)",
        demo={
            "amplitude": Draw(0.06, 0.12),
            "cycles_per_revolution": Draw(8, 17, whole=True),
            "phase": Draw(-3.0, 3.0),
        },
    )

    def ripple(self, functions: Functions[F], state: State[F]) -> F:
        return self.amplitude * functions.sin(self.cycles_per_revolution * state.q_m + self.phase)

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m + self.ripple(functions, state)

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m - self.ripple(functions, state)


@dataclass(frozen=True)
class MotorSideFriction:
    """tau_M -= tau_c sigma."""

    coulomb: Annotated[float, non_negative("N*m")]  # tau_c

    specification: ClassVar = Specification(
        name="motor_side_friction",
        stage=Stage.MOTOR_TORQUE,
        summary="Coulomb friction in the motor and its gear",
        search=linear("coulomb", lambda s: s.motor_torque, low=0.0),
        twins=(Twins(("parameter_error",), (Motion.SPEEDS,)),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="τ_M ← τ_M − τ_c σ",
    )

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m - self.coulomb * state.sigma

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m + self.coulomb * state.sigma
