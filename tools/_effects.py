"""One instance of every effect of the catalogue, for the tools that measure what it costs."""

from __future__ import annotations

from typing import Any

EFFECTS: dict[str, dict[str, Any]] = {
    "velocity_lag": {"time_constant": 0.01},
    "torque_constant_error": {"relative_error": 0.05},
    "torque_ripple": {"amplitude": 0.06, "cycles_per_revolution": 12},
    "motor_side_friction": {"coulomb": 0.03},
    "configuration_dependent_bending": {"bending_per_joint_angle": 0.6},
    "stiffness_nonlinearity": {"quadratic": 10.0},
    "pretension_relaxation": {"relaxed_fraction": 0.1, "time_constant": 12.0},
    "stribeck_friction": {"static_excess": 0.5, "stribeck_velocity": 0.3, "shape": 1.3},
    "thermal_friction_drift": {"temperature_coefficient": 0.01},
    "tension_dependent_friction": {"exponent": 0.3},
    "presliding_hysteresis": {"presliding_distance": 0.05, "elements": 8},
    "sheath_asymmetry": {"relative_difference": 0.2},
    "tendon_slack": {},
    "elongation_coupling": {"curvature_profile": "uniform"},
    "load_dependent_friction": {"coefficient": 0.1},
    "backlash": {"gap": 0.02},
    "viscous_friction": {"coefficient": 0.08},
    "direction_asymmetric_friction": {"viscous_difference": 0.02},
    "inertia": {"inertia": 0.01},
    "gravity_load": {"amplitude": 0.3},
    "joint_stiffness": {"stiffness": 0.4},
    "torque_offset": {"offset": 0.03},
    "transport_delay": {"delay": 0.0043},
}
STACK = {name: values for name, values in EFFECTS.items() if name != "elongation_coupling"}  # all that go together
