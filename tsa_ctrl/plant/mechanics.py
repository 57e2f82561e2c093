"""Integrate one axis by implicit Euler, compiled: torque loop, motor, pair of tendon-sheaths, joint, load.

The unknowns of a sub-step are the motor angle and, unless the motion is prescribed, the joint angle at its end:

    J_M (omega_M' - omega_M) / h + b_M omega_M' + r_M (T3' - T1') + tau_c z_M' = tau_M'
    J   (omega_J' - omega_J) / h + load(q_J', omega_J')                       = tau_J'(T2', T4')

They are solved by Newton's method with the exact derivatives of the tensions, so that stiff tendons and a motor without
inertia need no smaller step. The motor angle is kept between converging bounds, because friction makes the torque
balance steep at a reversal and flat elsewhere. Newton's method alone would oscillate.
Signs: tau_M = r_M (T3 - T1), tau_J = r_J (T4 - T2); tendon b (T3, T4) pulls the joint forward.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.plant.chain import chain_tensions, commit_chains, prepare_chains
from tsa_ctrl.plant.compiled import compiled
from tsa_ctrl.plant.effects import (
    MICRO,
    arm,
    formula,
    friction_coefficient,
    joint_losses,
    lengths_beside,
    pretension,
    tension_factor,
    track_backlash,
    wound,
)
from tsa_ctrl.plant.full import commit_full, full_tensions
from tsa_ctrl.plant.state import DELAY_SAMPLES, MOST_ANGLE, MOST_SPEED, MOST_TENSION, Load


@compiled
def table_value(table: Any, x: float, before: float) -> float:
    """Interpolate a table linearly, constant beyond the ends; return `before` if the table is empty."""
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
def hand(s: Any, p: Any, table: Any, time: float) -> None:
    """Write stiffness, damping, angle and speed of the hand at `time` (s since the start) to the state.

    Stiffness and damping are linear between rows. The angle is a smooth step between rows, with speed 0 at each row.
    """
    n = table.shape[1]
    if n == 0:
        return
    last = table[0, n - 1]
    if p.hand_repeat and time > last > 0.0:
        time = time % last
    i = 1
    while i < n and time >= table[0, i]:
        i += 1
    if i >= n or time <= table[0, 0]:
        row = n - 1 if i >= n else 0
        stiffness, damping, s.hand_angle, s.hand_speed = table[1, row], table[2, row], table[3, row], 0.0
    else:
        width = table[0, i] - table[0, i - 1]
        y = (time - table[0, i - 1]) / width
        stiffness = (1.0 - y) * table[1, i - 1] + y * table[1, i]
        damping = (1.0 - y) * table[2, i - 1] + y * table[2, i]
        way = table[3, i] - table[3, i - 1]
        s.hand_angle = table[3, i - 1] + way * y * y * (3.0 - 2.0 * y)
        s.hand_speed = way * 6.0 * y * (1.0 - y) / width
    s.hand_stiffness, s.hand_damping = p.hand_factor * stiffness, p.hand_factor * damping


@compiled
def imposed_motion(p: Any, motion: Any, time: float) -> tuple[float, float, float]:
    """Return angle, speed and acceleration of the prescribed motion (rad, rad/s, rad/s^2).

    `time`: s since the motion's start. Until the motion has started, the joint rests at the first angle.
    """
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
def torque_loop(s: Any, p: Any, command: float, enabled: bool, max_speed: float, h: float) -> None:
    """Advance the drive's torque loop by `h` s, with its lag, gain error, ripple and limits.

    Beyond the speed limit, the torque in the direction of motion fades to 0. The commanded torque becomes `tau_m`,
    the torque that acts on the motor pulley.
    """
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
    s.tau_m = min(p.saturation, max(-p.saturation, s.torque_loop)) * p.torque_gain
    if p.ripple != 0.0:
        s.tau_m += p.ripple * math.sin(p.ripple_cycles * s.q_m + p.ripple_phase)


@compiled
def sense(s: Any, p: Any, ring: Any, h: float) -> None:
    """Advance by `h` s the torque sensor's lag and delay, the joint encoder's lag, and the motor encoder's angle.

    Compliance, creep, slip and backlash between encoders and tendons are included (`lengths_beside`).
    """
    if p.sensor_lag > 0.0:
        s.tau_lagged += (s.tau_j - s.tau_lagged) * (1.0 - math.exp(-h / p.sensor_lag))
    else:
        s.tau_lagged = s.tau_j
    if p.sensor_delay > 0.0:
        n = DELAY_SAMPLES
        head = (s.ring_head + 1) % n
        ring[0, head], ring[1, head] = s.t, s.tau_lagged
        s.ring_head = head
        wanted = s.t - p.sensor_delay
        newer = head
        value = s.tau_lagged
        for back in range(1, n):
            older = (head - back) % n
            if ring[0, older] <= wanted:
                w = (wanted - ring[0, older]) / (ring[0, newer] - ring[0, older])
                value = (1.0 - w) * ring[1, older] + w * ring[1, newer]
                break
            newer = older
        s.tau_sensed = value
    else:
        s.tau_sensed = s.tau_lagged
    gain = 1.0 if p.velocity_lag <= 0.0 else 1.0 - math.exp(-h / p.velocity_lag)
    length, behind = lengths_beside(s, p, h)
    s.q_m_seen = s.q_m + length / p.r_m
    s.q_lagged += (s.q_j - behind - s.q_lagged) * gain
    s.omega_lagged += (s.omega_j - s.omega_lagged) * gain


_IMPOSED, _SPRING, _WEIGHT, _LIMB = int(Load.IMPOSED), int(Load.SPRING), int(Load.WEIGHT), int(Load.LIMB)
_ITERATIONS = 150
_CLOSED = 1e-14  # rad between the bounds of the motor angle, below which they have met
_TOLERANCE = 1e-8  # N*m
_EPSILON = 2.220446049250313e-16  # 1; rounding error of an angle over the angle


class Arrays(NamedTuple):
    """Hold the arrays of an axis, in addition to its records of state and parameters."""

    ring: NDArray[np.float64]  # (2, n): times and delivered torques, for the sensor's delay
    slip: NDArray[np.float64]  # (n,): Maxwell-slip elements of presliding_hysteresis
    curve: NDArray[np.float64]  # (2, n): fractions of length and of bending
    chains: NDArray[np.float64]  # (2, rows, contacts + 1): distributed tendons
    motion: NDArray[np.float64]  # (2, n): prescribed angle and speed on the grid
    bending: NDArray[np.float64]  # (2, n): times in s and factors on the bending angle
    temperature: NDArray[np.float64]  # (2, n): times in s and deg C
    formula: NDArray[np.float64]  # (4, n): operations and numbers of the plant file's formula
    memory: NDArray[np.float64]  # (n, 4): state of the formula
    hand: NDArray[np.float64]  # (4, n): times in s, N*m/rad, N*m*s/rad, rad
    joints: NDArray[np.float64]  # (3, n): joints that bend the sheaths: angle, speed, 1 for this axis's own joint
    gains: NDArray[np.float64]  # (2, n): rad/rad by tendon and joint
    starts: NDArray[np.int64]  # (2 n + 1,): first place in `points` of the table of each tendon and joint
    points: NDArray[np.float64]  # (2, m): all tables, with joint angle and wrap angle in rad


@compiled
def advance(
    state: Any, parameters: Any, arrays: Arrays, command: float, enabled: bool, max_speed: float, until: float
) -> None:
    """Advance the state record to time `until` (s) in equal sub-steps, none longer than the parameters' `step`.

    Stop early, with `beyond` set in the state, if a value leaves its range.

    Args:
        state: array of one record.
        parameters: array of one record.
        arrays: the other arrays of the axis.
        command: N*m at the motor pulley.
        enabled: True if the power stage is on.
        max_speed: rad/s of the motor.
        until: s.
    """
    s, p = state[0], parameters[0]
    span = until - s.t
    if span <= 0.0:
        return
    count = max(1, math.ceil(span / p.step - 1e-6))
    for _ in range(count):
        _step(s, p, arrays, command, enabled, max_speed, span / count)
        if not _in_range(s):
            s.beyond = 1
            return


@compiled
def _in_range(s: Any) -> bool:
    """Return True if angles, speeds and tensions are in the range for which the equations are solved; nan is not."""
    return (
        max(abs(s.q_m), abs(s.q_j)) <= MOST_ANGLE
        and max(abs(s.omega_m), abs(s.omega_j)) <= MOST_SPEED
        and max(s.t1, s.t2, s.t3, s.t4) <= MOST_TENSION
        and not math.isnan(s.q_m + s.q_j + s.omega_m + s.omega_j + s.t1 + s.t2 + s.t3 + s.t4)
    )


@compiled
def _load_torque(s: Any, p: Any, q: float, omega: float) -> tuple[float, float]:
    """Return the torque of load and hand without the inertia, and its derivative by the angle at constant speed."""
    taken = p.load_damping * omega - p.push
    taken += s.hand_stiffness * (q - s.hand_angle) + s.hand_damping * (omega - s.hand_speed)
    if p.load == _SPRING:
        return taken + p.load_stiffness * (q - p.load_rest), s.hand_stiffness + p.load_stiffness
    if p.load == _WEIGHT:
        a = q + p.weight_phase
        return taken + p.weight * math.sin(a), s.hand_stiffness + p.weight * math.cos(a)
    return taken, s.hand_stiffness


@compiled
def _routed(arrays: Arrays, tendon: int, ahead: float, q_j: float) -> float:
    """Return the wrap angle (rad) that the joints add, `ahead` s after their angles were exchanged.

    Other joints continue at the exchanged speed. The axis's own joint has the angle q_j.
    """
    added = 0.0
    n = arrays.joints.shape[1]
    for j in range(n):
        q = q_j if arrays.joints[2, j] != 0.0 else arrays.joints[0, j] + arrays.joints[1, j] * ahead
        added += arrays.gains[tendon, j] * q
        first, last = arrays.starts[tendon * n + j], arrays.starts[tendon * n + j + 1]
        if last > first:
            added += table_value(arrays.points[:, first:last], q, 0.0)
    return added


@compiled
def _environment(s: Any, p: Any, arrays: Arrays, time: float, ahead: float, q_j: float) -> tuple[float, float]:
    """Set temperature, bending and pretension at `time` (s since the start).

    Returns the friction angles of both tendons. `ahead`: s since the angles of the other joints were exchanged.
    """
    s.temperature = table_value(arrays.temperature, time, 25.0)
    common = p.theta * p.theta_factor * table_value(arrays.bending, time, 1.0) + p.bending_per_angle * q_j
    s.theta_a = common + _routed(arrays, 0, ahead, q_j)
    s.theta_b = common + _routed(arrays, 1, ahead, q_j)
    s.theta = 0.5 * (s.theta_a + s.theta_b)
    s.pretension_a = pretension(p, s.theta_a, max(0.0, time))
    s.pretension_b = pretension(p, s.theta_b, max(0.0, time))
    s.pretension = 0.5 * (s.pretension_a + s.pretension_b)
    mu = friction_coefficient(s, p)
    x_a = mu * max(0.0, s.theta_a) * (1.0 + 0.5 * p.asymmetry)
    x_b = mu * max(0.0, s.theta_b) * (1.0 - 0.5 * p.asymmetry)
    if not p.distributed:  # in a distributed tendon, each contact has its own tension
        x_a, x_b = x_a * tension_factor(p, s.t1), x_b * tension_factor(p, s.t3)
    return x_a, x_b


@compiled
def _motor_friction(s: Any, p: Any, q_m: float) -> tuple[float, float]:
    """Return the state of the motor's Coulomb friction at angle q_m, and the slope of its torque there."""
    if p.motor_coulomb <= 0.0:
        return 0.0, 0.0
    z = s.z_m + (q_m - s.q_m) / MICRO
    if abs(z) >= 1.0:
        return math.copysign(1.0, z), 0.0
    return z, p.motor_coulomb / MICRO


@compiled
def _share(s: Any, p: Any, tendon: float) -> float:
    """Return the share of the tendons' torque that passes the joint's load-dependent friction and its backlash."""
    if s.in_gap:
        return 0.0
    return float(1.0 / (1.0 + s.z_j * p.load_friction * math.copysign(1.0, tendon)))


@compiled
def _residuals(s: Any, p: Any, q_m: float, q_j: float, h: float, f: Any, r: Any) -> None:
    """Write the torque balances of motor and joint to r[0:2] and their derivatives by q_m and q_j to r[2:6].

    The tensions are written to f.
    """
    inertia, damping = p.motor_inertia / (h * h), p.motor_damping / h
    z_m, slope_m = _motor_friction(s, p, q_m)
    moved = q_m - s.q_m
    r[0] = inertia * (moved - h * s.omega_m) + damping * moved
    r[0] += p.r_m * (f[2] - f[0]) + p.motor_coulomb * z_m - s.tau_m
    r[2] = inertia + damping + p.r_m * p.r_m * (f[8] - f[4]) + slope_m
    if p.load == _IMPOSED or p.load == _LIMB:
        r[1] = r[3] = r[4] = 0.0
        r[5] = 1.0
        return
    inertia = (p.load_inertia + p.inertia) / (h * h)
    omega = (q_j - s.q_j) / h
    lever, by_angle = arm(p, q_j)
    tendon = lever * (f[3] - f[1])
    share = _share(s, p, tendon)
    taken, slope_j = _load_torque(s, p, q_j, omega)
    taken += 0.0 if p.formula_at_motor else s.taken
    r[1] = inertia * (q_j - s.q_j - h * s.omega_j) + taken + joint_losses(p, q_j, omega, 0.0) - share * tendon
    r[3] = p.r_m * lever * (f[9] - f[5])
    r[4] = -share * lever * p.r_m * (f[10] - f[6])
    damping = p.load_damping + s.hand_damping + p.viscous + math.copysign(p.viscous_difference, omega)
    r[5] = inertia + slope_j + damping / h
    r[5] += p.gravity * math.cos(q_j + p.gravity_phase) + p.spring
    r[5] -= share * (lever * lever * (f[11] - f[7]) + by_angle * (f[3] - f[1]))


@compiled
def _solve(
    s: Any, p: Any, arrays: Arrays, x_a: float, x_b: float, q_m: float, q_j: float, h: float, f: Any
) -> tuple[float, float]:
    """Return the angles of motor and joint at the end of the sub-step from initial guesses; write the tensions to f."""
    totals = (0.0, 0.0)
    if p.distributed:
        pretensions, thetas = (s.pretension_a, s.pretension_b), (s.theta_a, s.theta_b)
        totals = prepare_chains(p, pretensions, thetas, (x_a, x_b), arrays.chains)
    r = np.zeros(6)
    low, high = -np.inf, np.inf
    for iteration in range(_ITERATIONS):
        s.iterations += 1
        u, v = p.r_m * q_m, wound(p, q_j)
        if p.distributed:
            settled = chain_tensions(p, totals, arrays.chains, u, v, f)
        else:
            settled = full_tensions(s, p, arrays.slip, arrays.curve, x_a, x_b, u, v, f)
        _residuals(s, p, q_m, q_j, h, f, r)
        rounding = _EPSILON * (abs(r[2] * q_m) + abs(r[5] * q_j))  # N*m, exceeds the tolerance after many turns
        if settled and max(abs(r[0]), abs(r[1])) < max(_TOLERANCE, rounding):
            return q_m, q_j
        if high - low < _CLOSED:  # a change of the joint angle has moved the root out of the bounds
            low, high = -np.inf, np.inf
        reduced = r[0] - r[3] * r[1] / r[5]  # motor balance if the joint balance holds
        if reduced < 0.0:
            low = max(low, q_m)
        else:
            high = min(high, q_m)
        step_m = -reduced / (r[2] - r[3] * r[4] / r[5])
        if not low <= q_m + step_m <= high or (iteration % 3 == 2 and high - low < np.inf):
            step_m = 0.5 * (low + high) - q_m
        q_j -= (r[1] + r[4] * step_m) / r[5]
        q_m += step_m
    s.unsolved += 1
    return q_m, q_j


@compiled
def _step(s: Any, p: Any, arrays: Arrays, command: float, enabled: bool, max_speed: float, h: float) -> None:
    time = s.t + h
    since_start = time - s.started if s.started >= 0.0 else -1.0
    torque_loop(s, p, command, enabled, max_speed, h)
    if p.formula_at_motor:
        s.taken = formula(s, arrays.formula, arrays.memory, s.tau_m, s.z, since_start, h)
        s.tau_m -= s.taken
    ahead = time - s.exchanged
    imposed = p.load == _IMPOSED
    carried = p.load == _LIMB
    q_j = s.q_j + h * s.omega_j
    if imposed:
        q_j, s.omega_j, s.acceleration_j = imposed_motion(p, arrays.motion, since_start)
    else:
        hand(s, p, arrays.hand, since_start)
    if carried:
        q_j, s.omega_j, s.acceleration_j = s.limb_angle + ahead * s.limb_speed, s.limb_speed, s.limb_acceleration
    x_a, x_b = _environment(s, p, arrays, since_start, ahead, q_j)
    f = np.zeros(13)  # T1 T2 T3 T4, their derivatives by motor and joint displacement, z
    q_m, q_j = _solve(s, p, arrays, x_a, x_b, s.q_m + h * s.omega_m, q_j, h, f)

    s.t = time
    s.t1, s.t2, s.t3, s.t4 = f[0], f[1], f[2], f[3]
    if p.distributed:
        taken, s.z = commit_chains(arrays.chains)
        s.dissipated += taken
    else:
        commit_full(s, p, arrays.slip, q_m, q_j, f[12])
    s.z_m, _ = _motor_friction(s, p, q_m)
    s.omega_m = (q_m - s.q_m) / h
    s.q_m = q_m
    if not imposed:
        if not carried:
            omega = (q_j - s.q_j) / h
            s.acceleration_j = (omega - s.omega_j) / h
            s.omega_j = omega
        s.tau_outside = p.push - s.hand_stiffness * (q_j - s.hand_angle) - s.hand_damping * (s.omega_j - s.hand_speed)
    s.z_j = min(1.0, max(-1.0, s.z_j + (q_j - s.q_j) / MICRO))
    s.q_j = q_j
    s.tau_tendon = arm(p, q_j)[0] * (s.t4 - s.t2)
    if p.backlash > 0.0:
        track_backlash(s, p)
    arrives = _share(s, p, s.tau_tendon) * s.tau_tendon
    s.tau_j = arrives - joint_losses(p, q_j, s.omega_j, s.acceleration_j)
    if not p.formula_at_motor:
        s.taken = formula(s, arrays.formula, arrays.memory, arrives, s.z, since_start, h)
        s.tau_j -= s.taken
    sense(s, p, arrays.ring, h)
