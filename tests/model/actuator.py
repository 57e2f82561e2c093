"""The actuator and the logs that the tests of the model share."""

from __future__ import annotations

from typing import Any

import numpy as np

from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.signals import Signals

ACTUATOR = TendonSheath(
    motor_pulley_radius=0.020,
    joint_pulley_radius=0.025,
    axial_stiffness=60e3,
    unstrained_length=1.2,
    diameter=0.6e-3,
    contact_offset=0.4e-3,
    friction_coefficient=0.1,
    bending_angle=2.6,
    pretension=45.0,
)
LOSS = 2.0 * 45.0 * 0.025 * np.sinh(0.26)  # N*m, friction torque 2 T_p r_J sinh x
SLOPE = 0.025 / 0.020 * np.cosh(0.26)  # slope of (3.55), dimensionless


def signals(t: Array, omega: Array, **columns: Array) -> Signals:
    """Return a log with this velocity (rad/s). The motor torque is 0 unless it is given."""
    return Signals(**{"t": t, "omega_j": omega, "tau_m": np.zeros_like(t), **columns})


def with_effect(name: str, **parameters: Any) -> TendonSheath:
    return ACTUATOR.with_effects({name: parameters})
