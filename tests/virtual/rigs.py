"""Draw random rigs for tuning and benchmarks, whose parameters all differ from the nominal file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import TendonSheath

OFF = 0.2  # nominal over true, minus 1, of friction, pretension and stiffness
INERTIA = (3e-5, 6e-4)  # kg*m^2 at the motor pulley: ringing at 180 to 40 Hz on these tendons
STIFFNESS = (0.6, 1.8)  # factors on the demo's tendons
DELAYS = (1, 2, 3)  # whole periods from measurement to torque; 1 corresponds to `rpdo = "sync"`
CURVATURES = ("uniform", "motor_end", "joint_end", "s_bent")


@dataclass(frozen=True)
class Drawn:
    """One rig: `factors` are true over nominal, `stiffness` is the nominal axial stiffness in N."""

    number: int
    factors: Mapping[str, float]
    stiffness: float
    curvature: str
    inertia: float  # kg*m^2
    delay: int  # periods

    @property
    def nominal(self) -> TendonSheath:
        """Return the model of the controller's file."""
        model = NOMINAL.recalibrated(NOMINAL.friction_angle, NOMINAL.pretension)
        return dataclasses.replace(_with_stiffness(model, self.stiffness), bending_centre=None)

    @property
    def truth(self) -> TendonSheath:
        """Return the model of the plant, without any effect."""
        x, tension = self.factors["friction_coefficient"], self.factors["pretension"]
        model = NOMINAL.recalibrated(NOMINAL.friction_angle * x, NOMINAL.pretension * tension)
        return _with_stiffness(model, self.stiffness * self.factors["axial_stiffness"])

    def axis(self) -> dict[str, dict[str, Any]]:
        """Return the tables of the plant's axis."""
        return {
            "perturbation": dict(self.factors),
            "tendon": {"kind": "distributed", "curvature": self.curvature},
            "motor": {"inertia": self.inertia},
            "drive": {"delay_periods": self.delay - 1},
        }

    def __str__(self) -> str:
        return f"{self.curvature}, J_M {self.inertia:.1e} kg*m^2, {self.stiffness:.0f} N, delay {self.delay}"


def draw(seed: int, number: int, curvature: str | None = None) -> Drawn:
    """Return the rig of this number. `curvature` replaces the drawn profile."""
    rng = np.random.default_rng([seed, number])
    names = ("friction_coefficient", "pretension", "axial_stiffness")
    factors = {name: float(1.0 / (1.0 + rng.uniform(-OFF, OFF))) for name in names}
    stiffness = NOMINAL.axial_stiffness * math.exp(rng.uniform(*np.log(STIFFNESS)))
    inertia = math.exp(rng.uniform(*np.log(INERTIA)))
    drawn, delay = str(rng.choice(CURVATURES)), int(rng.choice(DELAYS))
    return Drawn(number, factors, stiffness, curvature or drawn, inertia, delay)


def _with_stiffness(model: TendonSheath, stiffness: float) -> TendonSheath:
    return dataclasses.replace(model, axial_stiffness=stiffness)
