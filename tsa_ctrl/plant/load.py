"""What the joint drives: masses by the name of the load, and the script of a hand that holds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.plant.settings import HandRow, JointSettings
from tsa_ctrl.plant.state import Load


@dataclass(frozen=True)
class Mass:
    """kg*m^2, N*m*s/rad, N*m: of a load unless its settings say otherwise."""

    inertia: float
    damping: float
    weight: float


PLAIN = Mass(0.02, 0.05, 1.0)
LIMB = Mass(0.05, 0.1, 4.0)  # a forearm, or a shank without its foot, with its tissue's damping
_KINDS = {
    "imposed": Load.IMPOSED,
    "held": Load.IMPOSED,
    "free": Load.FREE,
    "spring": Load.SPRING,
    "weight": Load.WEIGHT,
    "limb": Load.WEIGHT,
    "wearer": Load.WEIGHT,
}
# s, N*m/rad, N*m*s/rad, rad: holds, lifts, holds, lets the limb swing, takes it again, pulls it back, holds.
WEARER: tuple[HandRow, ...] = (
    (0.0, 15.0, 1.0, 0.0),
    (1.5, 15.0, 1.0, 0.0),
    (3.0, 15.0, 1.0, 0.6),
    (4.0, 15.0, 1.0, 0.6),
    (4.05, 0.0, 0.0, 0.6),
    (7.0, 0.0, 0.0, 0.0),
    (7.5, 15.0, 1.0, 0.0),
    (9.0, 15.0, 1.0, -0.4),
    (10.5, 15.0, 1.0, 0.0),
    (12.0, 15.0, 1.0, 0.0),
)


def load_parameters(joint: JointSettings) -> dict[str, float]:
    """The load's parameters of the mechanics."""
    mass = LIMB if joint.load in ("limb", "wearer") else PLAIN
    return {
        "load": _KINDS[joint.load],
        "load_inertia": mass.inertia if joint.inertia is None else joint.inertia,
        "load_damping": mass.damping if joint.damping is None else joint.damping,
        "load_stiffness": joint.stiffness,
        "load_rest": joint.rest_angle,
        "weight": mass.weight if joint.weight_torque is None else joint.weight_torque,
        "weight_phase": joint.weight_phase,
        "hand_factor": 1.0,
        "hand_repeat": int(joint.hand_repeat),
    }


def hand_table(joint: JointSettings) -> NDArray[np.float64]:
    """The hand's script, (4, n): s, N*m/rad, N*m*s/rad, rad; n = 0 without a hand."""
    rows = joint.hand or (WEARER if joint.load == "wearer" else ())
    return np.ascontiguousarray(np.array(rows, dtype=np.float64).reshape(-1, 4).T)
