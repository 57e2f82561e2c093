"""Define the effects that act only on the tendon elongation s = r_M q_M - r_J q_J (m), not on the joint torque.

Each effect adds a length to the elongation that the tensions at both ends cause. `ends` are T3 - T1 and T4 - T2, N. An
element at the joint pulley changes the joint angle. Source: the catalogue of effects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.search import Coordinate, Scales, Value, Variant, geometric, linear, one
from tsa_ctrl.model.effects.specification import Kind, Motion, Parameter, Specification, Stage, Twins, positive
from tsa_ctrl.model.functions import Array, F, Functions

_BOTH_ANGLES = (("q_m",), ("q_j",))
_MICROMETRE = 1e-6  # m; unit of lengths in a search, so that their values are about 1 to 1000
_STEPS = 48  # times in a log at which the search for a slip starts; the fit finds times in between


def _springs(name: str, s: Scales) -> list[Variant]:
    def of(end: str) -> Variant:
        def parameters(u: Array) -> dict[str, Value]:
            return {"stiffness": 1.0 / (_MICROMETRE * max(float(u[0]), 1e-9)), "end": end}

        return Variant(name, (Coordinate("softness", 0.0, math.inf, 1e-3),), ((0.0,),), (0,), parameters, end)

    return [of("motor"), of("joint")]


@dataclass(frozen=True)
class SeriesSpring:
    """s += (T3 - T1)/(2 k) at the motor pulley, or (T4 - T2)/(2 k) at the joint: a spring that the file lacks."""

    stiffness: Annotated[float, positive("N/m")]  # k, per tendon
    end: Annotated[str, Parameter(choices=("motor", "joint"), fitted=False)] = "motor"

    specification: ClassVar = Specification(
        name="series_spring",
        stage=Stage.STRETCH,
        summary="compliance in series with the tendons: a coupling, a pulley, a spring",
        search=_springs,
        columns=_BOTH_ANGLES,
        twins=(Twins(("parameter_error",), (Motion.STIFFNESS,)),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="s ← s + (T_3 − T_1) / 2k",
    )

    def lengthens(self, functions: Functions[F], ends: tuple[F, F], joint_radius: float, state: State[F]) -> F:
        return ends[self.end == "joint"] / (2.0 * self.stiffness)


def _creeps(name: str, s: Scales) -> list[Variant]:
    def parameters(u: Array) -> dict[str, Value]:
        return {"length": _MICROMETRE * float(u[0]), "time_constant": math.exp(u[1])}

    low, high = 0.02 * s.seconds, 0.5 * s.seconds  # slower creep looks like a straight line, as does thermal drift
    coordinates = (
        Coordinate("length", -math.inf, math.inf, 1e-3),
        Coordinate("time_constant", math.log(low), math.log(high), 2e-2),
    )
    starts = tuple((0.0, math.log(v)) for v in geometric(1.2 * low, 0.8 * high, 6))
    return [Variant(name, coordinates, starts, (0,), parameters)]


@dataclass(frozen=True)
class TendonCreep:
    """s += a (1 - exp(-(t - t_0)/T)) from the log's first sample t_0 on: one tendon lengthens by creep."""

    length: Annotated[float, Parameter("m")]  # a
    time_constant: Annotated[float, positive("s")]  # T

    specification: ClassVar = Specification(
        name="tendon_creep",
        stage=Stage.STRETCH,
        summary="one tendon creeps more than the other under its load",
        search=_creeps,
        columns=_BOTH_ANGLES,
        twins=(Twins(("pulley_slip",), (Motion.LONGER,)),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="s ← s + a (1 − exp(−t/T))",
    )

    def lengthens(self, functions: Functions[F], ends: tuple[F, F], joint_radius: float, state: State[F]) -> F:
        return -self.length * functions.expm1(-(state.t - state.start) / self.time_constant)


def _slips(name: str, s: Scales) -> list[Variant]:
    def parameters(u: Array) -> dict[str, Value]:
        return {"length": _MICROMETRE * float(u[0]), "time": s.begin + float(u[1])}

    coordinates = (
        Coordinate("length", -math.inf, math.inf, 1e-3),
        Coordinate("time", 0.0, s.seconds, s.period),
    )
    starts = tuple((0.0, s.seconds * (step + 0.5) / _STEPS) for step in range(_STEPS))
    return [Variant(name, coordinates, starts, (0,), parameters)]


@dataclass(frozen=True)
class PulleySlip:
    """s += d from the time t_s on: a tendon slipped on its pulley, or the pulley on its shaft."""

    length: Annotated[float, Parameter("m")]  # d
    time: Annotated[float, Parameter("s")]  # t_s, in the log's own time

    specification: ClassVar = Specification(
        name="pulley_slip",
        stage=Stage.STRETCH,
        summary="a tendon slipped on its pulley, or a pulley on its shaft",
        search=_slips,
        columns=_BOTH_ANGLES,
        kinds=(Kind.TENDON_SHEATH,),
        equation="s ← s + d,  t ≥ t_s",
    )

    def lengthens(self, functions: Functions[F], ends: tuple[F, F], joint_radius: float, state: State[F]) -> F:
        after = functions.sign(0.5 + functions.sign(state.t - self.time))  # 1 from t_s on, -1 before
        return 0.5 * self.length * (1.0 + after)


@dataclass(frozen=True)
class JointPlay:
    """s += r_J g/2 sign(T4 - T2): backlash behind the joint pulley, closed to one side by the tension difference.

    The effect `backlash` transmits no torque after a reversal of the motion until its gap is closed. This effect
    depends on the sign of the torque and always transmits the whole torque.
    """

    gap: Annotated[float, positive("rad")]  # g

    specification: ClassVar = Specification(
        name="joint_play",
        stage=Stage.STRETCH,
        summary="backlash between the joint's pulley and the joint, visible when the torque changes its sign",
        search=linear("gap", one, 0.0),
        columns=_BOTH_ANGLES,
        twins=(Twins(("series_spring",), (Motion.SIGNS,)),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="s ← s + r_J g/2 sign(T_4 − T_2)",
    )

    def lengthens(self, functions: Functions[F], ends: tuple[F, F], joint_radius: float, state: State[F]) -> F:
        return 0.5 * joint_radius * self.gap * functions.sign(ends[1])
