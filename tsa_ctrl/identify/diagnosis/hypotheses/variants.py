"""How a fit moves through the parameters of each effect: coordinates, and starting grids of the nonlinear ones.

What an effect computes stands in the model alone. Coordinates are scaled so that 1 is an effect about as large as the
torque; an amplitude with a phase is a pair (cosine, sine), which is linear where amplitude and phase are not.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.hypotheses.base import Coordinate
from tsa_ctrl.identify.diagnosis.hypotheses.scales import Scales
from tsa_ctrl.model.catalogue import Value
from tsa_ctrl.model.functions import Array

Parameters = Callable[[Array], dict[str, Value]]
INF = math.inf

NOISE_TO_SPEED = 4.0  # a speed scale below so many times the velocity noise is not resolved
MOST_CYCLES = 40  # of torque ripple per motor turn that are looked for
FEW_SAMPLES = 1.5  # a lag or delay so short hides among the moments of unknown direction
LINES_PER_RANGE = 0.6  # turns of the ripple's phase that a log must pass through


@dataclass(frozen=True)
class Variant:
    """An effect with its discrete choices made.

    `starts`: vectors over `coordinates`; those of `amplitude` (indices) are at 0 there, where the effect vanishes, and
    its response is nearly linear in them. Without an amplitude a start is the whole effect.
    """

    effect: str
    coordinates: tuple[Coordinate, ...]
    starts: tuple[tuple[float, ...], ...]
    amplitude: tuple[int, ...]
    parameters: Parameters
    label: str = ""
    unidentifiable: tuple[str, ...] = ()  # parameters that no log of this base model tells
    full_strength: tuple[tuple[float, ...], ...] = ()  # further starts, of effects far from linear in their strength


Catalogue = Mapping[str, tuple[Variant, ...]]  # of each effect that these logs can test


def all_but(names: Sequence[str], catalogue: Catalogue) -> list[Variant]:
    """The variants of every effect but these."""
    return [variant for name, variants in catalogue.items() if name not in names for variant in variants]


def _linear(effect: str, parameter: str, unit: float, low: float = -INF, high: float = INF, **fixed: Value) -> Variant:
    """One amplitude: parameter = unit * coordinate."""

    def parameters(u: Array) -> dict[str, Value]:
        return {parameter: float(u[0]) * unit, **fixed}

    coordinate = Coordinate(parameter, low / unit, high / unit, 1e-3)
    return Variant(effect, (coordinate,), ((0.0,),), (0,), parameters, ",".join(str(v) for v in fixed.values()))


def _geometric(low: float, high: float, count: int) -> list[float]:
    return [float(v) for v in np.geomspace(low, high, count)] if high > low > 0.0 else []


def _viscous(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("viscous_friction", "coefficient", s.torque / s.speed, low=0.0)]


def _asymmetric_viscous(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("direction_asymmetric_friction", "viscous_difference", s.torque / s.speed)]


def _inertia(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("inertia", "inertia", s.torque / s.acceleration, low=0.0)]


def _offset(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("torque_offset", "offset", s.torque)]


def _gain(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("torque_constant_error", "relative_error", 1.0, -0.5, 0.5)]


def _motor_friction(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("motor_side_friction", "coulomb", s.motor_torque, low=0.0)]


def _bending(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("configuration_dependent_bending", "bending_per_joint_angle", 1.0 / s.reach)]


def _stiffening(s: Scales, frame: Frame) -> list[Variant]:
    return [_linear("stiffness_nonlinearity", "quadratic", 1000.0)]


def _thermal(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("thermal_friction_drift", "temperature_coefficient", 1.0 / s.heating)]


def _tension(s: Scales, _: Frame) -> list[Variant]:
    linear = _linear("tension_dependent_friction", "exponent", 1.0, 0.0, 1.0)
    return [dataclasses.replace(linear, full_strength=((0.4,), (0.8,)))]


def _asymmetry(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("sheath_asymmetry", "relative_difference", 1.0, -1.98, 1.98)]


def _load(s: Scales, _: Frame) -> list[Variant]:
    return [_linear("load_dependent_friction", "coefficient", 1.0, 0.0, 0.95)]


def _slack(s: Scales, _: Frame) -> list[Variant]:
    return [Variant("tendon_slack", (), ((),), (), lambda u: {})]


def _elongation(s: Scales, _: Frame) -> list[Variant]:
    def fixed(profile: str) -> Variant:
        return Variant("elongation_coupling", (), ((),), (), lambda u: {"curvature_profile": profile}, profile)

    return [fixed("uniform"), fixed("motor_end")]


def _stribeck(s: Scales, _: Frame) -> list[Variant]:
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
    speeds = np.log(_geometric(lowest, max(0.6 * s.speed, 1.5 * lowest), 6))
    starts = tuple((0.0, float(v), shape) for v in speeds for shape in (2.0, 1.0))
    return [Variant("stribeck_friction", coordinates, starts, (0,), parameters)]


def _presliding(s: Scales, frame: Frame) -> list[Variant]:
    def of(elements: int, follows: str, reach: float) -> Variant:
        def parameters(u: Array) -> dict[str, Value]:
            return {"presliding_distance": math.exp(u[0]), "elements": elements, "displacement": follows}

        low, high = 0.0002 * reach, 0.7 * reach
        coordinate = Coordinate("presliding_distance", math.log(low), math.log(high), 2e-2)
        starts = tuple((math.log(v),) for v in _geometric(3.0 * low, 0.5 * reach, 8))
        return Variant(
            "presliding_hysteresis", (coordinate,), starts, (), parameters, f"{elements} elements, {follows}"
        )

    # Where the tendons are soft a motor hardly moves while the joint's own reversal turns the friction.
    motor = [("motor", s.motor_reach)] if frame.has("q_m") else []
    return [of(n, follows, reach) for follows, reach in (*motor, ("joint", s.reach)) for n in (1, 2, 4, 8)]


def _backlash(s: Scales, _: Frame) -> list[Variant]:
    def parameters(u: Array) -> dict[str, Value]:
        return {"gap": math.exp(u[0])}

    low, high = 0.002 * s.reach, 0.5 * s.reach
    coordinate = Coordinate("gap", math.log(low), math.log(high), 4e-2)
    starts = tuple((math.log(v),) for v in _geometric(0.004 * s.reach, 0.3 * s.reach, 10))
    return [Variant("backlash", (coordinate,), starts, (), parameters)]


def _relaxation(s: Scales, _: Frame) -> list[Variant]:
    def of(law: str, low: float, high: float, most: float) -> Variant:
        def parameters(u: Array) -> dict[str, Value]:
            return {"relaxed_fraction": float(u[0]), "time_constant": math.exp(u[1]), "law": law}

        coordinates = (
            Coordinate("relaxed_fraction", 0.0, most, 1e-3),
            Coordinate("time_constant", math.log(low), math.log(high), 2e-2),
        )
        starts = tuple((0.0, math.log(v)) for v in _geometric(1.2 * low, 0.8 * high, 5))
        return Variant("pretension_relaxation", coordinates, starts, (0,), parameters, law)

    t = s.seconds
    return [of("exponential", 0.02 * t, 2.0 * t, 0.98), of("logarithmic", 0.002 * t, 0.5 * t, 0.6)]


def _delay(s: Scales, _: Frame) -> list[Variant]:
    unit = 0.01  # s
    coordinate = Coordinate("delay", 0.0, 0.2 / unit, 0.02)
    starts = tuple((v / unit,) for v in _geometric(0.003, 0.1, 8))
    full_strength = ((FEW_SAMPLES * s.period / unit,),)
    return [
        Variant(
            "transport_delay",
            (coordinate,),
            starts,
            (),
            lambda u: {"delay": float(u[0]) * unit},
            full_strength=full_strength,
        )
    ]


def _lag(s: Scales, _: Frame) -> list[Variant]:
    unit = 0.01  # s
    coordinate = Coordinate("time_constant", 0.0, 0.3 / unit, max(0.3, 1.5 * s.period / unit))
    starts = tuple((v / unit,) for v in _geometric(0.004, 0.15, 9))
    full_strength = ((FEW_SAMPLES * s.period / unit,),)
    return [
        Variant(
            "velocity_lag",
            (coordinate,),
            starts,
            (),
            lambda u: {"time_constant": float(u[0]) * unit},
            full_strength=full_strength,
        )
    ]


def _gravity(s: Scales, _: Frame) -> list[Variant]:
    def parameters(u: Array) -> dict[str, Value]:
        amplitude = math.hypot(u[0], u[1]) * s.torque
        return {"amplitude": amplitude, "phase": math.atan2(u[1], u[0]) if amplitude else 0.0}

    coordinates = (Coordinate("cosine", -INF, INF, 1e-3), Coordinate("sine", -INF, INF, 1e-3))
    return [Variant("gravity_load", coordinates, ((0.0, 0.0),), (0, 1), parameters)]


def _spring(s: Scales, frame: Frame) -> list[Variant]:
    unit = s.torque / s.reach
    middle = float(np.mean(frame.column("q_j"))) if frame.has("q_j") else 0.0

    def parameters(u: Array) -> dict[str, Value]:
        stiffness = float(u[0]) * unit
        rest = middle - float(u[1]) * s.torque / stiffness if stiffness > 1e-12 * unit else middle
        return {"stiffness": stiffness, "rest_angle": rest}

    if s.offset:  # where the spring rests is the same as a constant torque
        only = Coordinate("stiffness", 0.0, INF, 1e-3)

        def centred(u: Array) -> dict[str, Value]:
            return {"stiffness": float(u[0]) * unit, "rest_angle": middle}

        return [Variant("joint_stiffness", (only,), ((0.0,),), (0,), centred, unidentifiable=("rest_angle",))]
    coordinates = (Coordinate("stiffness", 1e-6, INF, 1e-3), Coordinate("torque_at_middle", -INF, INF, 1e-3))
    return [Variant("joint_stiffness", coordinates, ((1e-6, 0.0),), (0, 1), parameters)]


def _ripple(s: Scales, frame: Frame) -> list[Variant]:
    if not frame.has("q_m"):
        return []
    fastest = float(
        np.quantile(
            np.abs(np.concatenate([np.diff(r.signals.q_m) for r in frame.runs if r.signals.q_m is not None])), 0.9
        )
    )

    def of(cycles: int) -> Variant:
        def parameters(u: Array) -> dict[str, Value]:
            amplitude = math.hypot(u[0], u[1]) * s.motor_torque
            phase = math.atan2(u[1], u[0]) if amplitude else 0.0
            return {"amplitude": amplitude, "cycles_per_revolution": cycles, "phase": phase}

        coordinates = (Coordinate("cosine", -INF, INF, 1e-3), Coordinate("sine", -INF, INF, 1e-3))
        return Variant("torque_ripple", coordinates, ((0.0, 0.0),), (0, 1), parameters, f"{cycles} cycles")

    turns = s.motor_reach / math.pi
    first = 2 if s.plain else 1  # one cycle per turn of a plain drive's shaft is a weight on it
    return [of(n) for n in range(first, MOST_CYCLES + 1) if n * turns > LINES_PER_RANGE and n * fastest < 0.6 * math.pi]


BUILDERS: Mapping[str, Callable[[Scales, Frame], Sequence[Variant]]] = {  # variants on logs of these scales
    "velocity_lag": _lag,
    "torque_constant_error": _gain,
    "torque_ripple": _ripple,
    "motor_side_friction": _motor_friction,
    "configuration_dependent_bending": _bending,
    "stiffness_nonlinearity": _stiffening,
    "pretension_relaxation": _relaxation,
    "stribeck_friction": _stribeck,
    "thermal_friction_drift": _thermal,
    "tension_dependent_friction": _tension,
    "presliding_hysteresis": _presliding,
    "sheath_asymmetry": _asymmetry,
    "tendon_slack": _slack,
    "elongation_coupling": _elongation,
    "load_dependent_friction": _load,
    "backlash": _backlash,
    "viscous_friction": _viscous,
    "direction_asymmetric_friction": _asymmetric_viscous,
    "inertia": _inertia,
    "gravity_load": _gravity,
    "joint_stiffness": _spring,
    "torque_offset": _offset,
    "transport_delay": _delay,
}
