"""Define the effects of the simulated joint by the plant's own equations: parameters, names and functions.

The compiled functions compute pretension, friction coefficient, backlash and joint-side torque once per sub-step. Where
a definition uses sign(omega), the plant uses a sign that builds up over a milliradian, so that standstill is possible.
Motor friction, ripple, load-dependent friction and the friction direction are in `mechanics` and `full`.

The parser of the model files reads the formula of a plant file (effect `custom`). The plant's own stack machine
evaluates it once per sub-step. A step is an operation with numbers: a constant, the index of a signal (omega_j, q_j,
q_m, tau, sigma, t, temperature), or the index and the constants of a memory. A memory holds four numbers: a flag that
it is initialised, its value, the rate of a second-order lag, and the last input.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.model.catalogue import formula_of
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.plant.compiled import compiled

CROSSING = 0.02  # s, in which a joint of 0.01 kg*m^2 crosses its backlash under about 0.1 N*m
MICRO = 1e-3  # rad over which Coulomb friction of motor and joint builds up
MAX_ELEMENTS = 64  # Maxwell-slip elements of presliding_hysteresis
_MIN_TENSION = 0.05  # of the reference tension: lower bound in tension_dependent_friction
_F = np.float64
_I = np.int64


class Presliding(IntEnum):
    """List the displacements over which friction can build up after a reversal."""

    ELASTIC = 0  # displacement of the tendon in the bends, over the distance of its elastic elongation
    MOTOR = 1  # effect presliding_hysteresis over the motor's angle
    JOINT = 2  # effect presliding_hysteresis over the joint's angle


EFFECT_FIELDS = [  # of the parameter record
    # motor
    ("motor_coulomb", _F),  # N*m
    ("saturation", _F),  # N*m
    ("torque_gain", _F),  # 1 + relative error
    ("ripple", _F),  # N*m
    ("ripple_cycles", _F),
    ("ripple_phase", _F),
    # effects between the joint pulley and the load
    ("viscous", _F),  # N*m*s/rad
    ("viscous_difference", _F),  # N*m*s/rad
    ("inertia", _F),  # kg*m^2
    ("gravity", _F),  # N*m
    ("gravity_phase", _F),  # rad
    ("spring", _F),  # N*m/rad
    ("spring_rest", _F),  # rad
    ("offset", _F),  # N*m
    ("formula_at_motor", _I),  # 1: the plant file's formula reduces the motor torque, 0: the joint torque
    ("load_friction", _F),
    ("backlash", _F),  # rad
    ("backlash_threshold", _F),  # rad: two encoder counts
    ("eccentricity", _F),  # of the joint's pulley, over its radius
    ("eccentricity_phase", _F),  # rad
    # effects on friction and pretension
    ("static_excess", _F),
    ("stribeck_velocity", _F),  # rad/s
    ("stribeck_shape", _F),
    ("temperature_coefficient", _F),  # 1/K
    ("reference_temperature", _F),  # deg C
    ("tension_exponent", _F),
    ("reference_tension", _F),  # N
    ("asymmetry", _F),
    ("bending_per_angle", _F),  # rad/rad
    ("stiffening", _F),
    ("relaxed", _F),
    ("relaxation_time", _F),  # s
    ("relaxation_start", _F),  # s
    ("relaxation_logarithmic", _I),
    ("hysteresis", _I),  # Presliding
    ("hysteresis_distance", _F),  # rad
    ("hysteresis_elements", _I),
    # effects that appear only in the measured angles of motor and joint
    ("softness_at_motor", _F),  # m per N of T3 - T1
    ("softness_at_joint", _F),  # m per N of T4 - T2
    ("creep", _F),  # m
    ("creep_time", _F),  # s
    ("slipped", _F),  # m
    ("slip_time", _F),  # s
    ("play", _F),  # rad
    # sensors
    ("sensor_delay", _F),  # s
    ("sensor_lag", _F),  # s
    ("velocity_lag", _F),  # s
]

_NEUTRAL = {  # neutral values of absent effects, where they are not zero
    "saturation": math.inf,
    "torque_gain": 1.0,
    "stribeck_velocity": 1.0,
    "stribeck_shape": 2.0,
    "reference_temperature": 25.0,
    "relaxation_time": 1.0,
    "creep_time": 1.0,
    "hysteresis": Presliding.ELASTIC,
}

_NAMES: dict[str, dict[str, str]] = {
    "velocity_lag": {"time_constant": "velocity_lag"},
    "torque_ripple": {"amplitude": "ripple", "cycles_per_revolution": "ripple_cycles", "phase": "ripple_phase"},
    "motor_side_friction": {"coulomb": "motor_coulomb"},
    "configuration_dependent_bending": {"bending_per_joint_angle": "bending_per_angle"},
    "stiffness_nonlinearity": {"quadratic": "stiffening"},
    "pretension_relaxation": {
        "relaxed_fraction": "relaxed",
        "time_constant": "relaxation_time",
        "start_time": "relaxation_start",
    },
    "stribeck_friction": {
        "static_excess": "static_excess",
        "stribeck_velocity": "stribeck_velocity",
        "shape": "stribeck_shape",
    },
    "thermal_friction_drift": {
        "temperature_coefficient": "temperature_coefficient",
        "reference_temperature": "reference_temperature",
    },
    "tension_dependent_friction": {"exponent": "tension_exponent", "reference_tension": "reference_tension"},
    "presliding_hysteresis": {"presliding_distance": "hysteresis_distance", "elements": "hysteresis_elements"},
    "sheath_asymmetry": {"relative_difference": "asymmetry"},
    "load_dependent_friction": {"coefficient": "load_friction"},
    "backlash": {"gap": "backlash"},
    "pulley_eccentricity": {"relative_eccentricity": "eccentricity", "phase": "eccentricity_phase"},
    "viscous_friction": {"coefficient": "viscous"},
    "direction_asymmetric_friction": {"viscous_difference": "viscous_difference"},
    "inertia": {"inertia": "inertia"},
    "gravity_load": {"amplitude": "gravity", "phase": "gravity_phase"},
    "joint_stiffness": {"stiffness": "spring", "rest_angle": "spring_rest"},
    "torque_offset": {"offset": "offset"},
    "torque_saturation": {"limit": "saturation"},
    "torque_sensor_lag": {"time_constant": "sensor_lag"},
    "transport_delay": {"delay": "sensor_delay"},
    "tendon_creep": {"length": "creep", "time_constant": "creep_time"},
    "pulley_slip": {"length": "slipped", "time": "slip_time"},
    "joint_play": {"gap": "play"},
}  # tendon_slack is always active; torque_constant_error and elongation_coupling are not a plain number


def effect_values(effects: Mapping[str, Mapping[str, Any]], model: TendonSheath) -> dict[str, float]:
    """Return the fields of the parameter record for these effects, with neutral values for absent effects."""
    values: dict[str, float] = {**_NEUTRAL, "reference_tension": max(model.pretension, 1e-6)}
    for name, parameters in effects.items():
        for key, target in _NAMES.get(name, {}).items():
            if key in parameters:
                values[target] = parameters[key]
    if "torque_constant_error" in effects:
        values["torque_gain"] = 1.0 + effects["torque_constant_error"]["relative_error"]
    if "series_spring" in effects:
        spring = effects["series_spring"]
        values[f"softness_at_{spring.get('end', 'motor')}"] = 0.5 / spring["stiffness"]
    if effects.get("pretension_relaxation", {}).get("law") == "logarithmic":
        values["relaxation_logarithmic"] = 1
    if "custom" in effects:
        values["formula_at_motor"] = float(effects["custom"]["stage"] == "motor")
    if "presliding_hysteresis" in effects:
        side = effects["presliding_hysteresis"].get("displacement", "motor")
        values["hysteresis"] = Presliding[str(side).upper()]
        values["hysteresis_elements"] = min(MAX_ELEMENTS, int(values["hysteresis_elements"]))
    return values


@compiled
def pretension(p: Any, theta: float, time: float) -> float:
    """Return T_p0 (N) of a tendon at wrap angle `theta` (rad), stiffened, and relaxed at `time` (s since the start)."""
    base = p.pretension * p.pretension_factor
    tension = max(0.0, base + p.tendon_stiffness * p.bending_arm * (theta - p.theta))
    tension *= 1.0 + p.stiffening * tension / p.stiffness
    elapsed = max(0.0, time - p.relaxation_start)
    if p.relaxed != 0.0:
        if p.relaxation_logarithmic:
            tension *= max(0.0, 1.0 - p.relaxed * math.log10(1.0 + elapsed / p.relaxation_time))
        else:
            tension *= 1.0 - p.relaxed * (1.0 - math.exp(-elapsed / p.relaxation_time))
    return float(tension)


@compiled
def friction_coefficient(s: Any, p: Any) -> float:
    """Return mu at the present speed and temperature."""
    mu = p.friction
    if p.static_excess != 0.0:
        mu *= 1.0 + p.static_excess * math.exp(-(abs(s.omega_j / p.stribeck_velocity) ** p.stribeck_shape))
    if p.temperature_coefficient != 0.0:
        mu *= max(0.0, 1.0 + p.temperature_coefficient * (s.temperature - p.reference_temperature))
    return float(mu)


@compiled
def tension_factor(p: Any, tension: float) -> float:
    """Return the factor on the friction angle at this tension in N (tension_dependent_friction)."""
    if p.tension_exponent == 0.0:
        return 1.0
    ratio = max(tension, _MIN_TENSION * p.reference_tension) / p.reference_tension
    return float(ratio ** (-p.tension_exponent))


@compiled
def track_backlash(s: Any, p: Any) -> None:
    """Track reversals of the joint. Within the gap after a reversal, the tendons do not act on it."""
    if s.direction == 0.0:
        s.direction = 1.0 if s.omega_j >= 0.0 else -1.0
        s.extreme = s.q_j
        s.reversal = s.q_j - 2.0 * p.backlash * s.direction
    if (s.q_j - s.extreme) * s.direction > 0.0:
        s.extreme = s.q_j
    elif (s.extreme - s.q_j) * s.direction > p.backlash_threshold:
        s.reversal = s.extreme
        s.direction = -s.direction
        s.extreme = s.q_j
    s.in_gap = 1 if abs(s.q_j - s.reversal) < p.backlash else 0


@compiled
def lengths_beside(s: Any, p: Any, h: float) -> tuple[float, float]:
    """Return the lead of the motor encoder over the tendons (m), and the lag of the joint behind its pulley (rad)."""
    since = s.t - s.started if s.started >= 0.0 else 0.0
    length = p.softness_at_motor * (s.t3 - s.t1)
    if p.creep != 0.0:
        length += p.creep * (1.0 - math.exp(-since / p.creep_time))
    if p.slipped != 0.0 and since >= p.slip_time:
        length += p.slipped
    behind = p.softness_at_joint * (s.t4 - s.t2) / p.r_j
    if p.play != 0.0:
        s.play_side += (math.copysign(1.0, s.t4 - s.t2) - s.play_side) * (1.0 - math.exp(-h / CROSSING))
        behind += 0.5 * p.play * s.play_side
    return float(length), float(behind)


@compiled
def wound(p: Any, q_j: float) -> float:
    """Return the length (m) of tendon on the joint pulley at angle q_j (rad), 0 at 0: the integral of `arm`."""
    if p.eccentricity == 0.0:
        return float(p.r_j * q_j)
    turned = math.cos(p.eccentricity_phase) - math.cos(q_j + p.eccentricity_phase)
    return float(p.r_j * (q_j + p.eccentricity * turned))


@compiled
def arm(p: Any, q_j: float) -> tuple[float, float]:
    """Return the distance (m) of the tendons from the joint axis at angle q_j (rad), and its derivative (m/rad)."""
    if p.eccentricity == 0.0:
        return float(p.r_j), 0.0
    angle = q_j + p.eccentricity_phase
    return float(p.r_j * (1.0 + p.eccentricity * math.sin(angle))), float(p.r_j * p.eccentricity * math.cos(angle))


@compiled
def joint_losses(p: Any, q: float, omega: float, acceleration: float) -> float:
    """Return the torque of the effects between the joint pulley and the load, N*m."""
    return float(
        p.viscous * omega
        + p.viscous_difference * abs(omega)
        + p.inertia * acceleration
        + p.gravity * math.sin(q + p.gravity_phase)
        + p.spring * (q - p.spring_rest)
        - p.offset
    )


_DEEPEST = 32  # values on the stack; the parser allows fewer
_SATURATED = 700.0  # exp(709.8) is the largest double
_LAG, _RING = 15, 16  # operations; higher numbers are Dahl's hysteresis


def steps_of(effects: Mapping[str, Mapping[str, Any]]) -> NDArray[np.float64]:
    """Return operations and numbers of the plant file's formula, shape (4, n); n = 0 without a formula."""
    if "custom" not in effects:
        return np.zeros((4, 0))
    return np.ascontiguousarray(np.array(formula_of(effects["custom"]), dtype=np.float64).T)


def memory_of(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the initial memories of these steps, shape (memories, 4)."""
    return np.zeros((int(np.sum(steps[0] >= _LAG)), 4))


@compiled
def formula(s: Any, steps: Any, memory: Any, tau: float, sigma: float, since: float, h: float) -> float:
    """Return the formula's value for a sub-step of h s, N*m; 0 without a formula or if the value is not finite."""
    count = steps.shape[1]
    if count == 0:
        return 0.0
    stack = np.zeros(_DEEPEST)
    top = -1
    for i in range(count):
        op, number = int(steps[0, i]), steps[1, i]
        if op == 0:
            top += 1
            stack[top] = number
        elif op == 1:
            top += 1
            stack[top] = _signal(s, int(number), tau, sigma, since)
        elif op >= _LAG:
            stack[top] = _remembered(memory[int(number)], op, steps[2, i], steps[3, i], stack[top], h)
        elif op <= 6:
            top -= 1
            stack[top] = _two(op, stack[top], stack[top + 1])
        else:
            stack[top] = _one(op, stack[top])
    return float(stack[0]) if math.isfinite(stack[0]) else 0.0


@compiled
def _signal(s: Any, number: int, tau: float, sigma: float, since: float) -> float:
    if number == 0:
        return float(s.omega_j)
    if number == 1:
        return float(s.q_j)
    if number == 2:
        return float(s.q_m)
    if number == 3:
        return tau
    if number == 4:
        return sigma
    if number == 5:
        return since
    return float(s.temperature)


@compiled
def _two(op: int, left: float, right: float) -> float:
    if op == 2:
        return left + right
    if op == 3:
        return left - right
    if op == 4:
        return left * right
    if op == 5:
        return left / right if right != 0.0 else math.nan
    return math.nan if left == 0.0 and right < 0.0 else float(left**right)


@compiled
def _one(op: int, x: float) -> float:
    if op == 7:
        return -x
    if op == 8:
        return math.sin(x)
    if op == 9:
        return math.cos(x)
    if op == 10:
        return math.tanh(x)
    if op == 11:
        return math.exp(min(x, _SATURATED))
    if op == 12:
        return abs(x)
    if op == 13:
        return 1.0 if x > 0.0 else -1.0 if x < 0.0 else x
    return math.sqrt(x) if x >= 0.0 else math.nan


@compiled
def _remembered(own: Any, op: int, first: float, second: float, x: float, h: float) -> float:
    """Return the memory's value for the input x, h s after the last input; nan without a change if x is not finite."""
    if not math.isfinite(x):
        return math.nan
    if own[0] == 0.0:
        own[0], own[1], own[2], own[3] = 1.0, 0.0 if op > _RING else x, 0.0, x
        return float(own[1])
    move = x - own[3]
    if op == _LAG:  # y = x - T slope + a decaying part
        late = first * move / h
        own[1] = x - late + (own[1] - own[3] + late) * math.exp(-h / first)
    elif op == _RING:
        w, slope = 2.0 * math.pi * first, move / h
        late = 2.0 * second * slope / w
        a, b = own[1] - own[3] + late, own[2] - slope  # free oscillation about a delayed ramp
        turn = w * math.sqrt(max(0.0, 1.0 - second * second))
        sine = math.sin(turn * h) / turn if turn > 0.0 else h
        cosine, decay = math.cos(turn * h), math.exp(-second * w * h)
        own[1] = x - late + decay * (a * cosine + (b + second * w * a) * sine)
        own[2] = slope + decay * (b * cosine - (second * w * b + w * w * a) * sine)
    elif move != 0.0:
        side = math.copysign(1.0, move)
        own[1] = side - (side - own[1]) * math.exp(-abs(move) / first)
    own[3] = x
    return float(own[1])
