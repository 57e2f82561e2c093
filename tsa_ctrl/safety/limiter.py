"""The last station before the bus: separate, dumb, and suspicious of everything.

Order: enabled? fresh? finite? over-speed? then rate, joint speed, joint travel, distance of command to measured, and
absolute. Faults give exactly 0 in the same cycle; limits bend the torque. The rate bounds how fast the torque's size
may grow, never how fast it may fall: a limit acts at once. No limit takes a torque further from 0 than
was asked: a lying measurement can only weaken the motor. The absolute limit has the last word.
"""

from __future__ import annotations

import math
from enum import IntEnum
from math import isfinite
from typing import Annotated

import msgspec
from msgspec import Meta

MOST_TORQUE = 1000.0  # N*m, largest limit of a file
Torque = Annotated[float, Meta(gt=0.0, le=MOST_TORQUE)]  # N*m
Speed = Annotated[float, Meta(gt=0.0, le=1000.0)]  # rad/s


class Reason(IntEnum):
    """Reason why the sent torque differs from the desired one; of several, the strongest. Values are
    the log's codes.
    """

    NONE = 0
    DISABLED = 1
    STALE = 2
    NOT_FINITE = 3
    OVER_SPEED = 4
    SPEED = 5
    TRAVEL = 6
    DISTANCE = 7
    RATE = 8
    ABSOLUTE = 9
    OSCILLATION = 10  # the torque is as desired, but the motor oscillated and the guard limits the compensation
    DOMAIN = 11  # limited by the law before this check: beyond it one tendon goes slack
    PASSIVITY = 12  # as desired, but the compensation moved the joint and the guard limits it
    SENSE = 13  # small until the motor has proven its polarity since the enable: see safety.polarity_check
    UNPROVEN = 14  # as desired, but the sensors prove less friction than the compensation needs


# The effect of each limit and the remedy, in plain words. Faults have their own texts in `safety.causes`.
MEANINGS = {
    Reason.STALE: "no torque in cycles without fresh measurements; look for lost frames with tsa doctor",
    Reason.SPEED: "the torque fades out above 80 % of joint_speed",
    Reason.TRAVEL: "the outward torque fades out within travel_margin of the end of travel",
    Reason.DISTANCE: "the command is further than limits.distance from the motor torque that the drive reports",
    Reason.RATE: "the torque grows no faster than limits.rate",
    Reason.ABSOLUTE: "the torque is at limits.torque; a larger one needs a higher limit",
    Reason.OSCILLATION: "the motor oscillated, so less of the friction is compensated; run tsa tune",
    Reason.DOMAIN: "a larger torque would slacken one tendon; lower the set-point or raise the pretension",
    Reason.PASSIVITY: "the compensation moved the joint, so less of the friction is compensated; run tsa tune",
    Reason.SENSE: "the torque stays small after each enable until the motor has shown its direction",
    Reason.UNPROVEN: "the sensors confirm less friction than the model has, so less is compensated; move the joint, "
    "run tsa tune, or add a joint torque sensor",
}


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


class Limiter:
    """One axis' limiter; `over_speed` is latched until `reset`."""

    def __init__(self, settings: LimiterSettings, period: float) -> None:
        self.torque = settings.torque
        self.rate = settings.rate
        self.over_speed = False
        self.ceiling = math.inf  # N*m, an absolute limit for now
        self._distance = settings.torque if settings.distance is None else settings.distance
        self._speed = settings.joint_speed
        self._speed_onset = 0.8 * settings.joint_speed
        self._over_speed_j = settings.over_speed
        self._over_speed_m = settings.motor_over_speed
        self._low, self._high = settings.travel or (-float("inf"), float("inf"))
        self._margin = settings.travel_margin
        self._period = period
        self._last = 0.0

    def reset(self) -> None:
        """Release the over-speed latch; only for an explicit re-start."""
        self.over_speed = False
        self._last = 0.0

    def update(
        self,
        wanted: float,
        enabled: bool,
        fresh: bool,
        tau_m: float,
        omega_m: float,
        q_j: float,
        omega_j: float,
    ) -> tuple[float, Reason]:
        """Return the permitted torque (N*m), and the reason if it differs from `wanted`.

        `tau_m` (N*m), the speeds (rad/s) and `q_j` (rad) are measured values.
        """
        if not enabled:
            return self._zero(Reason.DISABLED)
        if not fresh:
            return self._zero(Reason.STALE)
        if not isfinite(wanted + tau_m + omega_m + q_j + omega_j):  # no sum of finite values is that large
            return self._zero(Reason.NOT_FINITE)
        if self.over_speed or abs(omega_j) >= self._over_speed_j or abs(omega_m) >= self._over_speed_m:
            self.over_speed = True
            return self._zero(Reason.OVER_SPEED)
        torque, reason = wanted, Reason.NONE
        step = self.rate * self._period
        if torque > 0.0:
            bound = step + (self._last if self._last > 0.0 else 0.0)
            if torque > bound:
                torque, reason = bound, Reason.RATE
        elif torque < 0.0:
            bound = (self._last if self._last < 0.0 else 0.0) - step
            if torque < bound:
                torque, reason = bound, Reason.RATE
        if torque * omega_j > 0.0 and abs(omega_j) > self._speed_onset:
            share = (self._speed - abs(omega_j)) / (self._speed - self._speed_onset)
            torque, reason = (torque * share if share > 0.0 else 0.0), Reason.SPEED
        room = self._high - q_j if torque > 0.0 else q_j - self._low
        if room < self._margin and torque != 0.0:
            torque, reason = (torque * room / self._margin if room > 0.0 else 0.0), Reason.TRAVEL
        if torque > 0.0:
            bound = tau_m + self._distance
            if torque > bound:
                torque, reason = (bound if bound > 0.0 else 0.0), Reason.DISTANCE
        elif torque < 0.0:
            bound = tau_m - self._distance
            if torque < bound:
                torque, reason = (bound if bound < 0.0 else 0.0), Reason.DISTANCE
        most, cut = (self.torque, Reason.ABSOLUTE) if self.torque <= self.ceiling else (self.ceiling, Reason.SENSE)
        if torque > most:
            torque, reason = most, cut
        elif torque < -most:
            torque, reason = -most, cut
        self._last = torque
        return torque, reason

    def _zero(self, reason: Reason) -> tuple[float, Reason]:
        self._last = 0.0
        return 0.0, reason
