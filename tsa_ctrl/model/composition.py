"""Build the effects of a model from the names of the catalogue, by stage and in the order of composition.

Both pipelines use this module: `tsa_ctrl.model.predict` with arrays, and `tsa_ctrl.model.feedforward` with floats.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.curvature import Profile
from tsa_ctrl.model.effects.custom import Custom
from tsa_ctrl.model.effects.friction import LoadDependentFriction, TensionDependentFriction
from tsa_ctrl.model.effects.lever import PulleyEccentricity, State
from tsa_ctrl.model.effects.memory import Backlash, PreslidingHysteresis
from tsa_ctrl.model.effects.motor import VelocityLag
from tsa_ctrl.model.effects.specification import Stage
from tsa_ctrl.model.effects.transmission import (
    Elongating,
    ElongationCoupling,
    FourTensions,
    SheathAsymmetry,
    TendonSlack,
    Transmission,
)
from tsa_ctrl.model.functions import Array, F, Functions
from tsa_ctrl.model.parameters import Effects, TendonSheath

T = TypeVar("T")


class MotorTorqueEffect(Protocol):
    """Convert the reported motor torque to the torque on the pulley, N*m."""

    def apply(self, functions: Functions[F], tau_m: F, state: State[F]) -> F: ...
    def invert(self, functions: Functions[F], tau_m: F, state: State[F]) -> F: ...


class BendingEffect(Protocol):
    """Change the bending angle, rad."""

    def bending(self, theta: F, state: State[F]) -> F: ...


class PretensionEffect(Protocol):
    """Change the pretension, N."""

    def pretension(self, functions: Functions[F], pretension: F, state: State[F], axial_stiffness: float) -> F: ...


class FrictionEffect(Protocol):
    """Multiply the friction coefficient by a factor."""

    def factor(self, functions: Functions[F], state: State[F]) -> F: ...


class JointEffect(Protocol):
    """Reduce the joint torque by the effect's torque, N*m."""

    def torque(self, functions: Functions[F], state: State[F]) -> F: ...


class SensorEffect(Protocol):
    """Convert the joint torque (N*m) at the times t (s) to the measured torque."""

    def apply(self, torque: Array, t: Array) -> Array: ...


class StretchEffect(Protocol):
    """Add a length (m) to the elongation that T3 - T1 and T4 - T2 (`ends`, N) cause."""

    def lengthens(self, functions: Functions[F], ends: tuple[F, F], joint_radius: float, state: State[F]) -> F: ...


@dataclass(frozen=True)
class Stack:
    """Hold the effects of one model by stage; None or empty for a stage without an effect."""

    velocity_lag: VelocityLag | None
    motor_torque: tuple[MotorTorqueEffect, ...]
    bending: tuple[BendingEffect, ...]
    pretension: tuple[PretensionEffect, ...]
    friction: tuple[FrictionEffect, ...]
    tension_dependence: TensionDependentFriction | None
    presliding: PreslidingHysteresis | None
    asymmetry: SheathAsymmetry | None
    slack: TendonSlack | None
    elongation: ElongationCoupling | None
    load: LoadDependentFriction | None
    backlash: Backlash | None
    lever: PulleyEccentricity | None
    joint: tuple[JointEffect, ...]
    custom: Custom | None
    sensor: tuple[SensorEffect, ...]
    stretch: tuple[StretchEffect, ...]

    @classmethod
    def of(cls, effects: Effects, source: str = "") -> Stack:
        """Return the effects of validated `[effects.NAME]` tables; raises UsageError if two exclude each other."""
        for name in effects:
            clash = [other for other in CATALOGUE[name].excludes if other in effects]
            if clash:
                raise UsageError(
                    f"{source or 'model'}: [effects.{name}] cannot be combined with [effects.{clash[0]}]; remove one"
                )
        present = _Present({name: spec.build(effects[name]) for name, spec in CATALOGUE.items() if name in effects})
        return cls(
            velocity_lag=present.one(VelocityLag),
            motor_torque=present.at(Stage.MOTOR_TORQUE),
            bending=present.at(Stage.BENDING),
            pretension=present.at(Stage.PRETENSION),
            friction=present.at(Stage.FRICTION),
            tension_dependence=present.one(TensionDependentFriction),
            presliding=present.one(PreslidingHysteresis),
            asymmetry=present.one(SheathAsymmetry),
            slack=present.one(TendonSlack),
            elongation=present.one(ElongationCoupling),
            load=present.one(LoadDependentFriction),
            backlash=present.one(Backlash),
            lever=present.one(PulleyEccentricity),
            joint=tuple(effect for effect in present.at(Stage.JOINT) if not isinstance(effect, Custom)),
            custom=present.one(Custom),
            sensor=present.at(Stage.DELAY),
            stretch=present.at(Stage.STRETCH),
        )

    def on_the_pulley(self, functions: Functions[F], tau_m: F, state: State[F]) -> F:
        """Return the torque on the motor pulley for a reported motor torque, N*m, without a formula of the user."""
        for effect in self.motor_torque:
            tau_m = effect.apply(functions, tau_m, state)
        return tau_m

    def custom_at(self, stage: str) -> Custom | None:
        """Return the formula of the file if it acts on this side ("motor" or "joint"), otherwise None."""
        return self.custom if self.custom is not None and self.custom.stage == stage else None

    def transmission(self, model: TendonSheath) -> Transmission:
        """Return the transmission between the pulleys of motor and joint."""
        radii = (model.motor_pulley_radius, model.joint_pulley_radius)
        if self.elongation is not None:
            profile = Profile.of(self.elongation.curvature_profile)
            return Elongating(radii, profile, model.series_length / model.unstrained_length, model.series_at_joint)
        return FourTensions(radii, self.asymmetry, self.slack, self.tension_dependence)


@dataclass(frozen=True)
class _Present:
    """Hold the effects of a model by name, in the order of composition."""

    effects: Mapping[str, Any]

    def one(self, kind: type[T]) -> T | None:
        for effect in self.effects.values():
            if isinstance(effect, kind):
                return effect
        return None

    def at(self, stage: Stage) -> tuple[Any, ...]:
        return tuple([effect for name, effect in self.effects.items() if CATALOGUE[name].stage is stage])


def pretension_at(functions: Functions[F], model: TendonSheath, theta: F) -> F:
    """Return T_p0(Theta), N, from the file's value at `bending_angle`, (3.49)-(3.52), (3.56); 0 for slack tendons."""
    return functions.at_least(model.pretension + model.pretension_slope * (theta - model.bending_angle), 0.0)


def bending_and_pretension(functions: Functions[F], model: TendonSheath, stack: Stack, state: State[F]) -> tuple[F, F]:
    """Return Theta (rad, >= 0) and T_p (N, >= 0) with the effects on them."""
    theta = state.theta
    for bending in stack.bending:
        theta = bending.bending(theta, state)
    tension = pretension_at(functions, model, theta)
    for effect in stack.pretension:
        tension = functions.at_least(effect.pretension(functions, tension, state, model.axial_stiffness), 0.0)
    return functions.at_least(theta, 0.0), tension


LEAST_BENT = 1e-6  # rad, smallest wrap angle in the division below; friction is negligible at smaller angles


def imbalance(functions: Functions[F], state: State[F], theta: F) -> F | float:
    """Return (x_a - x_b) / (x_a + x_b), 1, at the mean wrap angle `theta` (rad) of tendons with different routings."""
    difference = state.theta_difference
    return 0.0 if difference is None else difference / functions.at_least(theta, LEAST_BENT)


def friction_angle(functions: Functions[F], model: TendonSheath, stack: Stack, state: State[F], theta: F) -> F:
    """Return x = mu Theta with the effects on mu; it is >= 0, because friction never drives the joint."""
    x = model.friction_coefficient * theta
    for effect in stack.friction:
        x = x * effect.factor(functions, state)
    return functions.at_least(x, 0.0)
