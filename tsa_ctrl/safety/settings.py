"""Settings of limiter, plausibility checks and passivity observer of an axis, from [axis] of the controller file.

Settings stand apart from the classes that use them: mypyc, which compiles those, ignores `frozen` and
`forbid_unknown_fields` of a `msgspec.Struct`.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

Torque = Annotated[float, Meta(gt=0.0, le=1000.0)]  # N*m
Speed = Annotated[float, Meta(gt=0.0, le=1000.0)]  # rad/s
Difference = Annotated[float, Meta(gt=0.0, le=10_000.0)]  # N*m
Duration = Annotated[float, Meta(ge=0.001, le=10.0)]  # s


class LimiterSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.limits]: the bounds of one axis' motor torque; only `torque` has no default."""

    torque: Torque  # N*m at the motor, absolute
    torque_share: Annotated[float, Meta(gt=0.0, le=10.0)] | None = None  # 1, of the rated torque, in place of torque
    rate: Annotated[float, Meta(gt=0.0, le=100_000.0)] = 200.0  # N*m/s at the motor
    distance: Torque | None = None  # N*m, command beyond measured motor torque; default: the absolute limit
    joint_speed: Speed = 10.0  # rad/s: driving torque fades to 0 towards it, from 80 % of it on
    over_speed: Speed = 12.0  # rad/s at the joint, latches: no knee or elbow is led faster than 8
    motor_over_speed: Speed = 20.0  # rad/s at the motor, latches: a torn tendon is a runaway
    travel: tuple[float, float] | None = None  # rad, joint; outward torque is 0 beyond
    travel_margin: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.1  # rad over which outward torque fades to 0

    def __post_init__(self) -> None:
        if self.torque_share is not None:  # else it is `torque` by now
            raise ValueError("both torque and torque_share are given; keep one of them")
        if self.travel is not None and self.travel[1] - self.travel[0] <= 2.0 * self.travel_margin:
            raise ValueError(
                f"travel {list(self.travel)} rad is not wider than two travel margins of "
                f"{self.travel_margin:g} rad; give [lower, upper]"
            )

    def check_order(self) -> None:
        """Raise ValueError if over_speed is not above joint_speed; for limits that are complete."""
        if self.over_speed <= self.joint_speed:
            raise ValueError(
                f"over_speed {self.over_speed:g} rad/s is not above joint_speed {self.joint_speed:g} rad/s; raise it"
            )


class PlausibilitySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.plausibility]: how far measured and commanded torque, joint and motor, may disagree."""

    torque: Difference | None = None  # N*m at the motor; default: a quarter of limits.torque
    joint_torque: Difference | None = None  # N*m at the joint; default: 0.15 of limits.torque, at the joint
    duration: Duration = 0.1  # s that either must last, less a quarter of the time for which it did not
    slip: Annotated[float, Meta(gt=0.0, le=10_000.0)] | None = None  # rad at the motor; default: by the torque in use


class PassivitySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.passivity]: when the compensation counts as a motor of its own, and backs off."""

    energy: Annotated[float, Meta(gt=0.0, le=100.0)] = 3e-3  # J; at 1 rad/s 0.02 kg*m^2 have 10 mJ
    buzz: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.03  # N*m RMS at the motor above 20 Hz, for 0.4 s


class OscillationSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.oscillation] of earlier versions: read, and without effect."""

    speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.5
    duration: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.0
    share: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.5
