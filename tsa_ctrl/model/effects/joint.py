"""Define the effects at the joint; each returns the torque f (N*m) by which it reduces tau_J. Source: the catalogue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.search import INF, Coordinate, Scales, Value, Variant, linear, wave
from tsa_ctrl.model.effects.specification import (
    Draw,
    Motion,
    Parameter,
    Specification,
    Stage,
    Twins,
    non_negative,
)
from tsa_ctrl.model.functions import Array, F, Functions

ACCELERATION_TIME = 0.010  # s, low-pass on the derivative of omega_j; slower than the loop, faster than a joint


@dataclass(frozen=True)
class ViscousFriction:
    """f = b omega."""

    coefficient: Annotated[float, non_negative("N*m*s/rad")]  # b

    specification: ClassVar = Specification(
        name="viscous_friction",
        stage=Stage.JOINT,
        summary="friction proportional to speed",
        search=linear("coefficient", lambda s: s.torque / s.speed, low=0.0),
        twins=(
            Twins(("sheath_asymmetry",), (Motion.BOTH_WAYS,)),
            Twins(("motor_side_friction", "parameter_error", "stribeck_friction"), (Motion.SPEEDS,)),
        ),
        equation="τ_J ← τ_J − b ω",
        demo={"coefficient": Draw(0.08, 0.16)},
    )

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.coefficient * state.omega


@dataclass(frozen=True)
class DirectionAsymmetricFriction:
    """f = b abs(omega)."""

    viscous_difference: Annotated[float, Parameter("N*m*s/rad")]  # b

    specification: ClassVar = Specification(
        name="direction_asymmetric_friction",
        stage=Stage.JOINT,
        summary="friction proportional to speed that differs by direction",
        search=linear("viscous_difference", lambda s: s.torque / s.speed),
        twins=(Twins(("viscous_friction", "sheath_asymmetry"), (Motion.BOTH_WAYS,)),),
        equation="τ_J ← τ_J − b |ω|",
        demo={"viscous_difference": Draw(0.08, 0.16, signed=True)},
    )

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.viscous_difference * abs(state.omega)


@dataclass(frozen=True)
class Inertia:
    """f = J domega/dt; J is the inertia of rotor and joint together."""

    inertia: Annotated[float, non_negative("kg*m^2")]  # J

    specification: ClassVar = Specification(
        name="inertia",
        stage=Stage.JOINT,
        summary="torque that accelerates an inertia",
        search=linear("inertia", lambda s: s.torque / s.acceleration, low=0.0),
        feedforward=f"compensated with an acceleration from omega_j that lags by {1e3 * ACCELERATION_TIME:g} ms",
        equation="τ_J ← τ_J − J dω/dt",
        demo={"inertia": Draw(0.015, 0.03)},
    )

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.inertia * state.acceleration


@dataclass(frozen=True)
class GravityLoad:
    """f = A sin(q + phi)."""

    amplitude: Annotated[float, non_negative("N*m")]  # A
    phase: Annotated[float, Parameter("rad")] = 0.0  # phi

    specification: ClassVar = Specification(
        name="gravity_load",
        stage=Stage.JOINT,
        summary="a weight on the joint",
        search=lambda name, s: [wave(name, "amplitude", s.torque)],
        twins=(
            Twins(("configuration_dependent_bending",), (Motion.RANGE,)),
            Twins(("inertia",), (Motion.FREQUENCIES,)),
        ),
        columns=(("q_j",),),
        equation="τ_J ← τ_J − A sin(q + φ)",
        demo={"amplitude": Draw(0.2, 0.4), "phase": Draw(-1.0, 1.0)},
    )

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.amplitude * functions.sin(state.q_j + self.phase)


def _springs(name: str, s: Scales) -> list[Variant]:
    unit = s.torque / s.reach

    def parameters(u: Array) -> dict[str, Value]:
        stiffness = float(u[0]) * unit
        rest = s.middle - float(u[1]) * s.torque / stiffness if stiffness > 1e-12 * unit else s.middle
        return {"stiffness": stiffness, "rest_angle": rest}

    if s.offset:  # another rest angle has the same effect as a constant torque
        only = Coordinate("stiffness", 0.0, INF, 1e-3)

        def centred(u: Array) -> dict[str, Value]:
            return {"stiffness": float(u[0]) * unit, "rest_angle": s.middle}

        return [Variant(name, (only,), ((0.0,),), (0,), centred, unidentifiable=("rest_angle",))]
    coordinates = (Coordinate("stiffness", 1e-6, INF, 1e-3), Coordinate("torque_at_middle", -INF, INF, 1e-3))
    return [Variant(name, coordinates, ((1e-6, 0.0),), (0, 1), parameters)]


@dataclass(frozen=True)
class JointStiffness:
    """f = k (q - q_0)."""

    stiffness: Annotated[float, non_negative("N*m/rad")]  # k
    rest_angle: Annotated[float, Parameter("rad")] = 0.0  # q_0

    specification: ClassVar = Specification(
        name="joint_stiffness",
        stage=Stage.JOINT,
        summary="a spring at the joint",
        search=_springs,
        twins=(
            Twins(("gravity_load", "configuration_dependent_bending"), (Motion.RANGE,)),
            Twins(("inertia",), (Motion.FREQUENCIES,)),
        ),
        columns=(("q_j",),),
        equation="τ_J ← τ_J − k (q − q_0)",
        demo={"stiffness": Draw(0.3, 0.6), "rest_angle": Draw(-0.3, 0.3)},
    )

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return self.stiffness * (state.q_j - self.rest_angle)


@dataclass(frozen=True)
class TorqueOffset:
    """f = -c, that is tau_J += c."""

    offset: Annotated[float, Parameter("N*m")]  # c

    specification: ClassVar = Specification(
        name="torque_offset",
        stage=Stage.JOINT,
        summary="a constant torque or a sensor offset",
        search=linear("offset", lambda s: s.torque),
        twins=(
            Twins(("direction_asymmetric_friction",), (Motion.BOTH_WAYS,)),
            Twins(("gravity_load", "joint_stiffness", "configuration_dependent_bending"), (Motion.RANGE,)),
        ),
        equation="τ_J ← τ_J + c",
        demo={"offset": Draw(0.08, 0.2, signed=True)},
    )

    def torque(self, functions: Functions[F], state: State[F]) -> F:
        return -self.offset + 0.0 * state.omega  # in the shape of the other effects
