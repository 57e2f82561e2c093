"""Create a random tendon-sheath rig with its true values and the wrong nominal values for a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Rig:
    """Two tendons between a motor and a joint pulley, SI units. `pretension` applies at `bending` without torque."""

    motor_radius: float
    joint_radius: float
    axial_stiffness: float
    length: float
    diameter: float
    contact_offset: float
    mu: float
    bending: float
    pretension: float
    series_stiffness: float | None = None

    @property
    def x(self) -> float:
        return self.mu * self.bending

    @property
    def tendon_stiffness(self) -> float:
        """Return the stiffness of one tendon in series with its spring, N/m."""
        compliance = self.length / self.axial_stiffness
        if self.series_stiffness:
            compliance += 1.0 / self.series_stiffness
        return 1.0 / compliance

    @property
    def tension_per_bending(self) -> float:
        """Return the change of pretension per wrap angle, N/rad."""
        return self.tendon_stiffness * (self.contact_offset + 0.5 * self.diameter)

    @property
    def torque_limit(self) -> float:
        """Return the motor torque at which one tendon goes slack, N·m."""
        return 2.0 * self.pretension * self.motor_radius


def draw_rig(rng: np.random.Generator, x_range: tuple[float, float] = (0.12, 0.9)) -> Rig:
    """Return a random rig of plausible size: radii from 8 mm, pretension 15-150 N, friction angle within `x_range`."""
    bending = rng.uniform(1.2, 6.0)
    motor_radius = log_uniform(rng, 0.008, 0.04)
    return Rig(
        motor_radius=motor_radius,
        joint_radius=motor_radius * log_uniform(rng, 0.7, 1.8),
        axial_stiffness=log_uniform(rng, 8e3, 9e4),
        length=rng.uniform(0.4, 2.0),
        diameter=rng.uniform(0.4e-3, 1.2e-3),
        contact_offset=rng.uniform(0.1e-3, 0.6e-3) if rng.random() < 0.5 else 0.0,
        mu=rng.uniform(*x_range) / bending,
        bending=bending,
        pretension=log_uniform(rng, 15.0, 150.0),
        series_stiffness=log_uniform(rng, 3e3, 5e4) if rng.random() < 0.4 else None,
    )


def draw_nominal(rng: np.random.Generator, rig: Rig) -> Rig:
    """Return the nominal rig: friction and pretension are wrong by up to 20 % each, and all other values are right."""
    x_error, tension_error = rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2)
    return replace(rig, mu=rig.mu / (1.0 + x_error), pretension=rig.pretension / (1.0 + tension_error))


def model_file(nominal: Rig, state_uncertainty: bool = False) -> str:
    """Return the nominal rig as the text of an actuator model file."""
    series = f"series_stiffness = {nominal.series_stiffness!r}\n" if nominal.series_stiffness else ""
    uncertainty = "\n[uncertainty]\nfriction_angle = 0.25\npretension = 0.25\n" if state_uncertainty else ""
    return (
        f"[actuator]\nmotor_pulley_radius = {nominal.motor_radius!r}\njoint_pulley_radius = {nominal.joint_radius!r}\n"
        f"\n[tendon]\naxial_stiffness = {nominal.axial_stiffness!r}\nunstrained_length = {nominal.length!r}\n"
        f"diameter = {nominal.diameter!r}\n{series}"
        f"\n[sheath]\nfriction_coefficient = {nominal.mu!r}\nbending_angle = {nominal.bending!r}\n"
        f"contact_offset = {nominal.contact_offset!r}\n"
        f"\n[pretension]\nvalue = {nominal.pretension!r}\n{uncertainty}"
    )


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
