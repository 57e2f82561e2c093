"""Effects on the friction coefficient mu: each gives the factor by which it is multiplied. Source: the catalogue."""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.model.effects.state import State
from tsa_ctrl.model.functions import F, Functions


@dataclass(frozen=True)
class StribeckFriction:
    """mu *= 1 + k exp(-abs(omega/omega_s)^n)."""

    static_excess: float  # k, 1
    stribeck_velocity: float  # omega_s, rad/s
    shape: float = 2.0  # n, 1

    def factor(self, functions: Functions[F], state: State[F]) -> F:
        speed = functions.power(abs(state.omega) / self.stribeck_velocity, self.shape)
        return 1.0 + self.static_excess * functions.exp(-speed)


@dataclass(frozen=True)
class ThermalFrictionDrift:
    """mu *= 1 + a (temperature - T_0)."""

    temperature_coefficient: float  # a, 1/K
    reference_temperature: float = 25.0  # T_0, °C

    def factor(self, functions: Functions[F], state: State[F]) -> F:
        return 1.0 + self.temperature_coefficient * (state.temperature - self.reference_temperature)


@dataclass(frozen=True)
class TensionDependentFriction:
    """x_i = mu Theta (max(T_i, 0.05 T_ref)/T_ref)^(-n) per tendon, T_i its motor-side tension, N."""

    exponent: float  # n, 1
    reference_tension: float  # T_ref, N

    LOWEST = 0.05  # of T_ref: keeps x finite in a slack tendon

    def factor(self, functions: Functions[F], tension: F) -> F:
        return functions.power(functions.at_least(tension / self.reference_tension, self.LOWEST), -self.exponent)

    def slope(self, tension: float, factor: float) -> float:
        """d factor/dT, 1/N, for the inversion."""
        if tension <= self.LOWEST * self.reference_tension:
            return 0.0
        return -self.exponent * factor / tension
