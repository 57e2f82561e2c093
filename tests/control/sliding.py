"""Calculate synthetic data of a sliding joint from its four tensions, without code of the package."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.model.parameters import TendonSheath

PERIOD = 1e-3
R_M, R_J = 0.020, 0.025


def actuator() -> TendonSheath:
    return TendonSheath(
        motor_pulley_radius=R_M,
        joint_pulley_radius=R_J,
        axial_stiffness=6e3,
        unstrained_length=1.2,
        diameter=0.6e-3,
        friction_coefficient=0.10,
        bending_angle=2.6,
        contact_offset=0.4e-3,
        pretension=45.0,
    )


@dataclass
class Sliding:
    """A joint that moves along a sine under a sinusoidal torque, with the noise and quantisation of a drive and strain
    gauge.
    """

    x: float
    pretension: float
    seconds: float
    load: float = 0.8  # N*m, amplitude at the joint
    offset: float = 0.0  # N*m, offset of the torque sensor
    noise: float = 5e-3  # N*m, noise of both torques
    seed: int = 7

    def samples(self) -> Iterator[tuple[float, float, float, float]]:
        """Yield sigma, omega_j (rad/s), tau_m and tau_j (N*m) of every cycle."""
        random = np.random.default_rng(self.seed)
        for n in range(round(self.seconds / PERIOD)):
            t = n * PERIOD
            omega = 1.2 * math.sin(2.0 * math.pi * 0.6 * t)
            sigma = max(-1.0, min(1.0, omega / 0.05))
            tau_j = self.load * math.sin(2.0 * math.pi * 0.23 * t + 0.4)
            x = sigma * self.x
            # T2 = T1 e^x, T4 = T3 e^-x, T3 - T1 = tau_M/r_M, T3 + T1 = 2 T_p, tau_J = r_J (T4 - T2), solved for tau_M
            tau_m = R_M * (tau_j / R_J + self.pretension * (math.exp(x) - math.exp(-x))) / math.cosh(x)
            tau_m = round((tau_m + random.normal(0.0, self.noise)) * 1e3) * 1e-3
            yield sigma, omega, tau_m, tau_j + self.offset + random.normal(0.0, self.noise)
