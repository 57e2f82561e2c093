"""A joint that swings under torques of both signs, for synthetic logs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tests.model.actuator import ACTUATOR

Array = NDArray[np.float64]
PERIOD = 4e-3  # s
NOMINAL = dataclasses.replace(ACTUATOR, source="nominal.toml")
RATIO = ACTUATOR.joint_pulley_radius / ACTUATOR.motor_pulley_radius
HALF_LOOP = 2.0 * ACTUATOR.pretension * ACTUATOR.joint_pulley_radius * math.sinh(ACTUATOR.friction_angle)


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


def recorded(
    rng: np.random.Generator,
    count: int,
    noise: float,
    sensor: Callable[[Array], Array] = lambda tau: tau,
    factor: Array | float = 1.0,
) -> dict[str, Array]:
    """Return the log of a swinging joint.

    Args:
        rng: random numbers of motion and noise.
        count: samples.
        noise: of the joint torque, N*m.
        sensor: maps the joint torque (N*m) to the measured torque.
        factor: of the friction, (count,).
    """
    t = PERIOD * np.arange(count)
    q, omega, tau_m = swinging(rng, t)
    tendons = RATIO * math.cosh(ACTUATOR.friction_angle) * tau_m - HALF_LOOP * factor * np.sign(omega)
    measured = sensor(tendons) + rng.normal(0.0, noise, count)
    return {"t": t, "tau_m": tau_m, "tau_j": measured, "omega_j": omega, "q_j": q}
