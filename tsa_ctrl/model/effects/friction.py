"""Define the friction effects: factors on the coefficient mu of the sheath, and load-dependent friction of the joint.

Source: the catalogue of effects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.search import Coordinate, Scales, Value, Variant, geometric, linear, one
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

NOISE_TO_SPEED = 4.0  # times the velocity noise: a smaller speed scale is not resolved
LEAST_HEATING = 0.5  # K; thermometers have this accuracy


def _velocities(name: str, s: Scales) -> list[Variant]:
    lowest = max(0.02 * s.speed, NOISE_TO_SPEED * s.speed_noise)
    low, high = math.log(lowest), math.log(max(0.6 * s.speed, 1.5 * lowest))

    def parameters(u: Array) -> dict[str, Value]:
        return {"static_excess": float(u[0]), "stribeck_velocity": math.exp(u[1]), "shape": float(u[2])}

    if lowest > 0.3 * s.speed:
        return []
    coordinates = (
        Coordinate("static_excess", 0.0, 20.0, 1e-3),
        Coordinate("stribeck_velocity", low, high, 1e-2),
        Coordinate("shape", 0.5, 2.0, 1e-2),
    )
    speeds = np.log(geometric(lowest, max(0.6 * s.speed, 1.5 * lowest), 6))
    starts = tuple((0.0, float(v), shape) for v in speeds for shape in (2.0, 1.0))
    return [Variant(name, coordinates, starts, (0,), parameters)]


@dataclass(frozen=True)
class StribeckFriction:
    """mu *= 1 + k exp(-abs(omega/omega_s)^n)."""

    static_excess: Annotated[float, non_negative("1")]  # k
    stribeck_velocity: Annotated[float, positive("rad/s")]  # omega_s
    shape: Annotated[float, Parameter("1", low=0.5, high=2.0)] = 2.0  # n

    specification: ClassVar = Specification(
        name="stribeck_friction",
        stage=Stage.FRICTION,
        summary="friction decreases with speed at low speed",
        search=_velocities,
        unresolved="the velocity is too noisy to resolve slow motion",
        twins=(Twins(("velocity_lag", "motor_side_friction", "parameter_error"), (Motion.SPEEDS,)),),
        equation="μ ← μ (1 + k exp(−|ω/ω_s|^n))",
        demo={"static_excess": Draw(0.5, 0.9), "stribeck_velocity": Draw(0.25, 0.45)},
    )

    def factor(self, functions: Functions[F], state: State[F]) -> F:
        speed = functions.power(abs(state.omega) / self.stribeck_velocity, self.shape)
        return 1.0 + self.static_excess * functions.exp(-speed)


def _heated_too_little(s: Scales) -> str:
    return f"the temperature varies by only {s.heating:.2g} K" if s.heating < LEAST_HEATING else ""


@dataclass(frozen=True)
class ThermalFrictionDrift:
    """mu *= 1 + a (temperature - T_0)."""

    temperature_coefficient: Annotated[float, Parameter("1/K")]  # a
    reference_temperature: Annotated[float, Parameter("°C", fitted=False)] = 25.0  # T_0

    specification: ClassVar = Specification(
        name="thermal_friction_drift",
        stage=Stage.FRICTION,
        summary="friction changes with the temperature",
        search=linear("temperature_coefficient", lambda s: 1.0 / s.heating),
        untestable=_heated_too_little,
        twins=(Twins(("pretension_relaxation",), (Motion.WARM,)),),
        asks=Motion.WARM,
        columns=(("temperature",),),
        equation="μ ← μ (1 + a (ϑ − ϑ_0))",
    )

    def factor(self, functions: Functions[F], state: State[F]) -> F:
        return 1.0 + self.temperature_coefficient * (state.temperature - self.reference_temperature)


@dataclass(frozen=True)
class TensionDependentFriction:
    """x_i = mu Theta (max(T_i, 0.05 T_ref)/T_ref)^(-n) per tendon, with its motor-side tension T_i, N."""

    exponent: Annotated[float, non_negative("1", high=1.0)]  # n
    reference_tension: Annotated[float, positive("N", optional=True, fitted=False)]  # T_ref; default: T_p0

    specification: ClassVar = Specification(
        name="tension_dependent_friction",
        stage=Stage.TENSION,
        summary="the friction coefficient falls as tension grows",
        search=linear("exponent", one, 0.0, 1.0, full_strength=((0.4,), (0.8,))),
        twins=(Twins(("torque_constant_error",), (Motion.BENDING, Motion.GAIN)),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="x_i ← x (T_i / T_ref)^−n",
    )

    LOWEST: ClassVar[float] = 0.05  # of T_ref: keeps x finite in a slack tendon

    def factor(self, functions: Functions[F], tension: F) -> F:
        return functions.power(functions.at_least(tension / self.reference_tension, self.LOWEST), -self.exponent)

    def slope(self, tension: float, factor: float) -> float:
        """Return d factor/dT, 1/N, for the inversion."""
        if tension <= self.LOWEST * self.reference_tension:
            return 0.0
        return -self.exponent * factor / tension


@dataclass(frozen=True)
class LoadDependentFriction:
    """tau_J -= sigma k abs(tau_J), so tau_J = B/(1 + sigma k sign(B)) with the torque B (N*m) of the transmission."""

    coefficient: Annotated[float, non_negative("1", high=1.0, high_open=True)]  # k

    specification: ClassVar = Specification(
        name="load_dependent_friction",
        stage=Stage.LOAD,
        summary="friction in the joint grows with its load",
        search=linear("coefficient", one, 0.0, 0.95),
        twins=(Twins(("sheath_asymmetry", "tendon_slack", "tension_dependent_friction"), (Motion.SIGNS,)),),
        equation="τ_J ← τ_J − σ k |τ_J|",
        demo={"coefficient": Draw(0.15, 0.25)},
    )

    def apply(self, functions: Functions[F], torque: F, sigma: F) -> F:
        return torque / (1.0 + self.coefficient * sigma * functions.sign(torque))

    def invert(self, functions: Functions[F], tau_j: F, sigma: F) -> F:
        return tau_j * (1.0 + self.coefficient * sigma * functions.sign(tau_j))

    def required(self, functions: Functions[F], torque: F, sigma: F) -> F:
        """Return the input torque that a plain drive needs: the solution of tau = torque + sigma k abs(tau)."""
        return torque / (1.0 - self.coefficient * sigma * functions.sign(torque))
