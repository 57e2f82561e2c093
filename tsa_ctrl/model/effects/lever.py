"""Model the lever arm of the tendons at the joint, which changes with the angle if the pulley is eccentric.

The centre of an eccentric pulley moves around the axis, so the lever arm is r_J(q) = r_J (1 + e sin(q_J + phi)). One
tendon leaves the pulley farther from the axis than on average, and the other one closer to it. Half a turn later, the
opposite is true. The wound length changes accordingly, which is visible in the elongation r_M q_M - r_J q_J.

Source: Shigley's eccentric cam, small e; catalogue of effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Generic

from tsa_ctrl.model.effects.search import wave
from tsa_ctrl.model.effects.specification import (
    Draw,
    Kind,
    Motion,
    Parameter,
    Specification,
    Stage,
    Twins,
    non_negative,
)
from tsa_ctrl.model.functions import F, Functions


@dataclass(slots=True)
class State(Generic[F]):
    """Hold the inputs of an effect in SI units, at one instant (floats) or over a log (arrays); nan if not measured.

    For a plain drive without a transmission, q_j, omega and acceleration are measured at the motor.
    """

    t: F  # s
    omega: F  # rad/s, the joint's true velocity
    acceleration: F  # rad/s^2
    q_j: F  # rad
    q_m: F  # rad
    temperature: F  # °C
    theta: F  # rad, bending angle before any effect
    sigma: F  # 1, direction: sign of omega, or the friction state z in [-1, 1]
    start: float  # s, the log's first sample
    joints: Mapping[str, F] = field(default_factory=dict)  # rad, of joints that may bend the sheath, by name
    theta_difference: F | None = None  # rad, half of Theta_a - Theta_b; None if both tendons have the same routing


def unmoved(theta: float) -> State[float]:
    """Return the state at the bending angle `theta` (rad) before any measurement."""
    nan = math.nan
    return State(
        t=0.0, omega=0.0, acceleration=0.0, q_j=nan, q_m=nan, temperature=nan, theta=theta, sigma=0.0, start=0.0
    )


MOST = 0.5  # 1, e at which the longest lever is three times the shortest; a larger value is an error of the file
_SIDE = 0.35  # 1, half side of the square of cosine and sine inside that circle, with room for finite differences


@dataclass(frozen=True)
class PulleyEccentricity:
    """tau_J *= 1 + e sin(q_J + phi)."""

    relative_eccentricity: Annotated[float, non_negative("1", high=MOST)]  # e
    phase: Annotated[float, Parameter("rad")] = 0.0  # phi

    specification: ClassVar = Specification(
        name="pulley_eccentricity",
        stage=Stage.LEVER,
        summary="the lever arm at the joint changes with its angle: an eccentric pulley",
        search=lambda name, _: [wave(name, "relative_eccentricity", 1.0, _SIDE)],
        twins=(
            Twins(("torque_constant_error", "parameter_error", "configuration_dependent_bending"), (Motion.RANGE,)),
            Twins(("gravity_load", "joint_stiffness"), (Motion.SIGNS,)),
        ),
        columns=(("q_j",),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="τ_J ← τ_J (1 + e sin(q + φ))",
        demo={"relative_eccentricity": Draw(0.2, 0.3), "phase": Draw(-1.0, 1.0)},
    )

    def arm(self, functions: Functions[F], q_j: F) -> F:
        """Return the lever arm over the radius of the file, 1."""
        return 1.0 + self.relative_eccentricity * functions.sin(q_j + self.phase)

    def apply(self, functions: Functions[F], torque: F, state: State[F]) -> F:
        return torque * self.arm(functions, state.q_j)

    def invert(self, functions: Functions[F], tau_j: F, state: State[F]) -> F:
        return tau_j / self.arm(functions, state.q_j)

    def lengthens(self, functions: Functions[F], joint_radius: float, state: State[F]) -> F:
        """Return the wound length in addition to r_J q_J, m: the integral of the change of the arm."""
        return -joint_radius * self.relative_eccentricity * functions.sin(state.q_j + self.phase + 0.5 * math.pi)
