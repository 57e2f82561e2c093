"""What the simulated joint has beyond the plain full model, at the level of torques, tensions and friction.

The plant's own equations of the catalogue of effects (and of the drive's torque loop), once per sub-step: motor side,
pretension, friction coefficient, joint side, sensors. Where a definition says sign(omega), a sign that builds up over
a milliradian stands here, so that standstill is possible.
"""

from __future__ import annotations

import math
from typing import Any

from tsa_ctrl.plant.compiled import compiled
from tsa_ctrl.plant.state import DELAY_SAMPLES

MICRO = 1e-3  # rad over which Coulomb friction of motor and joint builds up
_MIN_TENSION = 0.05  # of the reference tension, bound of tension_dependent_friction


@compiled
def torque_loop(s: Any, p: Any, command: float, enabled: bool, max_speed: float, h: float) -> None:
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
def pretension(s: Any, p: Any, time: float) -> float:
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
def friction_coefficient(s: Any, p: Any) -> float:
    """mu with the effects that change it."""
    mu = p.friction
    if p.static_excess != 0.0:
        mu *= 1.0 + p.static_excess * math.exp(-(abs(s.omega_j / p.stribeck_velocity) ** p.stribeck_shape))
    if p.temperature_coefficient != 0.0:
        mu *= max(0.0, 1.0 + p.temperature_coefficient * (s.temperature - p.reference_temperature))
    return float(mu)


@compiled
def tension_factor(p: Any, tension: float) -> float:
    """Factor on the friction by the tension (tension_dependent_friction)."""
    if p.tension_exponent == 0.0:
        return 1.0
    ratio = max(tension, _MIN_TENSION * p.reference_tension) / p.reference_tension
    return float(ratio ** (-p.tension_exponent))


@compiled
def track_backlash(s: Any, p: Any) -> None:
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
def joint_losses(p: Any, q: float, omega: float, acceleration: float) -> float:
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
def sense(s: Any, p: Any, ring: Any, h: float) -> None:
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
