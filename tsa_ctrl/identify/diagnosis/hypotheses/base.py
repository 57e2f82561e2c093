"""Define the interface of a base model: its prediction, the parameters of a recalibration, and their file format.

There are three base models:

- the tendon-sheath (3.55)-(3.56), in which recalibration frees x = mu Theta and T_p within [uncertainty];
- the plain drive tau_M = J domega/dt + tau_c sign(omega) + b omega + c;
- the geared drive tau_J = eta^s N tau_M - tau_c sigma - b omega_J.

For both kinds of drives, recalibration frees Coulomb friction and all parameters in the file except the ratio.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import BEYOND, NEGLIGIBLE
from tsa_ctrl.model.effects.search import Coordinate, Scales
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Effects, GearedDrive, Model, RigidDrive, TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

WIDE_PRIOR = 20.0  # factor by which recalibration may move if it ignores [uncertainty], to test for wrong parameters


class Base(Protocol):
    """Define the interface of a base model."""

    @property
    def given(self) -> Model: ...

    @property
    def target(self) -> str:
        """Return the name of the predicted column."""
        ...

    def coordinates(self, wide_prior: bool = False) -> tuple[Coordinate, ...]: ...

    def start(self) -> Array:
        """Return the coordinates of the file's values."""
        ...

    def build(self, values: Sequence[float] | Array, effects: Effects) -> Model:
        """Return the model with these coordinates; `effects` are added to the effects of the file."""
        ...

    def direction_weight(self, model: Model, signals: Signals) -> Array:
        """Return the change of the prediction when sigma changes from 0 to 1, (n,) in N*m."""
        ...

    def quantities(self, values: Array) -> dict[str, tuple[float, float, str]]:
        """Return (nominal, value, unit) of the parameters for these coordinates, and of their combinations, by name."""
        ...


@dataclass(frozen=True)
class TendonBase:
    """A tendon-sheath with the coordinates ln(x / nominal x) and ln(T_p0 / nominal T_p0)."""

    given: TendonSheath
    target: str = "tau_j"

    def coordinates(self, wide_prior: bool = False) -> tuple[Coordinate, ...]:
        return self._coordinates[wide_prior]

    @cached_property
    def _coordinates(self) -> tuple[tuple[Coordinate, ...], tuple[Coordinate, ...]]:
        """Return the coordinates without and with a wide prior, cached because every prediction needs them."""
        return self._freed(False), self._freed(True)

    def _freed(self, wide_prior: bool) -> tuple[Coordinate, ...]:
        free = []
        for name, value, uncertainty in (
            ("friction_angle", self.given.friction_angle, self.given.friction_angle_uncertainty),
            ("pretension", self.given.pretension, self.given.pretension_uncertainty),
        ):
            if value > 0.0:
                span = math.log(WIDE_PRIOR if wide_prior else 1.0 + uncertainty)
                free.append(Coordinate(name, -span, span))
        return tuple(free)

    def start(self) -> Array:
        return np.zeros(len(self.coordinates()))

    def build(self, values: Sequence[float] | Array, effects: Effects) -> Model:
        model = self.given.with_effects({**self.given.effects, **effects}) if effects else self.given
        changed = {  # T_ref keeps the file's pretension
            coordinate.name: getattr(model, coordinate.name) * math.exp(float(value))
            for coordinate, value in zip(self.coordinates(), values, strict=True)
        }
        return model.recalibrated(**changed) if changed else model

    def direction_weight(self, model: Model, signals: Signals) -> Array:
        return _half_difference(dataclasses.replace(model, effects={}), signals)

    def quantities(self, values: Array) -> dict[str, tuple[float, float, str]]:
        model = self.build(values, {})
        assert isinstance(model, TendonSheath)
        given = self.given
        ratio = given.joint_pulley_radius / given.motor_pulley_radius
        return {
            "friction_angle": (given.friction_angle, model.friction_angle, "1"),
            "pretension": (given.pretension, model.pretension, "N"),
            "slope": (ratio * math.cosh(given.friction_angle), ratio * math.cosh(model.friction_angle), "1"),
            "half_loop_torque": (_half_loop(given), _half_loop(model), "N*m"),
        }


_UNITS: Mapping[str, str] = {
    "inertia": "kg*m^2",
    "efficiency": "1",
    "coulomb_friction": "N*m",
    "viscous_friction": "N*m*s/rad",
    "torque_offset": "N*m",
}
# An offset may have either sign; the efficiency of a gear is between 5 % and 100 %
_BOUNDS: Mapping[str, tuple[float, float]] = {"torque_offset": (-math.inf, math.inf), "efficiency": (0.05, 1.0)}


@dataclass(frozen=True)
class DriveBase:
    """A drive whose coordinates are Coulomb friction and the parameters in the file, in units of `scales`."""

    given: RigidDrive | GearedDrive
    scales: Mapping[str, float]  # size of each parameter that changes the torque of these logs noticeably
    moves: bool = True  # False if the joint is locked, so that its losses cannot be identified

    @property
    def target(self) -> str:
        return self.given.target

    @property
    def free(self) -> tuple[str, ...]:
        if not self.moves:
            return ()
        return tuple(n for n in _UNITS if n == "coulomb_friction" or getattr(self.given, n, None) is not None)

    def coordinates(self, wide_prior: bool = False) -> tuple[Coordinate, ...]:
        return tuple(Coordinate(name, *_BOUNDS.get(name, (0.0, math.inf)), 1e-3) for name in self.free)

    def start(self) -> Array:
        return np.array([(getattr(self.given, name) or 0.0) / self.scales[name] for name in self.free])

    def build(self, values: Sequence[float] | Array, effects: Effects) -> Model:
        changed: dict[str, Any] = {
            name: float(value) * self.scales[name] for name, value in zip(self.free, values, strict=True)
        }
        return dataclasses.replace(self.given, **changed, effects={**self.given.effects, **effects})

    def direction_weight(self, model: Model, signals: Signals) -> Array:
        assert not isinstance(model, TendonSheath)
        if isinstance(model, GearedDrive):
            return _half_difference(dataclasses.replace(model, viscous_friction=None, effects={}), signals)
        return np.full(len(signals), model.coulomb_friction or 0.0)

    def quantities(self, values: Array) -> dict[str, tuple[float, float, str]]:
        model = self.build(values, {})
        return {
            name: (getattr(self.given, name) or 0.0, float(getattr(model, name)), _UNITS[name]) for name in self.free
        }


def base_of(model: Model, scales: Scales) -> Base:
    """Return the base of a model file, scaled to these logs."""
    if not isinstance(model, TendonSheath):
        # A joint whose 95th percentile of the speed does not exceed the velocity noise is locked.
        sizes = {
            "efficiency": 1.0,
            "inertia": scales.torque / scales.acceleration,
            "coulomb_friction": scales.torque,
            "viscous_friction": scales.torque / scales.speed,
            "torque_offset": scales.torque,
        }
        moves = isinstance(model, RigidDrive) or scales.speed > max(NEGLIGIBLE, BEYOND * scales.speed_noise)
        return DriveBase(model, sizes, moves)
    return TendonBase(model)


def _half_loop(model: TendonSheath) -> float:
    return 2.0 * model.pretension * model.joint_pulley_radius * math.sinh(model.friction_angle)


def _half_difference(model: Model, signals: Signals) -> Array:
    forward = dataclasses.replace(signals, omega_j=np.ones(len(signals)))
    backward = dataclasses.replace(signals, omega_j=-np.ones(len(signals)))
    return 0.5 * (predict(model, forward) - predict(model, backward))
