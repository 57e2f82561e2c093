"""A joint that swings under torques of both signs, for synthetic logs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def swinging(rng: np.random.Generator, t: Array) -> tuple[Array, Array, Array]:
    """Return joint angle (rad), joint velocity (rad/s) and motor torque (N*m), (n,) each.

    Each is a sum of three sines.
    """
    q, omega, tau_m = np.zeros(len(t)), np.zeros(len(t)), np.zeros(len(t))
    for w in rng.uniform(1.5, 6.0, 3):
        a, phase = rng.uniform(0.2, 0.4), rng.uniform(0.0, 6.0)
        q += a * np.sin(w * t + phase)
        omega += a * w * np.cos(w * t + phase)
    for w in rng.uniform(0.7, 5.0, 3):
        tau_m += 0.25 * np.sin(w * t + rng.uniform(0.0, 6.0))
    return q, omega, tau_m
