"""Random parameters of a hidden effect, scaled to a desired size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .bench import Bench
from .rig import log_uniform

NAMES = (
    "velocity_lag",
    "torque_constant_error",
    "torque_ripple",
    "motor_side_friction",
    "configuration_dependent_bending",
    "stiffness_nonlinearity",
    "pretension_relaxation",
    "stribeck_friction",
    "thermal_friction_drift",
    "tension_dependent_friction",
    "presliding_hysteresis",
    "sheath_asymmetry",
    "tendon_slack",
    "elongation_coupling",
    "load_dependent_friction",
    "backlash",
    "pulley_eccentricity",
    "viscous_friction",
    "direction_asymmetric_friction",
    "inertia",
    "gravity_load",
    "joint_stiffness",
    "torque_offset",
    "transport_delay",
    "torque_saturation",
    "torque_sensor_lag",
)


@dataclass
class Strength:
    """An effect and the parameter that sets its size, with its start value and its limit."""

    name: str
    parameters: dict[str, Any]
    key: str = ""  # empty if the size cannot be set
    start: float = 0.0
    cap: float = 0.0

    def at(self, value: float) -> dict[str, Any]:
        return {**self.parameters, self.key: value} if self.key else dict(self.parameters)


def draw_strength(rng: np.random.Generator, name: str, bench: Bench) -> Strength:
    """Return a random effect `name` for this bench. Sign and shape are final, and the strength is a start value."""
    tau, speed, reach = bench.scale, bench.speed, bench.reach
    limit = bench.rig.torque_limit
    sign = float(rng.choice([-1.0, 1.0]))
    path = bench.motor_reach if bench.motor_angle else reach
    sample = 1.0 / bench.runs[0].rate
    match name:
        case "viscous_friction":
            return Strength(name, {}, "coefficient", 0.1 * tau / speed, tau / speed)
        case "direction_asymmetric_friction":
            return Strength(name, {}, "viscous_difference", sign * 0.1 * tau / speed, sign * tau / speed)
        case "inertia":
            peak = max(float(np.std(run.scene.acceleration)) for run in bench.runs)
            return Strength(name, {}, "inertia", 0.1 * tau / peak, 0.6 * tau / peak)
        case "gravity_load":
            return Strength(name, {"phase": rng.uniform(-np.pi, np.pi)}, "amplitude", 0.1 * tau, 1.5 * tau)
        case "joint_stiffness":
            rest = rng.uniform(-0.5, 0.5) * reach
            return Strength(name, {"rest_angle": rest}, "stiffness", 0.1 * tau / reach, 1.5 * tau / reach)
        case "torque_offset":
            return Strength(name, {}, "offset", sign * 0.1 * tau, sign * tau)
        case "torque_ripple":
            cycles = int(rng.choice([2, 3, 4, 6, 7, 11, 12, 14, 18, 24]))
            drawn: dict[str, Any] = {"cycles_per_revolution": cycles, "phase": rng.uniform(-np.pi, np.pi)}
            return Strength(name, drawn, "amplitude", 0.05 * limit, 0.4 * limit)
        case "motor_side_friction":
            return Strength(name, {}, "coulomb", 0.05 * limit, 0.4 * limit)
        case "torque_constant_error":
            return Strength(name, {}, "relative_error", sign * 0.08, sign * 0.35)
        case "stribeck_friction":
            shape = float(rng.choice([2.0, 2.0, 1.0, rng.uniform(0.6, 2.0)]))
            drawn = {"stribeck_velocity": speed * np.exp(rng.uniform(np.log(0.04), np.log(0.25))), "shape": shape}
            return Strength(name, drawn, "static_excess", 0.4, 2.5)
        case "thermal_friction_drift":
            return Strength(name, {}, "temperature_coefficient", sign * 0.005, sign * 0.03)
        case "tension_dependent_friction":
            # The reference is not fitted: a diagnosis uses the nominal pretension for it.
            return Strength(name, {"reference_tension": bench.nominal.pretension}, "exponent", 0.2, 0.9)
        case "presliding_hysteresis":
            elements = int(rng.choice([1, 1, 1, 2, 4, 8]))
            return Strength(name, {"elements": elements, "presliding_distance": path * log_uniform(rng, 0.006, 0.15)})
        case "sheath_asymmetry":
            return Strength(name, {}, "relative_difference", sign * 0.2, sign * 1.5)
        case "load_dependent_friction":
            return Strength(name, {}, "coefficient", 0.05, 0.35)
        case "tendon_slack":
            return Strength(name, {})
        case "elongation_coupling":
            return Strength(name, {"curvature_profile": str(rng.choice(["uniform", "uniform", "motor_end"]))})
        case "stiffness_nonlinearity":
            stiff = bench.rig.axial_stiffness / bench.rig.pretension
            return Strength(name, {}, "quadratic", sign * 0.2 * stiff, (0.45 if sign < 0 else 1.5) * sign * stiff)
        case "backlash":
            return Strength(name, {"gap": reach * log_uniform(rng, 0.008, 0.1)})
        case "pulley_eccentricity":
            return Strength(name, {"phase": rng.uniform(-np.pi, np.pi)}, "relative_eccentricity", 0.05, 0.45)
        case "pretension_relaxation":
            seconds = max(run.scene.t[-1] for run in bench.runs)
            if rng.random() < 0.65:
                drawn = {"time_constant": seconds * rng.uniform(0.1, 0.6), "law": "exponential"}
                return Strength(name, drawn, "relaxed_fraction", 0.15, 0.6)
            drawn = {"time_constant": seconds * rng.uniform(0.01, 0.1), "law": "logarithmic"}
            return Strength(name, drawn, "relaxed_fraction", 0.1, 0.35)
        case "configuration_dependent_bending":
            rig = bench.rig
            most = 0.35 * min(rig.bending, rig.pretension / rig.tension_per_bending) / (2.0 * reach)
            return Strength(name, {}, "bending_per_joint_angle", sign * 0.3 * most, sign * most)
        case "transport_delay":
            return Strength(name, {"delay": log_uniform(rng, max(0.004, 3.0 * sample), 0.045)})
        case "torque_saturation":
            peak = max(float(np.max(np.abs(run.scene.tau_m))) for run in bench.runs)
            return Strength(name, {"limit": peak * rng.uniform(0.55, 0.85)})
        case "torque_sensor_lag":
            return Strength(name, {"time_constant": log_uniform(rng, max(0.008, 3.0 * sample), 0.12)})
        case "velocity_lag":
            return Strength(name, {"time_constant": log_uniform(rng, max(0.008, 3.0 * sample), 0.08)})
    raise ValueError(f"unknown effect: {name}")


def solve(strength: Strength, target: float, size: Callable[[dict[str, Any]], float]) -> tuple[dict[str, Any], float]:
    """Return parameters whose size is near `target` (N·m) within the effect's bounds, and the size reached."""
    if not strength.key:
        return strength.at(0.0), size(strength.at(0.0))
    sign = 1.0 if strength.start > 0.0 else -1.0
    value, cap = abs(strength.start), abs(strength.cap)
    reached = size(strength.at(sign * value))
    for _ in range(7):
        if 0.93 < reached / target < 1.08 or (reached < target and value >= cap) or reached == 0.0:
            break
        value = min(value * float(np.clip(target / reached, 0.2, 5.0)), cap)
        reached = size(strength.at(sign * value))
    return strength.at(sign * value), reached
