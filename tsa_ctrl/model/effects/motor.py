"""Effects on the motor's side, in the order in which they turn the reported torque into the one on the pulley.

tau_M: torque that the drive reports, N*m. Source: the catalogue of effects; `invert` undoes `apply`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from tsa_ctrl.model.effects.specification import Draw, Parameter, Shown, Specification, Stage, non_negative
from tsa_ctrl.model.effects.state import State
from tsa_ctrl.model.functions import F, Functions


@dataclass(frozen=True)
class VelocityLag:
    """The logged omega is the true one through 1/(1 + T s): true = omega + T domega/dt, wherever omega enters."""

    time_constant: Annotated[float, non_negative("s")]  # T

    specification: ClassVar = Specification(
        name="velocity_lag",
        stage=Stage.VELOCITY,
        summary="the measured velocity lags behind the true one",
        columns=(("omega_j",),),
        feedforward="compensated in the velocity; the direction is led by the loop",
        shown=Shown({"time_constant": 0.02}, "time", "σ = sign(ω + T dω/dt)", short=True),
    )

    def true_velocity(self, omega: F, acceleration: F) -> F:
        return omega + self.time_constant * acceleration


@dataclass(frozen=True)
class TorqueConstantError:
    """tau_M *= 1 + e."""

    relative_error: Annotated[float, Parameter("1", low=-0.5, high=0.5)]  # e

    specification: ClassVar = Specification(
        name="torque_constant_error",
        stage=Stage.MOTOR_TORQUE,
        summary="the drive's torque has a wrong scale",
        shown=Shown({"relative_error": 0.05}, "load", "τ_M ← (1 + e) τ_M"),
    )

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m * (1.0 + self.relative_error)

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m / (1.0 + self.relative_error)


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
        columns=(("q_m",),),
        shown=Shown(
            {"amplitude": 0.03, "cycles_per_revolution": 12, "phase": 0.4},
            "motor",
            "τ_M ← τ_M + A sin(N q_M + φ)",
            short=True,
        ),
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
        rigid_drive=False,
        shown=Shown({"coulomb": 0.03}, "speed", "τ_M ← τ_M − τ_c σ", short=True),
    )

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m - self.coulomb * state.sigma

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m + self.coulomb * state.sigma
