"""Shaking the motor a little: a fast sweep on top of a slow torque, which shows delay, inertia and stiffness.

A sweep passes every frequency so quickly that nothing rings up, and comes back at another place of the joint's motion.
It is small beside what the joint slides with; the slow torque keeps a joint moving that nobody else moves.
"""

from __future__ import annotations

import numpy as np

from tsa_ctrl.tune.excitation import RAMP, Waveform

SHARE = 0.04  # of the torque allowed at the joint
LOWEST = 10.0  # Hz
HIGHEST = 0.27  # of the loop's rate; the hold of a period blurs what is faster
SWEEP = 1.1  # s of one, no fraction of a step


def shaken(slow: Waveform, peak: float, period: float) -> Waveform:
    """The slow waveform with sweeps of `peak` N*m on it, at the loop's `period` (s)."""
    t = np.arange(0.0, slow.seconds, period)
    since = np.mod(t, SWEEP)
    highest = HIGHEST / period
    phase = 2.0 * np.pi * (LOWEST + 0.5 * (highest - LOWEST) / SWEEP * since) * since
    edge = 0.5 * (1.0 - np.cos(np.pi * np.clip(np.minimum(t, t[-1] - t) / RAMP, 0.0, 1.0)))
    return Waveform(t, np.interp(t, slow.t, slow.tau_j_des) + peak * edge * np.sin(phase))


def fastest(peak: float, period: float) -> float:
    """N*m/s that the set-point must be let change, for the sweep's last frequency."""
    return 2.0 * np.pi * HIGHEST / period * peak * 1.5
