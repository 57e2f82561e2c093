"""What lies between the torque that is asked and the one that acts, and between the joint and its sensors."""

from __future__ import annotations

import math
from typing import Any

from tsa_ctrl.plant.compiled import compiled
from tsa_ctrl.plant.effects import lengths_beside
from tsa_ctrl.plant.state import DELAY_SAMPLES


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
def sense(s: Any, p: Any, ring: Any, h: float) -> None:
    """Delay of the torque sensor, lag of the encoder, and what lies between encoders and tendons."""
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
    length, behind = lengths_beside(s, p, h)
    s.q_m_seen = s.q_m + length / p.r_m
    s.q_lagged += (s.q_j - behind - s.q_lagged) * gain
    s.omega_lagged += (s.omega_j - s.omega_lagged) * gain
