"""Effects on the motor's side, in the order in which they turn the reported torque into the one on the pulley.

tau_M: torque that the drive reports, N*m. Source: the catalogue of effects; `invert` undoes `apply`.
"""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.model.effects.state import State
from tsa_ctrl.model.functions import F, Functions


@dataclass(frozen=True)
class VelocityLag:
    """The logged omega is the true one through 1/(1 + T s): true = omega + T domega/dt, wherever omega enters."""

    time_constant: float  # T, s

    def true_velocity(self, omega: F, acceleration: F) -> F:
        return omega + self.time_constant * acceleration


@dataclass(frozen=True)
class TorqueConstantError:
    """tau_M *= 1 + e."""

    relative_error: float  # e, 1

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m * (1.0 + self.relative_error)

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m / (1.0 + self.relative_error)


@dataclass(frozen=True)
class TorqueRipple:
    """tau_M += A sin(N q_M + phi)."""

    amplitude: float  # A, N*m
    cycles_per_revolution: int  # N, 1
    phase: float = 0.0  # phi, rad

    def ripple(self, functions: Functions[F], state: State[F]) -> F:
        return self.amplitude * functions.sin(self.cycles_per_revolution * state.q_m + self.phase)

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m + self.ripple(functions, state)

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m - self.ripple(functions, state)


@dataclass(frozen=True)
class MotorSideFriction:
    """tau_M -= tau_c sigma."""

    coulomb: float  # tau_c, N*m

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m - self.coulomb * state.sigma

    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        return tau_m + self.coulomb * state.sigma
