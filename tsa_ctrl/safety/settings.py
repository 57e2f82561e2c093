"""Settings of the plausibility checks and the passivity observer of an axis, from [axis] of the controller file.

Settings are separate from the classes that use them: mypyc, which compiles those, ignores `frozen` and
`forbid_unknown_fields` of a `msgspec.Struct`.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

Torque = Annotated[float, Meta(gt=0.0, le=10_000.0)]  # N*m
Duration = Annotated[float, Meta(ge=0.001, le=10.0)]  # s


class PlausibilitySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.plausibility]: how far measured and commanded torque, joint and motor, may disagree."""

    torque: Torque | None = None  # N*m at the motor; default: a quarter of limits.torque
    joint_torque: Torque | None = None  # N*m at the joint; default: 0.15 of limits.torque, at the joint
    duration: Duration = 0.1  # s that either must last, less a quarter of the time for which it did not
    slip: Annotated[float, Meta(gt=0.0, le=10_000.0)] | None = None  # rad at the motor; default: by the torque in use


class PassivitySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.passivity]: when the compensation counts as a source of energy, and backs off."""

    energy: Annotated[float, Meta(gt=0.0, le=100.0)] = 3e-3  # J; at 1 rad/s 0.02 kg*m^2 have 10 mJ
    buzz: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.03  # N*m RMS at the motor above 20 Hz, for 0.4 s


class OscillationSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.oscillation] of earlier versions: read, and without effect."""

    speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.5
    duration: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.0
    share: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.5
