"""Effects on the joint's side: each gives the torque (N*m) that it takes, tau_J -= f. Source: the catalogue."""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.model.effects.state import State
from tsa_ctrl.model.functions import F, Functions


@dataclass(frozen=True)
class ViscousFriction:
    """f = b omega."""

    coefficient: float  # b, N*m*s/rad

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.coefficient * state.omega


@dataclass(frozen=True)
class DirectionAsymmetricFriction:
    """f = b abs(omega)."""

    viscous_difference: float  # b, N*m*s/rad

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.viscous_difference * abs(state.omega)


@dataclass(frozen=True)
class Inertia:
    """f = J domega/dt; rotor and joint are one here."""

    inertia: float  # J, kg*m^2

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.inertia * state.acceleration


@dataclass(frozen=True)
class GravityLoad:
    """f = A sin(q + phi)."""

    amplitude: float  # A, N*m
    phase: float = 0.0  # phi, rad

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.amplitude * functions.sin(state.q_j + self.phase)


@dataclass(frozen=True)
class JointStiffness:
    """f = k (q - q_0)."""

    stiffness: float  # k, N*m/rad
    rest_angle: float = 0.0  # q_0, rad

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.stiffness * (state.q_j - self.rest_angle)


@dataclass(frozen=True)
class TorqueOffset:
    """f = -c, that is tau_J += c."""

    offset: float  # c, N*m

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return -self.offset + 0.0 * state.omega  # shaped like the others
