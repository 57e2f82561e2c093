"""List the effects by which measured data differ from (3.55)-(3.56), in the order of composition.

An effect is a class with its formulas and its `specification`. All parts of the software use these classes, except that
the plant has its own formulas.
"""

from __future__ import annotations

from typing import Any

from tsa_ctrl.model.effects.custom import Custom
from tsa_ctrl.model.effects.friction import (
    LoadDependentFriction,
    StribeckFriction,
    TensionDependentFriction,
    ThermalFrictionDrift,
)
from tsa_ctrl.model.effects.joint import (
    DirectionAsymmetricFriction,
    GravityLoad,
    Inertia,
    JointStiffness,
    TorqueOffset,
    ViscousFriction,
)
from tsa_ctrl.model.effects.lever import PulleyEccentricity
from tsa_ctrl.model.effects.memory import Backlash, PreslidingHysteresis, TorqueSensorLag, TransportDelay
from tsa_ctrl.model.effects.motor import (
    MotorSideFriction,
    TorqueConstantError,
    TorqueRipple,
    TorqueSaturation,
    VelocityLag,
)
from tsa_ctrl.model.effects.pretension import (
    ConfigurationDependentBending,
    PretensionPerJointAngle,
    PretensionRelaxation,
    RoutingByJoint,
    StiffnessNonlinearity,
)
from tsa_ctrl.model.effects.stretch import JointPlay, PulleySlip, SeriesSpring, TendonCreep
from tsa_ctrl.model.effects.transmission import ElongationCoupling, SheathAsymmetry, TendonSlack

EFFECTS: tuple[type[Any], ...] = (
    VelocityLag,
    TorqueSaturation,
    TorqueConstantError,
    TorqueRipple,
    MotorSideFriction,
    ConfigurationDependentBending,
    RoutingByJoint,
    PretensionPerJointAngle,
    StiffnessNonlinearity,
    PretensionRelaxation,
    StribeckFriction,
    ThermalFrictionDrift,
    TensionDependentFriction,
    PreslidingHysteresis,
    SheathAsymmetry,
    TendonSlack,
    ElongationCoupling,
    LoadDependentFriction,
    Backlash,
    PulleyEccentricity,
    ViscousFriction,
    DirectionAsymmetricFriction,
    Inertia,
    GravityLoad,
    JointStiffness,
    TorqueOffset,
    Custom,
    TorqueSensorLag,
    TransportDelay,
    SeriesSpring,
    TendonCreep,
    PulleySlip,
    JointPlay,
)
