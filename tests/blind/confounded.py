"""Cases in which no diagnosis can identify a single cause, each with an experiment that separates the effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .bench import Bench, Recipe, draw_bench
from .cases import NEEDS, Case, finish, generator, in_domain
from .rig import log_uniform
from .rivals import is_unique
from .size import size
from .strength import Strength, draw_strength, solve

ONE_SPEED: dict[str, Any] = {
    "motion": "triangle",
    "amplitude": 1.3,
    "velocity": "tachometer",
    "rounding": 1e-9,
    "runs": 1,
}
ONE_WAY: dict[str, Any] = {"motion": "one_way", "velocity": "tachometer", "runs": 1}


@dataclass(frozen=True)
class Row:
    """One row of indistinguishable effects: the hidden effect (`truth`), the group (`twins`) and the kind of log."""

    truth: str
    twins: tuple[str, ...]
    recipe: dict[str, Any]
    absorbed: bool = False  # recalibration compensates it, so no cause has to be found
    exact: bool = True
    # additional excitation for the experiment; None if there is no experiment
    parted_by: dict[str, Any] | None = None
    ratio: tuple[float, float] = (1.3, 4.0)
    draw: Callable[[np.random.Generator, Bench, float], dict[str, Any] | None] | None = None


def _like_elongation(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    """Return the gain error that results in the same slope as a sheath with even curvature."""
    rig = bench.rig
    spring = rig.axial_stiffness / rig.series_stiffness / rig.length if rig.series_stiffness else 0.0
    x = rig.x
    grown, shrunk = np.expm1(x) / x + spring, -np.expm1(-x) / x + spring
    slope = (grown * np.exp(-x) + shrunk * np.exp(x)) / (grown + shrunk)
    return {"relative_error": float(slope / np.cosh(x) - 1.0)}


def _positive_direction(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    """Return the difference by direction that viscous friction imitates.

    Its sign follows the single direction of motion.
    """
    sign = float(np.sign(np.mean(bench.runs[0].scene.omega)))
    strength = Strength("", {}, "viscous_difference", 0.05 * sign * bench.scale / bench.speed, sign * bench.scale)
    return _sized("direction_asymmetric_friction", strength, bench, wanted)


def _opposite_asymmetry(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    """Return the sheath asymmetry that load-dependent friction imitates. Its sign reduces the torque."""
    sign = -float(np.sign(np.mean(np.concatenate(bench.ideal({})))))
    strength = Strength("", {}, "relative_difference", 0.1 * sign, 0.06 * sign / (0.5 * bench.rig.x))
    return _sized("sheath_asymmetry", strength, bench, wanted)


def _weak_load_friction(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    """Return a weak friction. The two effects differ only in its second order, which the noise hides."""
    return _sized("load_dependent_friction", Strength("", {}, "coefficient", 0.02, 0.05), bench, wanted)


def _steep_weight(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    strength = Strength("", {"phase": rng.uniform(-0.1, 0.1)}, "amplitude", 0.2 * bench.scale, 20.0 * bench.scale)
    return _sized("gravity_load", strength, bench, wanted)


def _soft_spring(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    scale = bench.scale / bench.reach
    strength = Strength("", {"rest_angle": rng.uniform(-0.03, 0.03)}, "stiffness", 0.1 * scale, 20.0 * scale)
    return _sized("joint_stiffness", strength, bench, wanted)


def _hanging_weight(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    phase = float(rng.choice([-1.0, 1.0])) * (0.5 * np.pi + rng.uniform(-0.15, 0.15))
    return _sized(
        "gravity_load", Strength("", {"phase": phase}, "amplitude", 0.1 * bench.scale, bench.scale), bench, wanted
    )


def _within_recalibration(name: str, key: str) -> Callable[[np.random.Generator, Bench, float], dict[str, Any] | None]:
    """Return a function that draws an effect that is weak enough for a complete compensation by recalibration."""

    def draw(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any] | None:
        strength = draw_strength(rng, name, bench)
        for share in (1.0, 0.5, 0.25, 0.12, 0.06):
            parameters = {**strength.parameters, key: share * strength.start}
            if size(bench, {name: parameters}) < 0.1 * wanted:
                return parameters
        return None

    return draw


def _cooling_warmth(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    """Return friction that falls while the rig warms up, like the friction of a relaxing pretension."""
    strength = Strength("", {}, "temperature_coefficient", -0.005, -0.03)
    return _sized("thermal_friction_drift", strength, bench, wanted)


def _relaxation_like_warmth(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    """Return a relaxation with the time constant of the unrecorded warm-up."""
    scene = bench.runs[0].scene
    rises = np.diff(scene.temperature[:1001:500])  # for an exponential, their ratio is exp(interval / T)
    time_constant = float((scene.t[500] - scene.t[0]) / np.log(rises[0] / rises[1]))
    strength = Strength("", {"time_constant": time_constant, "law": "exponential"}, "relaxed_fraction", 0.1, 0.5)
    return _sized("pretension_relaxation", strength, bench, wanted)


def _lag_of_samples(rng: np.random.Generator, bench: Bench, wanted: float) -> dict[str, Any]:
    return {"delay": rng.uniform(1.0, 2.0) / bench.runs[0].rate}


def _sized(name: str, strength: Strength, bench: Bench, wanted: float) -> dict[str, Any]:
    return solve(strength, wanted, lambda parameters: size(bench, {name: parameters}))[0]


_STILL = {"motion": "multisine", "amplitude": 0.02, "speed": 0.1, "joint_angle": True, "torque": "independent"}
_SMALL = {"motion": "multisine", "amplitude": 0.06, "speed": 0.3, "joint_angle": True, "torque": "independent"}
_ONE_LOAD = {"torque": "one_load", "x": (0.12, 0.2), "level": (0.75, 0.9), "joint_angle": False, "motor_angle": False}
_WARM = {"temperature": "warm_up", "x": (0.12, 0.18), "level": (0.2, 0.35), "blind": True, "runs": 1}

ROWS: dict[str, Row] = {
    "motor_friction_or_parameters": Row(
        "motor_side_friction",
        ("motor_side_friction", "parameter_error"),
        {},
        absorbed=True,
        parted_by={"bending": "varied"},
        draw=_within_recalibration("motor_side_friction", "coulomb"),
    ),
    "stiffening_or_parameters": Row(
        "stiffness_nonlinearity",
        ("stiffness_nonlinearity", "parameter_error"),
        {},
        absorbed=True,
        parted_by={"bending": "varied"},
        draw=_within_recalibration("stiffness_nonlinearity", "quadratic"),
    ),
    "gain_or_parameters": Row(
        "torque_constant_error",
        ("torque_constant_error", "parameter_error"),
        {"x": (0.35, 0.9)},
        absorbed=True,
        draw=_within_recalibration("torque_constant_error", "relative_error"),
    ),
    "elongation_or_gain": Row(
        "elongation_coupling",
        ("elongation_coupling", "torque_constant_error"),
        {"x": (0.45, 0.9), "torque": "independent"},
        parted_by={"bending": "varied"},
    ),
    "gain_or_elongation": Row(
        "torque_constant_error",
        ("torque_constant_error", "elongation_coupling"),
        {"x": (0.45, 0.9), "torque": "independent"},
        parted_by={"bending": "varied"},
        draw=_like_elongation,
    ),
    "weight_or_spring": Row(
        "gravity_load", ("gravity_load", "joint_stiffness"), _SMALL, parted_by={"amplitude": 1.5}, draw=_steep_weight
    ),
    "spring_or_weight": Row(
        "joint_stiffness", ("joint_stiffness", "gravity_load"), _SMALL, parted_by={"amplitude": 1.5}, draw=_soft_spring
    ),
    "offset_or_weight": Row(
        "torque_offset", ("torque_offset", "gravity_load"), _STILL, parted_by={"amplitude": 1.5, "joint_angle": True}
    ),
    "weight_or_offset": Row(
        "gravity_load", ("gravity_load", "torque_offset"), _STILL, parted_by={"amplitude": 1.5}, draw=_hanging_weight
    ),
    "viscous_or_direction": Row(
        "viscous_friction",
        ("viscous_friction", "direction_asymmetric_friction"),
        {**ONE_WAY, "joint_angle": False, "motor_angle": False},
        parted_by={},
    ),
    "direction_or_viscous": Row(
        "direction_asymmetric_friction",
        ("direction_asymmetric_friction", "viscous_friction"),
        {**ONE_WAY, "joint_angle": False, "motor_angle": False},
        parted_by={},
        draw=_positive_direction,
    ),
    "direction_or_offset": Row(
        "direction_asymmetric_friction",
        ("direction_asymmetric_friction", "torque_offset"),
        {**ONE_SPEED, "joint_angle": False, "motor_angle": False},
        parted_by={},
    ),
    "offset_or_direction": Row(
        "torque_offset",
        ("torque_offset", "direction_asymmetric_friction"),
        {**ONE_SPEED, "joint_angle": False, "motor_angle": False},
        parted_by={},
    ),
    "viscous_or_motor_friction": Row(
        "viscous_friction",
        ("viscous_friction", "motor_side_friction"),
        {**ONE_SPEED, "joint_angle": False, "motor_angle": False},
        parted_by={},
    ),
    "load_or_asymmetry": Row(
        "load_dependent_friction",
        ("load_dependent_friction", "sheath_asymmetry"),
        _ONE_LOAD,
        parted_by={},
        ratio=(1.3, 2.2),
        draw=_weak_load_friction,
    ),
    "asymmetry_or_load": Row(
        "sheath_asymmetry",
        ("sheath_asymmetry", "load_dependent_friction"),
        _ONE_LOAD,
        parted_by={"x": (0.12, 0.9)},
        ratio=(1.3, 2.2),
        draw=_opposite_asymmetry,
    ),
    "relaxation_or_warmth": Row(
        "pretension_relaxation",
        ("pretension_relaxation", "thermal_friction_drift"),
        _WARM,
        parted_by={"temperature": "cycle"},
        ratio=(1.3, 2.5),
        draw=_relaxation_like_warmth,
    ),
    "warmth_or_relaxation": Row(
        "thermal_friction_drift",
        ("thermal_friction_drift", "pretension_relaxation"),
        _WARM,
        parted_by={"temperature": "cycle"},
        ratio=(1.3, 2.5),
        draw=_cooling_warmth,
    ),
    "late_at_one_speed": Row(
        "transport_delay",
        ("transport_delay", "presliding_hysteresis", "velocity_lag", "backlash"),
        {"motion": "sine", "rate": 200, "torque": "levels", "joint_angle": True, "runs": 1},
        exact=False,
        parted_by={"rate": 500},
        draw=_lag_of_samples,
    ),
}


def confounded_case(name: str, seed: int, short: bool = False) -> Case:
    """Return a case with one row of indistinguishable effects, and the experiment that separates them."""
    row = ROWS[name]
    for attempt in range(200):
        rng = generator("confounded", name, seed, attempt)
        found = drawn(rng, row, short)
        if found is None:
            continue
        bench, effects, noise = found
        case = finish(rng, "confounded", name, seed, bench, effects, noise, row.recipe.get("motion", "rich"))
        case.truth.twins, case.truth.exact = row.twins, row.exact
        if row.parted_by is None:
            return case
        recipe = Recipe(**{**NEEDS.get(row.truth, {}), **row.parted_by}, bare=True, short=short)
        other = draw_bench(rng, recipe, like=bench)
        reached = size(other, effects)
        if reached < 1e-3 * other.scale or not in_domain(other, effects):
            continue
        if not is_unique(other, effects, min(noise, reached / 1.5)):  # the experiment must separate the effects
            continue
        case.experiment = finish(
            rng, "experiment", name, seed, other, effects, min(noise, reached / 1.5), "parts " + " and ".join(row.twins)
        )
        case.experiment.model = case.model
        return case
    raise RuntimeError(f"no case of {name} for seed {seed}")


def drawn(rng: np.random.Generator, row: Row, short: bool) -> tuple[Bench, dict[str, dict[str, Any]], float] | None:
    """Return a bench, the hidden effect of a row, and the torque noise (N*m).

    Return None if this random trial has no valid case.
    """
    bench = draw_bench(rng, Recipe(**row.recipe, bare=True, short=short, sign_noise=0.5))
    ratio = log_uniform(rng, *row.ratio)
    noise = bench.reading * log_uniform(rng, 0.005, 0.02)
    parameters = _parameters(rng, row, bench, noise * (1.0 if row.absorbed else ratio))
    if parameters is None:
        return None
    effects = {row.truth: parameters}
    reached = size(bench, effects)
    if not row.absorbed:
        noise = reached / ratio
    if not 1.5e-3 * bench.reading < noise < 0.08 * bench.reading or not in_domain(bench, effects):
        return None
    return bench, effects, noise


def _parameters(rng: np.random.Generator, row: Row, bench: Bench, wanted: float) -> dict[str, Any] | None:
    if row.draw is not None:
        return row.draw(rng, bench, wanted)
    return _sized(row.truth, draw_strength(rng, row.truth, bench), bench, wanted)
