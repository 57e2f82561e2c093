"""The inner loop of one axis, compiled: torque loop, motor, pair of tendon-sheaths, joint, load; implicit Euler.

Unknowns of a sub-step are the motor's and (unless its motion is imposed) the joint's angle at its end:

    J_M (omega_M' - omega_M) / h + b_M omega_M' + r_M (T3' - T1') + tau_c z_M' = tau_M'
    J   (omega_J' - omega_J) / h + load(q_J', omega_J')                       = tau_J'(T2', T4')

solved by Newton's method with the tensions' exact derivatives, so that stiff tendons and a motor without inertia need
no smaller step. Signs: tau_M = r_M (T3 - T1), tau_J = r_J (T4 - T2); tendon b (T3, T4) pulls the joint forward.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tsa_ctrl.plant.chain import chain_tensions, commit_chains, prepare_chains
from tsa_ctrl.plant.compiled import compiled
from tsa_ctrl.plant.full import full_tensions
from tsa_ctrl.plant.state import DELAY_SAMPLES, Load, Presliding

_IMPOSED, _SPRING, _WEIGHT = int(Load.IMPOSED), int(Load.SPRING), int(Load.WEIGHT)
_ELASTIC, _MOTOR = int(Presliding.ELASTIC), int(Presliding.MOTOR)
_MICRO = 1e-3  # rad over which Coulomb friction of motor and joint builds up
_ITERATIONS = 40
_TOLERANCE = 1e-9  # N*m
_MIN_TENSION = 0.05  # of the reference tension, bound of tension_dependent_friction


@compiled
def advance(
    s: Any,
    p: Any,
    ring: Any,
    slip: Any,
    curve: Any,
    chains: Any,
    motion: Any,
    bending: Any,
    temperature: Any,
    command: float,
    enabled: bool,
    max_speed: float,
    until: float,
) -> None:
    """Bring the state record s[0] to time `until` in equal sub-steps of at most p[0].step.

    ring (2, n): times and delivered torques; slip (n): Maxwell-slip elements; curve (2, n): profile of bending;
    chains: distributed tendons, see `chain`; motion (2, n): angle and speed on the grid;
    bending, temperature (2, n): times and values; command: N*m at the motor pulley.
    """
    span = until - s[0].t
    if span <= 0.0:
        return
    count = max(1, math.ceil(span / p[0].step - 1e-6))
    h = span / count
    for _ in range(count):
        _step(s[0], p[0], ring, slip, curve, chains, motion, bending, temperature, command, enabled, max_speed, h)


@compiled
def _table(table: Any, x: float, before: float) -> float:
    """Linear interpolation, constant beyond the ends; `before` when the table is empty."""
    n = table.shape[1]
    if n == 0:
        return before
    if x <= table[0, 0]:
        return float(table[1, 0])
    for i in range(1, n):
        if x < table[0, i]:
            w = (x - table[0, i - 1]) / (table[0, i] - table[0, i - 1])
            return float((1.0 - w) * table[1, i - 1] + w * table[1, i])
    return float(table[1, n - 1])


@compiled
def _imposed(p: Any, motion: Any, time: float) -> tuple[float, float, float]:
    """Angle, speed and acceleration of the imposed motion, `time` s after its beginning; negative: it waits."""
    last = motion.shape[1] - 1
    duration = last * p.motion_grid
    if time <= 0.0:
        return motion[0, 0], 0.0, 0.0
    local = time
    if local >= duration:
        if not p.motion_repeat:
            return motion[0, last], 0.0, 0.0
        local = local % duration
    g = p.motion_grid
    i = min(last - 1, int(local / g))
    x = local / g - i
    a, b, c, d = motion[0, i], motion[0, i + 1], motion[1, i] * g, motion[1, i + 1] * g
    e, f = b - a, c + d
    q = a + x * (c + x * (3.0 * e - 2.0 * c - d + x * (f - 2.0 * e)))
    w = (c + x * (2.0 * (3.0 * e - 2.0 * c - d) + 3.0 * x * (f - 2.0 * e))) / g
    acceleration = (2.0 * (3.0 * e - 2.0 * c - d) + 6.0 * x * (f - 2.0 * e)) / (g * g)
    if time < p.motion_ramp:
        y = time / p.motion_ramp
        r, r1, r2 = y * y * (3.0 - 2.0 * y), 6.0 * y * (1.0 - y) / p.motion_ramp, (6.0 - 12.0 * y) / p.motion_ramp**2
        d0 = q - motion[0, 0]
        acceleration = r2 * d0 + 2.0 * r1 * w + r * acceleration
        w = r1 * d0 + r * w
        q = motion[0, 0] + r * d0
    return q, w, acceleration


@compiled
def _torque_loop(s: Any, p: Any, command: float, enabled: bool, max_speed: float, h: float) -> None:
    """Current loop with lag and limits; no torque in the direction of motion beyond the drive's speed limit."""
    target = 0.0
    s.speed_limited = 0
    if enabled:
        target = min(p.peak_torque, max(-p.peak_torque, command))
        speed = abs(s.omega_m)
        if speed > max_speed and target * s.omega_m > 0.0:
            target *= max(0.0, 1.0 - (speed - max_speed) / max(1e-6, 0.05 * max_speed))
            s.speed_limited = 1
    gain = 1.0 if p.torque_lag <= 0.0 else 1.0 - math.exp(-h / p.torque_lag)
    s.torque_loop += (target - s.torque_loop) * gain
    s.tau_m = s.torque_loop * p.torque_gain
    if p.ripple != 0.0:
        s.tau_m += p.ripple * math.sin(p.ripple_cycles * s.q_m + p.ripple_phase)


@compiled
def _pretension(s: Any, p: Any, time: float) -> float:
    """T_p0 at this bending, stiffened and relaxed; time in s since the start."""
    base = p.pretension * p.pretension_factor
    tension = max(0.0, base + p.tendon_stiffness * p.bending_arm * (s.theta - p.theta))
    tension *= 1.0 + p.stiffening * tension / p.stiffness
    elapsed = max(0.0, time - p.relaxation_start)
    if p.relaxed != 0.0:
        if p.relaxation_logarithmic:
            tension *= max(0.0, 1.0 - p.relaxed * math.log10(1.0 + elapsed / p.relaxation_time))
        else:
            tension *= 1.0 - p.relaxed * (1.0 - math.exp(-elapsed / p.relaxation_time))
    return float(tension)


@compiled
def _friction_coefficient(s: Any, p: Any) -> float:
    mu = p.friction
    if p.static_excess != 0.0:
        mu *= 1.0 + p.static_excess * math.exp(-(abs(s.omega_j / p.stribeck_velocity) ** p.stribeck_shape))
    if p.temperature_coefficient != 0.0:
        mu *= max(0.0, 1.0 + p.temperature_coefficient * (s.temperature - p.reference_temperature))
    return float(mu)


@compiled
def _tension_factor(p: Any, tension: float) -> float:
    if p.tension_exponent == 0.0:
        return 1.0
    ratio = max(tension, _MIN_TENSION * p.reference_tension) / p.reference_tension
    return float(ratio ** (-p.tension_exponent))


@compiled
def _backlash(s: Any, p: Any) -> None:
    """Track reversals of the joint; within the gap after one the tendons do not reach it."""
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
def _load_torque(p: Any, q: float, omega: float) -> tuple[float, float]:
    """Torque that the load takes besides its inertia, and its derivative by the angle at constant speed."""
    if p.load == _SPRING:
        return p.load_damping * omega + p.load_stiffness * (q - p.load_rest), p.load_stiffness
    if p.load == _WEIGHT:
        a = q + p.weight_phase
        return p.load_damping * omega + p.weight * math.sin(a), p.weight * math.cos(a)
    return p.load_damping * omega, 0.0


@compiled
def _joint_losses(p: Any, q: float, omega: float, acceleration: float) -> float:
    """What the effects between the joint pulley and the load take from the tendons' torque."""
    return float(
        p.viscous * omega
        + p.viscous_difference * abs(omega)
        + p.inertia * acceleration
        + p.gravity * math.sin(q + p.gravity_phase)
        + p.spring * (q - p.spring_rest)
        - p.offset
    )


@compiled
def _step(
    s: Any,
    p: Any,
    ring: Any,
    slip: Any,
    curve: Any,
    chains: Any,
    motion: Any,
    bending: Any,
    temperature: Any,
    command: float,
    enabled: bool,
    max_speed: float,
    h: float,
) -> None:
    time = s.t + h
    since_start = time - s.started if s.started >= 0.0 else -1.0
    _torque_loop(s, p, command, enabled, max_speed, h)
    imposed = p.load == _IMPOSED
    q_j0, omega_j0, q_m0 = s.q_j, s.omega_j, s.q_m
    q_j = q_j0 + h * omega_j0
    if imposed:
        q_j, s.omega_j, s.acceleration_j = _imposed(p, motion, since_start)
    s.temperature = _table(temperature, since_start, 25.0)
    s.theta = p.theta * _table(bending, since_start, 1.0) + p.bending_per_angle * q_j
    s.pretension = _pretension(s, p, max(0.0, since_start))
    x = _friction_coefficient(s, p) * max(0.0, s.theta)
    x_a, x_b = x * (1.0 + 0.5 * p.asymmetry), x * (1.0 - 0.5 * p.asymmetry)
    if not p.distributed:  # there each contact has its own tension
        x_a, x_b = x_a * _tension_factor(p, s.t1), x_b * _tension_factor(p, s.t3)

    total = prepare_chains(p, s.pretension, s.theta, x_a, x_b, chains) if p.distributed else 0.0
    f = np.zeros(13)  # T1 T2 T3 T4, their derivatives by motor and joint displacement, z
    q_m = q_m0 + h * s.omega_m
    inertia, damping = p.motor_inertia / (h * h), p.motor_damping / h
    moving = (p.load_inertia + p.inertia) / (h * h)
    z_m, solved = s.z_m, False
    iteration = 0
    while iteration < _ITERATIONS and not solved:
        iteration += 1
        u, v = p.r_m * q_m, p.r_j * q_j
        if p.distributed:
            settled = chain_tensions(p, total, chains, u, v, f)
        else:
            settled = full_tensions(s, p, slip, curve, x_a, x_b, u, v, f)
        dz_m = 0.0
        if p.motor_coulomb > 0.0:
            z_m = s.z_m + (q_m - q_m0) / _MICRO
            dz_m = p.motor_coulomb / _MICRO
            if abs(z_m) >= 1.0:
                z_m, dz_m = math.copysign(1.0, z_m), 0.0
        residual_m = inertia * (q_m - q_m0 - h * s.omega_m) + damping * (q_m - q_m0)
        residual_m += p.r_m * (f[2] - f[0]) + p.motor_coulomb * z_m - s.tau_m
        m_m = inertia + damping + p.r_m * p.r_m * (f[8] - f[4]) + dz_m
        if imposed:
            solved = settled and abs(residual_m) < _TOLERANCE
            if not solved:
                q_m -= residual_m / m_m
            continue
        omega = (q_j - q_j0) / h
        tendon = p.r_j * (f[3] - f[1])
        share = 1.0 / (1.0 + s.z_j * p.load_friction * math.copysign(1.0, tendon))
        if s.in_gap:
            share = 0.0
        take, slope = _load_torque(p, q_j, omega)
        residual_j = moving * (q_j - q_j0 - h * omega_j0) + take + _joint_losses(p, q_j, omega, 0.0) - share * tendon
        m_j = p.r_m * p.r_j * (f[9] - f[5])
        j_m = -share * p.r_j * p.r_m * (f[10] - f[6])
        j_j = moving + slope + (p.load_damping + p.viscous + math.copysign(p.viscous_difference, omega)) / h
        j_j += p.gravity * math.cos(q_j + p.gravity_phase) + p.spring - share * p.r_j * p.r_j * (f[11] - f[7])
        solved = settled and abs(residual_m) < _TOLERANCE and abs(residual_j) < _TOLERANCE
        if not solved:
            determinant = m_m * j_j - m_j * j_m
            q_m -= (residual_m * j_j - residual_j * m_j) / determinant
            q_j -= (residual_j * m_m - residual_m * j_m) / determinant

    s.iterations += iteration
    if not solved:
        s.unsolved += 1
    s.t = time
    s.omega_m = (q_m - q_m0) / h
    s.q_m, s.z_m = q_m, z_m
    s.t1, s.t2, s.t3, s.t4 = f[0], f[1], f[2], f[3]
    if not imposed:
        s.omega_j = (q_j - q_j0) / h
        s.acceleration_j = (s.omega_j - omega_j0) / h
    s.q_j = q_j
    s.z = f[12]
    if p.distributed:
        taken, s.z = commit_chains(chains)
        s.dissipated += taken
    elif p.hysteresis != _ELASTIC and p.hysteresis_elements > 1:
        moved = q_m - q_m0 if p.hysteresis == _MOTOR else q_j - q_j0
        for i in range(p.hysteresis_elements):
            distance = p.hysteresis_distance * (i + 1) / p.hysteresis_elements
            slip[i] = min(1.0, max(-1.0, slip[i] + moved / distance))
    s.tau_tendon = p.r_j * (s.t4 - s.t2)
    s.z_j = min(1.0, max(-1.0, s.z_j + (q_j - q_j0) / _MICRO))
    transmitted = s.tau_tendon / (1.0 + s.z_j * p.load_friction * math.copysign(1.0, s.tau_tendon))
    if p.backlash > 0.0:
        _backlash(s, p)
        if s.in_gap:
            transmitted = 0.0
    s.tau_j = transmitted - _joint_losses(p, q_j, s.omega_j, s.acceleration_j)
    _sense(s, p, ring, h)


@compiled
def _sense(s: Any, p: Any, ring: Any, h: float) -> None:
    """Delay of the torque sensor, lag of the encoder."""
    if p.sensor_delay > 0.0:
        n = DELAY_SAMPLES
        head = (s.ring_head + 1) % n
        ring[0, head], ring[1, head] = s.t, s.tau_j
        s.ring_head = head
        wanted = s.t - p.sensor_delay
        newer = head
        value = s.tau_j
        for back in range(1, n):
            older = (head - back) % n
            if ring[0, older] <= wanted:
                w = (wanted - ring[0, older]) / (ring[0, newer] - ring[0, older])
                value = (1.0 - w) * ring[1, older] + w * ring[1, newer]
                break
            newer = older
        s.tau_sensed = value
    else:
        s.tau_sensed = s.tau_j
    gain = 1.0 if p.velocity_lag <= 0.0 else 1.0 - math.exp(-h / p.velocity_lag)
    s.q_lagged += (s.q_j - s.q_lagged) * gain
    s.omega_lagged += (s.omega_j - s.omega_lagged) * gain
