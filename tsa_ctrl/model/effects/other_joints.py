"""Define the effects of other joints on the wrap angle Theta (rad) and on the pretension T_p (N) of a sheath.

Source: the catalogue of effects. Their parameters are named after the joints, as the columns q_j.NAME of a log.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.search import Coordinate, Scales, Search, Value, Variant
from tsa_ctrl.model.effects.specification import Kind, Motion, Parameter, Specification, Stage, Twins
from tsa_ctrl.model.functions import Array, F, Functions
from tsa_ctrl.model.routing import MOST_GAIN

PULL = 10.0  # N, unit of a change of the pretension in a fit, which is linear in it


def _by_joint(scale: float = 1.0, most: float = math.inf) -> Search:
    """Return the search for one coefficient of each other joint, at most `most` either way.

    A coordinate is `scale` at the largest angle of the joint.
    """

    def variants(name: str, s: Scales) -> list[Variant]:
        def parameters(u: Array) -> dict[str, Value]:
            units = {joint: scale / reach for joint, reach in s.joints.items()}
            return {joint: float(value) * unit for (joint, unit), value in zip(units.items(), u, strict=True)}

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
