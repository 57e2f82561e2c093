"""A model's effects in the order of composition: one object per stage, built from the names of the catalogue.

Both pipelines go through here: `tsa_ctrl.model.predict` with arrays, `tsa_ctrl.model.feedforward` with floats.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeVar

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model import path
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.friction import StribeckFriction, TensionDependentFriction, ThermalFrictionDrift
from tsa_ctrl.model.effects.joint import (
    DirectionAsymmetricFriction,
    GravityLoad,
    Inertia,
    JointStiffness,
    TorqueOffset,
    ViscousFriction,
)
from tsa_ctrl.model.effects.load import LoadDependentFriction
from tsa_ctrl.model.effects.memory import Backlash, PreslidingHysteresis, TransportDelay
from tsa_ctrl.model.effects.motor import MotorSideFriction, TorqueConstantError, TorqueRipple, VelocityLag
from tsa_ctrl.model.effects.pretension import (
    ConfigurationDependentBending,
    PretensionRelaxation,
    StiffnessNonlinearity,
)
from tsa_ctrl.model.effects.state import State
from tsa_ctrl.model.effects.transmission import (
    Elongating,
    ElongationCoupling,
    FourTensions,
    SheathAsymmetry,
    TendonSlack,
    Transmission,
)
from tsa_ctrl.model.functions import F, Functions
from tsa_ctrl.model.parameters import Effects, TendonSheath

T = TypeVar("T")

EFFECTS: Mapping[str, type[Any]] = MappingProxyType(
    {
        "velocity_lag": VelocityLag,
        "torque_constant_error": TorqueConstantError,
        "torque_ripple": TorqueRipple,
        "motor_side_friction": MotorSideFriction,
        "configuration_dependent_bending": ConfigurationDependentBending,
        "stiffness_nonlinearity": StiffnessNonlinearity,
        "pretension_relaxation": PretensionRelaxation,
        "stribeck_friction": StribeckFriction,
        "thermal_friction_drift": ThermalFrictionDrift,
        "tension_dependent_friction": TensionDependentFriction,
        "presliding_hysteresis": PreslidingHysteresis,
        "sheath_asymmetry": SheathAsymmetry,
        "tendon_slack": TendonSlack,
        "elongation_coupling": ElongationCoupling,
        "load_dependent_friction": LoadDependentFriction,
        "backlash": Backlash,
        "viscous_friction": ViscousFriction,
        "direction_asymmetric_friction": DirectionAsymmetricFriction,
        "inertia": Inertia,
        "gravity_load": GravityLoad,
        "joint_stiffness": JointStiffness,
        "torque_offset": TorqueOffset,
        "transport_delay": TransportDelay,
    }
)

MotorTorqueEffect = TorqueConstantError | TorqueRipple | MotorSideFriction
FrictionEffect = StribeckFriction | ThermalFrictionDrift
JointEffect = ViscousFriction | DirectionAsymmetricFriction | Inertia | GravityLoad | JointStiffness | TorqueOffset


@dataclass(frozen=True)
class Stack:
    """The effects of one model, by stage; None or empty where there is none."""

    velocity_lag: VelocityLag | None
    motor_torque: tuple[MotorTorqueEffect, ...]
    bending: ConfigurationDependentBending | None
    stiffness: StiffnessNonlinearity | None
    relaxation: PretensionRelaxation | None
    friction: tuple[FrictionEffect, ...]
    tension_dependence: TensionDependentFriction | None
    presliding: PreslidingHysteresis | None
    asymmetry: SheathAsymmetry | None
    slack: TendonSlack | None
    elongation: ElongationCoupling | None
    load: LoadDependentFriction | None
    backlash: Backlash | None
    joint: tuple[JointEffect, ...]
    delay: TransportDelay | None

    @classmethod
    def of(cls, effects: Effects, source: str = "") -> Stack:
        """Build from validated `[effects.NAME]` tables; UsageError when two of them cannot stand together."""
        for name in effects:
            clash = [other for other in CATALOGUE[name].excludes if other in effects]
            if clash:
                raise UsageError(
                    f"{source or 'model'}: [effects.{name}] cannot be combined with [effects.{clash[0]}]; remove one"
                )
        present = {name: EFFECTS[name](**effects[name]) for name in CATALOGUE if name in effects}
        one = _Picker(present)
        return cls(
            velocity_lag=one.of_type(VelocityLag),
            motor_torque=tuple(e for e in present.values() if isinstance(e, MotorTorqueEffect)),
            bending=one.of_type(ConfigurationDependentBending),
            stiffness=one.of_type(StiffnessNonlinearity),
            relaxation=one.of_type(PretensionRelaxation),
            friction=tuple(e for e in present.values() if isinstance(e, FrictionEffect)),
            tension_dependence=one.of_type(TensionDependentFriction),
            presliding=one.of_type(PreslidingHysteresis),
            asymmetry=one.of_type(SheathAsymmetry),
            slack=one.of_type(TendonSlack),
            elongation=one.of_type(ElongationCoupling),
            load=one.of_type(LoadDependentFriction),
            backlash=one.of_type(Backlash),
            joint=tuple(e for e in present.values() if isinstance(e, JointEffect)),
            delay=one.of_type(TransportDelay),
        )

    def transmission(self, model: TendonSheath) -> Transmission:
        """What stands between the motor's pulley and the joint's."""
        radii = (model.motor_pulley_radius, model.joint_pulley_radius)
        if self.elongation is not None:
            return Elongating(radii, model.series_length / model.unstrained_length, self.elongation)
        return FourTensions(radii, self.asymmetry, self.slack, self.tension_dependence)


@dataclass(frozen=True)
class _Picker:
    present: Mapping[str, object]

    def of_type(self, kind: type[T]) -> T | None:
        return next((effect for effect in self.present.values() if isinstance(effect, kind)), None)


def bending_and_pretension(functions: Functions[F], model: TendonSheath, stack: Stack, state: State[F]) -> tuple[F, F]:
    """Theta (rad, >= 0) and T_p (N, >= 0) after their effects."""
    theta = state.theta if stack.bending is None else stack.bending.bending(state.theta, state)
    pretension = path.pretension_at(functions, model, theta)
    if stack.stiffness is not None:
        pretension = functions.at_least(stack.stiffness.pretension(pretension, model.axial_stiffness), 0.0)
    if stack.relaxation is not None:
        pretension = functions.at_least(pretension * stack.relaxation.factor(functions, state), 0.0)
    return functions.at_least(theta, 0.0), pretension


def friction_angle(functions: Functions[F], model: TendonSheath, stack: Stack, state: State[F], theta: F) -> F:
    """x = mu Theta with the effects on mu; >= 0, since friction never drives."""
    x = model.friction_coefficient * theta
    for effect in stack.friction:
        x = x * effect.factor(functions, state)
    return functions.at_least(x, 0.0)
