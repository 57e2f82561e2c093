"""Create confounded cases whose logs contain the angles of both pulleys and thus the tendon elongation.

The elongation is calculated from the four tensions of `plant` by integration along each tendon. The curvature of its
sheath is at the joint, even or at the motor. The model file states this profile (within its [uncertainty]), unless the
profile is the hidden effect. No code is shared with the package under test.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from . import sensors, stretch_effects
from .bench import Bench, Recipe, Run, draw_bench, rms
from .cases import Case, finish, generator, in_domain
from .confounded import ROWS, drawn
from .plant import Effects, Tensions
from .rig import Rig, log_uniform

Array = np.ndarray
SHAPES = ("joint", "even", "motor")
_PROFILES = {"even": "uniform", "motor": "motor_end"}
_COURSE = np.linspace(0.0, 1.0, 201)  # positions along the sheath for the trapezoidal integral of the strain
_AT_JOINT = "bending_centre = 0.99\n"
NOTHING = "nothing"  # no hidden effect: the rig agrees with its file
BESIDE = (*stretch_effects.NAMES, NOTHING)  # rows without a competing effect in the torque
_ONLY_AT_JOINT = {"elongation_coupling", "sheath_asymmetry"}  # these effects are, or exclude, another profile


def names() -> tuple[str, ...]:
    """Return the names "ROW:SHAPE" of all possible combinations."""
    out = [f"{name}:joint" for name in ROWS]
    for shape in _PROFILES:
        out += [f"{name}:{shape}" for name, row in ROWS.items() if not _ONLY_AT_JOINT & set(row.twins)]
    out += [f"{name}:{shape}" for shape in SHAPES for name in BESIDE]
    return tuple(out)


def stretch(rig: Rig, tensions: Tensions, shape: str) -> Array:
    """Return r_M q_M - r_J q_J (m), (n,).

    It is half the difference of both elongations. If one tendon is slack, it is the other tendon's elongation minus
    the elongation by the pretension.
    """
    share = {"joint": 0.0 * _COURSE, "even": _COURSE, "motor": 0.0 * _COURSE + 1.0}[shape]
    spring = 1.0 / rig.series_stiffness if rig.series_stiffness else 0.0
    a, b = (
        _elongation(rig, near, far, share) + spring * near
        for near, far in ((tensions.t1, tensions.t2), (tensions.t3, tensions.t4))
    )
    half = 0.5 * (b - a)
    path = rig.pretension / rig.tendon_stiffness  # elongation of each tendon without torque, at the rig's wrap angle
    return np.where(tensions.t1 <= 0.0, b - path, np.where(tensions.t3 <= 0.0, path - a, half))


def _elongation(rig: Rig, near: Array, far: Array, share: Array) -> Array:
    """Return the elongation (m): the integral of the strain from the motor to the joint."""
    growth = np.log(np.maximum(far, 1e-12) / np.maximum(near, 1e-12))
    factor = np.zeros_like(near)
    for weight, place in zip(np.gradient(_COURSE) * _ends_half(len(_COURSE)), share, strict=True):
        factor += weight * np.exp(growth * place)
    return near * factor * rig.length / rig.axial_stiffness


def _ends_half(count: int) -> Array:
    weights = np.ones(count)
    weights[[0, -1]] = 0.5
    return weights


def two_encoder_case(name: str, seed: int, short: bool = False) -> Case:
    """Return a case of a confounded row on a sheath with a given profile ("ROW:SHAPE"). The logs have q_j and q_m."""
    label, _, shape = name.partition(":")
    if label in BESIDE:
        return _beside_the_torque(label, shape, seed, short)
    row = ROWS[label]
    for attempt in range(200):
        rng = generator("two_encoders", name, seed, attempt)
        found = drawn(rng, row, short)
        if found is not None:
            break
    else:
        raise RuntimeError(f"no case of {name} for seed {seed}")
    bench, hidden, noise = found
    effects: dict[str, dict[str, Any]] = dict(hidden)
    if shape in _PROFILES:
        effects["elongation_coupling"] = {"curvature_profile": _PROFILES[shape]}
    case = finish(rng, "two_encoders", name, seed, bench, effects, noise, row.recipe.get("motion", "rich"))
    bends = {"uniform": "even", "motor_end": "motor"}.get(
        str(effects.get("elongation_coupling", {}).get("curvature_profile")), "joint"
    )
    for log, run in zip(case.logs, bench.runs, strict=True):
        _add_angles(rng, bench, run, effects, bends, log.columns)
    case.truth.effects = {key: value for key, value in case.truth.effects.items() if key in hidden}
    case.truth.twins, case.truth.exact = row.twins, False
    if shape in _PROFILES or "elongation_coupling" not in row.twins:
        return _told_the_shape(case, shape)
    return case


def _beside_the_torque(label: str, shape: str, seed: int, short: bool) -> Case:
    """Return a case without a hidden effect in the torque.

    The angles of all its logs, or of one log for a pulley slip, show the effect `label`.
    """
    for attempt in range(200):
        rng = generator("two_encoders", f"{label}:{shape}", seed, attempt)
        bench = draw_bench(rng, Recipe(joint_angle=True, bare=True, short=short))
        effects: dict[str, dict[str, Any]] = {}
        if shape in _PROFILES:
            effects["elongation_coupling"] = {"curvature_profile": _PROFILES[shape]}
        if in_domain(bench, effects):
            break
    else:
        raise RuntimeError(f"no case of {label} for seed {seed}")
    case = finish(
        rng,
        "two_encoders",
        f"{label}:{shape}",
        seed,
        bench,
        effects,
        bench.reading * log_uniform(rng, 0.005, 0.02),
        "rich",
    )
    case.truth.effects, case.truth.twins, case.truth.exact = {}, (), False
    chosen = int(rng.integers(len(bench.runs)))
    if label != NOTHING:
        reach = rms(stretch(bench.rig, bench.runs[chosen].simulate(bench.rig, effects, False), shape))
        case.truth.effects[label] = stretch_effects.draw(rng, label, bench, bench.runs[chosen], reach)
    for number, (log, run) in enumerate(zip(case.logs, bench.runs, strict=True)):
        here = label != "pulley_slip" or number == chosen
        _add_angles(rng, bench, run, effects, shape, log.columns, case.truth.effects if here else {})
    return _told_the_shape(case, shape)


def _told_the_shape(case: Case, shape: str) -> Case:
    """Return the case with a model file that states the curvature profile."""
    if shape in _PROFILES:
        case.model += f'\n[effects.elongation_coupling]\ncurvature_profile = "{_PROFILES[shape]}"\n'
    else:
        case.model = case.model.replace("[sheath]\n", f"[sheath]\n{_AT_JOINT}")
    return case


def without_motor_angle(case: Case) -> Case:
    """Return the same rig and logs without a motor encoder."""
    logs = [replace(log, columns={k: v for k, v in log.columns.items() if k != "q_m"}) for log in case.logs]
    return replace(case, logs=logs)


def _add_angles(
    rng: np.random.Generator,
    bench: Bench,
    run: Run,
    effects: Effects,
    bends: str,
    columns: dict[str, Array],
    beside: Effects = {},  # noqa: B006 - read only
) -> None:
    rig = bench.rig
    q_j = run.pick(run.scene.q)
    tensions = run.simulate(rig, effects, bench.motor_angle)
    s = stretch(rig, tensions, bends)
    for name, parameters in beside.items():
        s = s + stretch_effects.added(name, dict(parameters), tensions, columns["t"], rig.joint_radius)
    offset = rng.uniform(-0.3, 0.3)
    columns["q_j"] = sensors.encoder(rng, q_j, bench.counts)
    columns["q_m"] = sensors.encoder(rng, offset + (s + rig.joint_radius * q_j) / rig.motor_radius, 4 * bench.counts)
