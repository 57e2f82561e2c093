"""The class of use: a rig on a bench, or a joint that a person wears; and the speed limits that follow from the wearer.

The chain of speeds, each with its share of the next:

    wearer_speed    the wearer's fastest motion; up to here the motor gives its full torque
    joint_speed     1.25 times as fast; the driving torque has faded to 0 (`safety.limiter` begins at 0.8 of it)
    over_speed      1.25 times as fast again; the torque latches at 0
    motor_over_speed    r_J/r_M times over_speed: the same at the motor, and the drive's own clamp 0x6080; for a slow
                    wearer 1.56 times the motor's speed in a friction reversal at a joint at rest

Measured on the simulated rigs, RMS error without limits and with: imposed gait 4.9 and 4.9 mN*m, limb 4.3 and 4.3,
human-in-the-loop load 8.1 and 8.1. With 1.05 and 1.15 instead limb and
load have 64 and 40 mN*m, and the imposed gait trips.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from tsa_ctrl.bus.live.read_back import StopBit
from tsa_ctrl.bus.settings import AxisNodes, DriveSettings
from tsa_ctrl.safety.limiter import MOST_TORQUE, LimiterSettings

UseClass = Literal["bench", "worn"]
MARGIN = 1.25  # 1, between two speeds of the chain


class SafetySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[safety]: the class of use, the wearer, and the requirements of `tsa verify-safety` and the fault campaign."""

    use_class: UseClass = msgspec.field(name="class", default="bench")
    # rad/s of the joint, fastest motion of the wearer; a sprinter's knee reaches about 20, gait 7
    wearer_speed: Annotated[float, Meta(gt=0.0, le=20.0)] | None = None
    travel: tuple[float, float] | None = None  # rad of every joint; [axis.limits] travel narrows it for one axis
    emergency_stop: Annotated[int, Meta(ge=0, le=31)] | None = None  # bit of 0x60FD (digital inputs)
    emergency_stop_level: Literal[0, 1] = 1  # of that bit while the stop is pressed
    zero_torque_within: Annotated[float, Meta(ge=0.005, le=20.0)] | None = (
        None  # s; default: the longest reaction to a fault + 0.05
    )
    torque: Annotated[float, Meta(gt=0.0, le=1000.0)] | None = None  # N*m at the motor; default: 0.1 of rated torque

    def __post_init__(self) -> None:
        if self.travel is not None and self.travel[0] >= self.travel[1]:
            raise ValueError(f"travel {list(self.travel)} rad is empty; give [lower, upper]")

    @property
    def worn(self) -> bool:
        """Return True if a person wears the joint."""
        return self.use_class == "worn"


def on_bench(safety: SafetySettings) -> SafetySettings:
    """Return the settings of a commissioning run, in which no person wears the joint; all limits stay."""
    return msgspec.structs.replace(safety, use_class="bench")


def longest_timeout(axes: Sequence[AxisNodes]) -> tuple[float, str]:
    """Return the longest time, s, for which something may be silent before torque is taken away, and its key."""
    found = []
    for axis in axes:
        found.append((axis.drive.host_timeout, f"axis '{axis.name}' drive.host_timeout"))
        for role, node in axis.nodes():
            found.append((node.heartbeat_timeout, f"axis '{axis.name}' {role.key}.heartbeat_timeout"))
    return max(found)


def longest_fault(axes: Sequence[AxisNodes], stop_time: float) -> tuple[float, str]:
    """Return how long torque may go on after a fault, s, and why.

    Args:
        axes: of the file.
        stop_time: in which the torque goes to 0 at a stop, s.
    """
    longest, name = longest_timeout(axes)
    if len(axes) == 1:
        return longest, f"{name} = {longest:g} s, in which nothing happens yet"
    return longest + stop_time, (
        f"{name} = {longest:g} s, in which nothing happens yet, plus [controller] stop_time = {stop_time:g} s, in "
        "which the torque of the other axes ends"
    )


def stop_bit(safety: SafetySettings) -> StopBit | None:
    """Return where the emergency stop is wired; None without one."""
    return None if safety.emergency_stop is None else StopBit(safety.emergency_stop, safety.emergency_stop_level)


def wearer_speeds(wearer_speed: float, geared: float, reversal_speed: float) -> dict[str, float]:
    """Return the speed limits of [axis.limits] that follow from the wearer.

    Args:
        wearer_speed: fastest motion of the joint, rad/s.
        geared: r_J/r_M, 1.
        reversal_speed: of the motor while friction reverses at a joint at rest, rad/s.
    """
    joint_speed = MARGIN * wearer_speed
    over_speed = MARGIN * joint_speed
    motor_over_speed = max(geared * over_speed, MARGIN**2 * reversal_speed)
    return {"joint_speed": joint_speed, "over_speed": over_speed, "motor_over_speed": motor_over_speed}


def wearer_limits(
    limits: LimiterSettings,
    written: Collection[str],
    safety: SafetySettings,
    geared: float,
    reversal_speed: float,
) -> LimiterSettings:
    """Return the limits of one axis with everything that follows from the wearer and that the file leaves out.

    Args:
        limits: as the file has them.
        written: keys of [axis.limits] that the file has.
        safety: of the file.
        geared: r_J/r_M of the axis.
        reversal_speed: of the motor while friction reverses, rad/s.

    Raises:
        ValueError: a written limit contradicts a derived one.
    """
    derived: dict[str, object] = {}
    if safety.wearer_speed is not None:
        derived |= wearer_speeds(safety.wearer_speed, geared, reversal_speed)
    if safety.travel is not None:
        derived["travel"] = safety.travel
        if limits.travel is not None and not (
            safety.travel[0] <= limits.travel[0] and limits.travel[1] <= safety.travel[1]
        ):
            raise ValueError(
                f"limits.travel {list(limits.travel)} rad is not inside [safety] travel {list(safety.travel)} rad; "
                "narrow the one or widen the other"
            )
    complete = msgspec.structs.replace(limits, **{key: value for key, value in derived.items() if key not in written})
    complete.check_order()
    return complete


def with_torque(limits: LimiterSettings, drive: DriveSettings) -> LimiterSettings:
    """Return the limits with `torque` in place of `torque_share`.

    Args:
        limits: limits from the file.
        drive: drive settings from the file.

    Raises:
        ValueError: The share gives a torque above the drive's own clamp or above the largest limit.
    """
    if limits.torque_share is None:
        return limits
    torque = limits.torque_share * drive.rated_torque * drive.gear_ratio
    _check_clamp(f"limits.torque_share {limits.torque_share:g}, which is {torque:g} N*m,", torque, drive)
    if torque > MOST_TORQUE:
        raise ValueError(
            f"limits.torque_share {limits.torque_share:g} is {torque:g} N*m; allowed are up to {MOST_TORQUE:g} N*m: "
            "lower it, or correct drive.rated_torque and drive.gear_ratio"
        )
    return msgspec.structs.replace(limits, torque=torque, torque_share=None)


def _check_clamp(limit: str, torque: float, drive: DriveSettings) -> None:
    """Raise ValueError if the torque (N*m) of a limit is above the drive's own clamp."""
    most = drive.rated_torque * drive.gear_ratio if drive.max_torque is None else drive.max_torque
    if torque > most:
        raise ValueError(
            f"{limit} is above the drive's own clamp of {most:g} N*m "
            "(drive.max_torque, default rated torque times gear ratio); lower it, or raise max_torque"
        )


def drive_clamps(drive: DriveSettings, written: Collection[str], limits: LimiterSettings) -> DriveSettings:
    """Return the drive's settings with its own clamps (0x6072, 0x6080) no wider than the controller's limits.

    Args:
        drive: as the file has it.
        written: keys of [axis.drive] that the file has.
        limits: of the axis, complete.

    Raises:
        ValueError: a limit is above a clamp of the file.
    """
    _check_clamp(f"limits.torque {limits.torque:g} N*m", limits.torque, drive)
    if "max_speed" in written and limits.motor_over_speed > drive.max_speed:
        raise ValueError(
            f"limits.motor_over_speed {limits.motor_over_speed:g} rad/s is above drive.max_speed "
            f"{drive.max_speed:g} rad/s, which the drive enforces; lower it, or raise max_speed"
        )
    return msgspec.structs.replace(drive, max_torque=limits.torque, max_speed=limits.motor_over_speed)
