"""Logs of sheaths with an arbitrary curvature profile.

The capstan equation is integrated along the tendons. No code of the package is used.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tests.model.capstan import Pair

Array = NDArray[np.float64]

RATE = 500.0  # Hz


def motion(seconds: float) -> tuple[Array, Array, Array]:
    """Return time t (s), joint angle q_j (rad) and joint velocity omega_j (rad/s), (n,) each.

    The joint reverses at two speeds.
    """
    t = np.arange(round(seconds * RATE)) / RATE
    q = 0.5 * np.sin(2 * np.pi * 0.31 * t) + 0.2 * np.sin(2 * np.pi * 0.73 * t + 1.0)
    return t, q, np.gradient(q, t)


def record(
    pair: Pair,
    seed: int,
    *,
    seconds: float = 60.0,
    more_pretension: float = 0.0,
    tensions: bool = False,
    viscous: float = 0.0,
) -> dict[str, Array]:
    """Return the columns of a log with motor torques of both signs.

    The noise is 2 mN*m on the motor torque and 5 mN*m on the joint torque.
    """
    rng = np.random.default_rng(seed)
    t, q, omega = motion(seconds)
    tau_m = 0.8 * np.sin(2 * np.pi * 0.11 * t) + 0.3 * np.sin(2 * np.pi * 0.27 * t)
    acting = dataclasses.replace(pair, pretension=pair.pretension + more_pretension)
    tau_j, t1 = np.empty_like(t), np.empty_like(t)
    for sigma in (-1.0, 1.0):  # at a fixed direction, joint torque and tension are linear in tau_M
        now = np.sign(omega) == sigma
        rest, one = acting.joint_torque(0.0, sigma), acting.joint_torque(1.0, sigma)
        tau_j[now] = rest + (one - rest) * tau_m[now]
        slack, pulled = acting.motor_tensions(0.0, sigma)[0], acting.motor_tensions(1.0, sigma)[0]
        t1[now] = slack + (pulled - slack) * tau_m[now]
    columns = {
        "t": t,
        "tau_m": tau_m + rng.normal(0.0, 2e-3, t.size),
        "tau_j": tau_j - viscous * omega + rng.normal(0.0, 5e-3, t.size),
        "omega_j": omega,
        "q_j": q,
    }
    return {**columns, "t1": t1, "t3": t1 + tau_m / pair.motor_radius} if tensions else columns
