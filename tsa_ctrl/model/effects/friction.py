"""Friction in the sheath and in the joint: factors on the coefficient mu, and what the joint takes of its load.

Source: the catalogue of effects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from tsa_ctrl.model.effects.specification import (
    Draw,
    Parameter,
    Shown,
    Specification,
    Stage,
    non_negative,
    positive,
)
from tsa_ctrl.model.effects.state import State
from tsa_ctrl.model.functions import F, Functions


@dataclass(frozen=True)
class StribeckFriction:
    """mu *= 1 + k exp(-abs(omega/omega_s)^n)."""

    static_excess: Annotated[float, non_negative("1")]  # k
    stribeck_velocity: Annotated[float, positive("rad/s")]  # omega_s
    shape: Annotated[float, Parameter("1", low=0.5, high=2.0)] = 2.0  # n

    specification: ClassVar = Specification(
        name="stribeck_friction",
        stage=Stage.FRICTION,
        summary="friction falls with speed at low speed",
        shown=Shown(
            {"static_excess": 0.3, "stribeck_velocity": 0.25}, "speed", "μ ← μ (1 + k exp(−|ω/ω_s|^n))", short=True
        ),
        demo={"static_excess": Draw(0.5, 0.9), "stribeck_velocity": Draw(0.25, 0.45)},
    )

    def factor(self, functions: Functions[F], state: State[F]) -> F:
        speed = functions.power(abs(state.omega) / self.stribeck_velocity, self.shape)
        return 1.0 + self.static_excess * functions.exp(-speed)


@dataclass(frozen=True)
class ThermalFrictionDrift:
    """mu *= 1 + a (temperature - T_0)."""

    temperature_coefficient: Annotated[float, Parameter("1/K")]  # a
    reference_temperature: Annotated[float, Parameter("°C", fitted=False)] = 25.0  # T_0

    specification: ClassVar = Specification(
        name="thermal_friction_drift",
        stage=Stage.FRICTION,
        summary="friction follows the temperature",
        columns=(("temperature",),),
        shown=Shown({"temperature_coefficient": 0.01}, "temperature", "μ ← μ (1 + a (ϑ − ϑ_0))"),
    )

    def factor(self, functions: Functions[F], state: State[F]) -> F:
        return 1.0 + self.temperature_coefficient * (state.temperature - self.reference_temperature)


@dataclass(frozen=True)
class TensionDependentFriction:
    """x_i = mu Theta (max(T_i, 0.05 T_ref)/T_ref)^(-n) per tendon, T_i its motor-side tension, N."""

    exponent: Annotated[float, non_negative("1", high=1.0)]  # n
    reference_tension: Annotated[float, positive("N", optional=True, fitted=False)]  # T_ref; the model's pretension

    specification: ClassVar = Specification(
        name="tension_dependent_friction",
        stage=Stage.TENSION,
        summary="the friction coefficient falls as tension grows",
        rigid_drive=False,
        shown=Shown({"exponent": 0.2}, "load", "x_i ← x (T_i / T_ref)^−n"),
    )

    LOWEST: ClassVar[float] = 0.05  # of T_ref: keeps x finite in a slack tendon

    def factor(self, functions: Functions[F], tension: F) -> F:
        return functions.power(functions.at_least(tension / self.reference_tension, self.LOWEST), -self.exponent)

    def slope(self, tension: float, factor: float) -> float:
        """d factor/dT, 1/N, for the inversion."""
        if tension <= self.LOWEST * self.reference_tension:
            return 0.0
        return -self.exponent * factor / tension


@dataclass(frozen=True)
class LoadDependentFriction:
    """tau_J -= sigma k abs(tau_J), that is tau_J = B/(1 + sigma k sign(B)), B the torque (N*m) of the transmission."""

    coefficient: Annotated[float, non_negative("1", high=1.0, high_open=True)]  # k

    specification: ClassVar = Specification(
        name="load_dependent_friction",
        stage=Stage.LOAD,
        summary="friction in the joint grows with its load",
        shown=Shown({"coefficient": 0.06}, "load", "τ_J ← τ_J − σ k |τ_J|"),
        demo={"coefficient": Draw(0.15, 0.25)},
    )

    def apply(self, functions: Functions[F], torque: F, sigma: F) -> F:
        return torque / (1.0 + self.coefficient * sigma * functions.sign(torque))

    def invert(self, functions: Functions[F], tau_j: F, sigma: F) -> F:
        return tau_j * (1.0 + self.coefficient * sigma * functions.sign(tau_j))

    def required(self, functions: Functions[F], torque: F, sigma: F) -> F:
        """The input torque that a plain drive needs: tau = torque + sigma k abs(tau)."""
        return torque / (1.0 - self.coefficient * sigma * functions.sign(torque))
