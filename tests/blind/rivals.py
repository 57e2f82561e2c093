"""Find the effect that best imitates a hidden effect in the same logs, and the remaining error.

If another effect imitates the hidden one within the noise, a case has no unique answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .bench import Bench, rms
from .plant import Effects

Array = np.ndarray

SAMPLES = 6000  # of all runs together
CORRELATED = 15.0  # samples of coloured noise that carry as much information as one sample of white noise
CERTAIN = 7.0  # smallest error of the best imitation in standard deviations


@dataclass(frozen=True)
class Imitation:
    """The changes of the joint torque by effect `name`, as columns of a linear fit.

    If `scaled` is set, the first column has a free factor, which is at least 0 if `positive` is set. Otherwise its
    factor is 1. All other columns have free factors.
    """

    name: str
    columns: tuple[Array, ...]
    scaled: bool = True
    positive: bool = False


class Thinned:
    """The torques of a bench, reduced to a few thousand samples."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        count = sum(run.sparse.t.size for run in bench.runs)
        self.stride = max(1, count // SAMPLES)
        self.plain = self.of({})

    def of(self, effects: Effects, bench: Bench | None = None) -> Array:
        return self.join((bench or self.bench).ideal(effects))

    def join(self, torques: list[Array]) -> Array:
        return np.concatenate([torque[:: self.stride] for torque in torques])

    def change(self, effects: Effects) -> Array:
        """Return the change of joint torque by these effects (N*m)."""
        if "velocity_lag" not in effects:
            return self.of(effects) - self.plain
        others = {key: value for key, value in effects.items() if key != "velocity_lag"}
        return self.of(others) - self.join(self.bench.ideal_as_seen({}, effects))

    def recalibration(self) -> list[Array]:
        rig = self.bench.rig
        moved = replace(rig, mu=1.03 * rig.mu), replace(rig, pretension=1.03 * rig.pretension)
        return [self.of({}, replace(self.bench, rig=other)) - self.plain for other in moved]


def imitations(thin: Thinned) -> list[Imitation]:
    """Return every effect of the catalogue that the logs allow, at several values of its nonlinear parameters."""
    bench = thin.bench
    speed, reach = bench.speed, bench.reach
    path = bench.motor_reach if bench.motor_angle else reach
    rig, seconds = bench.rig, max(run.scene.t[-1] for run in bench.runs)
    stiff = rig.axial_stiffness / rig.pretension

    def one(name: str, **parameters: Any) -> Array:
        return thin.change({name: parameters})

    ones = np.ones_like(thin.plain)
    out = [
        Imitation("viscous_friction", (one("viscous_friction", coefficient=bench.scale / speed),), positive=True),
        Imitation(
            "direction_asymmetric_friction",
            (one("direction_asymmetric_friction", viscous_difference=bench.scale / speed),),
        ),
        Imitation("inertia", (one("inertia", inertia=bench.scale / speed),), positive=True),
        Imitation("torque_offset", (ones,)),
        Imitation("motor_side_friction", (one("motor_side_friction", coulomb=0.05 * rig.torque_limit),), positive=True),
        Imitation("torque_constant_error", (one("torque_constant_error", relative_error=0.05),)),
        Imitation("sheath_asymmetry", (one("sheath_asymmetry", relative_difference=0.1),)),
        Imitation("tendon_slack", (one("tendon_slack"),), scaled=False),
        Imitation("elongation_coupling", (one("elongation_coupling", curvature_profile="uniform"),), scaled=False),
        Imitation("elongation_coupling", (one("elongation_coupling", curvature_profile="motor_end"),), scaled=False),
    ]
    for exponent in (0.1, 0.4, 0.8):
        change = one("tension_dependent_friction", exponent=exponent)
        out.append(Imitation("tension_dependent_friction", (change,), positive=True))
    for coefficient in (0.03, 0.1, 0.3):
        change = one("load_dependent_friction", coefficient=coefficient)
        out.append(Imitation("load_dependent_friction", (change,), positive=True))
    for share in (-0.3, -0.1, 0.1, 0.5):
        change = one("stiffness_nonlinearity", quadratic=share * stiff)
        out.append(Imitation("stiffness_nonlinearity", (change,), positive=True))
    for share in (0.03, 0.06, 0.12, 0.25, 0.5):
        for shape in (0.6, 1.0, 2.0):
            change = one("stribeck_friction", static_excess=0.3, stribeck_velocity=share * speed, shape=shape)
            out.append(Imitation("stribeck_friction", (change,), positive=True))
    for share in (0.005, 0.015, 0.05, 0.15):
        for elements in (1, 4):
            change = one("presliding_hysteresis", presliding_distance=share * path, elements=elements)
            out.append(Imitation("presliding_hysteresis", (change,), positive=True))
    for share in (0.05, 0.2, 0.5, 2.0):
        change = one("pretension_relaxation", relaxed_fraction=0.1, time_constant=share * seconds)
        out.append(Imitation("pretension_relaxation", (change,), positive=True))
        slow = {"relaxed_fraction": 0.05, "time_constant": 0.1 * share * seconds, "law": "logarithmic"}
        out.append(Imitation("pretension_relaxation", (one("pretension_relaxation", **slow),), positive=True))
    for seconds in (0.003, 0.006, 0.012, 0.024, 0.045):
        out.append(Imitation("transport_delay", (one("transport_delay", delay=seconds),), positive=True))
        out.append(Imitation("velocity_lag", (one("velocity_lag", time_constant=seconds),), positive=True))
    if bench.temperature:
        out.append(Imitation("thermal_friction_drift", (one("thermal_friction_drift", temperature_coefficient=0.003),)))
    if bench.joint_angle:
        out += _of_the_angle(thin, one, ones)
    if bench.motor_angle:
        for cycles in range(1, 25):
            drawn = {"amplitude": 0.02 * rig.torque_limit, "cycles_per_revolution": cycles}
            waves = one("torque_ripple", phase=0.0, **drawn), one("torque_ripple", phase=0.5 * np.pi, **drawn)
            out.append(Imitation("torque_ripple", waves))
    return out


def _of_the_angle(thin: Thinned, one: Any, ones: Array) -> list[Imitation]:
    bench = thin.bench
    spring = one("joint_stiffness", stiffness=bench.scale / bench.reach)
    far = [
        one("joint_stiffness", stiffness=bench.scale / bench.reach, rest_angle=share * bench.reach)
        for share in (-2.0, -1.0, 1.0, 2.0)
    ]
    weights = one("gravity_load", amplitude=bench.scale), one("gravity_load", amplitude=bench.scale, phase=0.5 * np.pi)
    bending = one("configuration_dependent_bending", bending_per_joint_angle=0.05 * bench.rig.bending / bench.reach)
    arms = [one("pulley_eccentricity", relative_eccentricity=0.1, phase=phase) for phase in (0.0, 0.5 * np.pi)]
    plays = [one("backlash", gap=share * bench.reach) for share in (0.006, 0.015, 0.04, 0.1)]
    return [
        Imitation("joint_stiffness", (spring, ones), positive=True),
        *(Imitation("joint_stiffness", (column,), positive=True) for column in far),
        Imitation("gravity_load", weights),
        Imitation("configuration_dependent_bending", (bending,)),
        Imitation("pulley_eccentricity", tuple(arms)),
        *(Imitation("backlash", (play,), positive=True) for play in plays),
    ]


def nearest(bench: Bench, effects: Effects, name: str) -> tuple[str, float]:
    """Return the best imitation of effect `name` in the presence of the other effects, and its RMS error (N·m).

    Recalibration and the strengths of the other effects are free, all linearised about the truth.
    """
    thin = Thinned(bench)
    others = {key: dict(value) for key, value in effects.items() if key != name}
    target = thin.change(effects) - (thin.change(others) if others else 0.0)
    free = thin.recalibration()
    for key, value in others.items():
        free.append(thin.change({key: value}))
    best = ("nothing", rms(_residual(free, target)))
    for imitation in imitations(thin):
        if imitation.name in effects or (name == "torque_offset" and len(imitation.columns) > 1):
            continue  # an offset is the limit of a spring or a weight of zero strength
        left = rms(_imitated(free, imitation, target))
        if left < best[1]:
            best = imitation.name, left
    return best


def is_unique(bench: Bench, effects: Effects, noise: float) -> bool:
    """Return True if no other effect imitates any of the effects within the noise, with a clear margin."""
    count = sum(run.sparse.t.size for run in bench.runs)
    needed = CERTAIN * noise / np.sqrt(count / CORRELATED)
    return all(nearest(bench, effects, name)[1] >= needed for name in effects)


def _imitated(free: list[Array], imitation: Imitation, target: Array) -> Array:
    first, *more = imitation.columns
    if not imitation.scaled:
        return _residual([*free, *more], target - first)
    columns = [*free, *more, first]
    solution, residual = _solve(columns, target)
    if imitation.positive and solution[-1] < 0.0:
        return _residual([*free, *more], target)
    return residual


def _residual(columns: list[Array], target: Array) -> Array:
    return _solve(columns, target)[1]


def _solve(columns: list[Array], target: Array) -> tuple[Array, Array]:
    scales = np.array([max(rms(column), 1e-300) for column in columns])
    matrix = np.stack(columns, axis=1) / scales
    solution = np.linalg.lstsq(matrix, target, rcond=1e-9)[0]
    return solution / scales, target - matrix @ solution
