"""Define the effects on the bending angle Theta (rad) and on the pretension T_p (N), in the order of composition.

The parameters of the effects of other joints are named after the joints, as the columns q_j.NAME of a log. After each
effect, the composition limits T_p to 0 or more, because a tendon cannot push. Source: the catalogue of effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.search import Coordinate, Scales, Search, Value, Variant, geometric, linear
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
from tsa_ctrl.model.routing import MOST_GAIN

PULL = 10.0  # N, unit of a change of the pretension in a fit, which is linear in it
LEAST_BENDING = 0.01  # of the bending angle: a path length that varies less does not show the stiffness


@dataclass(frozen=True)
class ConfigurationDependentBending:
    """Theta += k q; the path length and with it T_p follow by (3.50), (3.56): T_p += k_t (p + d/2) k q."""

    bending_per_joint_angle: Annotated[float, Parameter("rad/rad")]  # k

    specification: ClassVar = Specification(
        name="configuration_dependent_bending",
        stage=Stage.BENDING,
        summary="the wrap angle changes with the joint angle",
        search=linear("bending_per_joint_angle", lambda s: 1.0 / s.reach),
        columns=(("q_j",),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="Θ ← Θ + k q",
        demo={"bending_per_joint_angle": Draw(1.0, 1.6, signed=True)},
    )

    def bending(self, theta: F, state: State[F]) -> F:
        return theta + self.bending_per_joint_angle * state.q_j


def _bent_alike(s: Scales) -> str:
    return "" if s.bending > LEAST_BENDING else "the path length does not vary (no column theta that changes)"


@dataclass(frozen=True)
class StiffnessNonlinearity:
    """T_p = T_p0 (1 + k T_p0/EA): the tendon stiffens with tension."""

    quadratic: Annotated[float, Parameter("1")]  # k

    specification: ClassVar = Specification(
        name="stiffness_nonlinearity",
        stage=Stage.PRETENSION,
        summary="the tendon stiffens with tension",
        search=linear("quadratic", lambda s: 1000.0),  # T_p/EA is about a thousandth
        untestable=_bent_alike,
        twins=(Twins(("motor_side_friction", "parameter_error"), (Motion.BENDING,)),),
        asks=Motion.BENDING,
        kinds=(Kind.TENDON_SHEATH,),
        equation="T_p ← T_p (1 + k T_p / EA)",
    )

    def pretension(self, functions: Functions[F], pretension: F, state: State[F], axial_stiffness: float) -> F:
        return pretension * (1.0 + self.quadratic / axial_stiffness * pretension)


def _relaxations(name: str, s: Scales) -> list[Variant]:
    def of(law: str, low: float, high: float, most: float) -> Variant:
        def parameters(u: Array) -> dict[str, Value]:
            return {"relaxed_fraction": float(u[0]), "time_constant": math.exp(u[1]), "law": law}

        coordinates = (
            Coordinate("relaxed_fraction", 0.0, most, 1e-3),
            Coordinate("time_constant", math.log(low), math.log(high), 2e-2),
        )
        starts = tuple((0.0, math.log(v)) for v in geometric(1.2 * low, 0.8 * high, 5))
        return Variant(name, coordinates, starts, (0,), parameters, law)

    t = s.seconds
    return [of("exponential", 0.02 * t, 2.0 * t, 0.98), of("logarithmic", 0.002 * t, 0.5 * t, 0.6)]


@dataclass(frozen=True)
class PretensionRelaxation:
    """T_p *= 1 - c (1 - exp(-(t - t_0)/T)), or 1 - c log10(1 + (t - t_0)/T); no change before t_0."""

    relaxed_fraction: Annotated[float, non_negative("1", high=1.0, high_open=True)]  # c
    time_constant: Annotated[float, positive("s")]  # T
    law: Annotated[str, Parameter(choices=("exponential", "logarithmic"), fitted=False)] = "exponential"
    start_time: Annotated[float | None, Parameter("s", optional=True, fitted=False)] = None  # t_0; default: log start

    specification: ClassVar = Specification(
        name="pretension_relaxation",
        stage=Stage.PRETENSION,
        summary="the pretension relaxes with time",
        search=_relaxations,
        twins=(Twins(("motor_side_friction", "stiffness_nonlinearity", "parameter_error"), (Motion.BENDING,)),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="T_p ← T_p (1 − c (1 − exp(−t/T)))",
    )

    def pretension(self, functions: Functions[F], pretension: F, state: State[F], axial_stiffness: float) -> F:
        return pretension * self.factor(functions, state)

    def factor(self, functions: Functions[F], state: State[F]) -> F:
        start = state.start if self.start_time is None else self.start_time
        elapsed = functions.at_least((state.t - start) / self.time_constant, 0.0)
        if self.law == "logarithmic":
            return 1.0 - self.relaxed_fraction * functions.log10(1.0 + elapsed)
        return 1.0 + self.relaxed_fraction * functions.expm1(-elapsed)


def _by_joint(scale: float = 1.0, most: float = math.inf) -> Search:
    """Return the search for one coefficient of each other joint, at most `most` either way.

    A coordinate is `scale` at the largest angle of the joint.
    """

    def variants(name: str, s: Scales) -> list[Variant]:
        def parameters(u: Array) -> dict[str, Value]:
            found = {joint: float(v) * scale / reach for (joint, reach), v in zip(s.joints.items(), u, strict=True)}
            return {joint: min(max(value, -most), most) for joint, value in found.items()}  # rounding may exceed it

        ends = {joint: most * reach / scale for joint, reach in s.joints.items()}
        coordinates = [Coordinate(joint, -end, end, 1e-3) for joint, end in ends.items()]
        zero = (0.0,) * len(coordinates)
        return [Variant(name, tuple(coordinates), (zero,), tuple(range(len(coordinates))), parameters)]

    return variants


def _no_other_joint(s: Scales) -> str:
    return "" if s.joints else "no column q_j.NAME of another joint that moves"


def _angles(joints: Mapping[str, object]) -> tuple[tuple[str, ...], ...]:
    return tuple((f"q_j.{joint}",) for joint in joints)


@dataclass(frozen=True)
class RoutingByJoint:
    """Theta += sum of g_j q_j over other joints, beyond [routing]; path length and T_p follow by (3.50), (3.56).

    In a model file with this effect, the gains are added to those of [routing] when the file is read.
    """

    constants: tuple[tuple[str, float], ...] = ()  # g_j by joint, rad/rad

    specification: ClassVar = Specification(
        name="routing_by_joint",
        stage=Stage.BENDING,
        summary="another joint changes the wrap angle, but not as [routing] states",
        search=_by_joint(most=MOST_GAIN),
        constants=Parameter("rad/rad", low=-MOST_GAIN, high=MOST_GAIN),
        untestable=_no_other_joint,
        live_columns=_angles,
        twins=(Twins(("configuration_dependent_bending", "parameter_error"), (Motion.JOINTS,)),),
        asks=Motion.JOINTS,
        companion="pretension_per_joint_angle",
        kinds=(Kind.TENDON_SHEATH,),
        equation="Θ ← Θ + Σ g_j q_j",
    )

    def bending(self, theta: F, state: State[F]) -> F:
        for joint, gain in self.constants:
            theta = theta + gain * state.joints[joint]
        return theta


@dataclass(frozen=True)
class PretensionPerJointAngle:
    """T_p += sum of c_j q_j over other joints, beyond (3.52): the path length follows another law."""

    constants: tuple[tuple[str, float], ...] = ()  # c_j by joint, N/rad

    specification: ClassVar = Specification(
        name="pretension_per_joint_angle",
        stage=Stage.PRETENSION,
        summary="another joint changes the pretension otherwise than by the path length (3.52)",
        search=_by_joint(scale=PULL),
        constants=Parameter("N/rad"),
        untestable=_no_other_joint,
        live_columns=_angles,
        twins=(
            Twins(("routing_by_joint",), (Motion.SIGNS, Motion.JOINTS)),
            Twins(("configuration_dependent_bending", "parameter_error"), (Motion.JOINTS,)),
        ),
        asks=Motion.JOINTS,
        kinds=(Kind.TENDON_SHEATH,),
        equation="T_p ← T_p + Σ c_j q_j",
    )

    def pretension(self, functions: Functions[F], pretension: F, state: State[F], axial_stiffness: float) -> F:
        for joint, coefficient in self.constants:
            pretension = pretension + coefficient * state.joints[joint]
        return pretension
