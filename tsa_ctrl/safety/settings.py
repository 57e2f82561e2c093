"""Define the settings of an axis' plausibility checks and passivity observer, from [axis] of the controller file.

Settings are separate from the classes that use them, because mypyc compiles those classes and ignores the options
`frozen` and `forbid_unknown_fields` of a `msgspec.Struct`.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

Torque = Annotated[float, Meta(gt=0.0, le=10_000.0)]  # N*m
Duration = Annotated[float, Meta(ge=0.001, le=10.0)]  # s


class PlausibilitySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.plausibility]: permitted differences between measured and commanded torque and between joint and motor."""

    torque: Torque | None = None  # N*m at the motor; default: a quarter of limits.torque
    joint_torque: Torque | None = None  # N*m at the joint; default: 0.15 of limits.torque, at the joint
    duration: Duration = 0.1  # s for which either error must last; time without it counts back by a quarter
    slip: Annotated[float, Meta(gt=0.0, le=10_000.0)] | None = None  # rad at the motor; default: from the torque


class PassivitySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.passivity]: thresholds above which the guard reduces the compensation."""

    energy: Annotated[float, Meta(gt=0.0, le=100.0)] = 3e-3  # J; an inertia of 0.02 kg*m^2 at 1 rad/s has 10 mJ
    buzz: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.03  # N*m RMS at the motor above 20 Hz, for 0.4 s


class OscillationSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.oscillation] of earlier versions. It is still accepted but has no effect."""

    speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.5
    duration: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.0
    share: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.5
