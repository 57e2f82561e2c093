"""Read the limits, ramps and scales that a drive applies between the torque command and the motor."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

from tsa_ctrl.bus.canopen.cia402 import TORQUE_PATH, Effect, Influence
from tsa_ctrl.bus.drive.checks import Node, Row
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.drive.session import SdoRefusedError, Session
from tsa_ctrl.bus.settings import DriveSettings, EncoderSettings
from tsa_ctrl.errors import UsageError

PER_MILLE = 1000
_I16_MAX = 32767


@dataclass(frozen=True)
class DriveScale:
    """Hold the factors between device units and SI of each channel of a drive, at the motor pulley, with the sign."""

    torque: float  # N*m per digit of 0x6071 and 0x6077
    position: float  # rad per digit of 0x6064
    velocity: float  # rad/s per digit of 0x606C
    max_torque_digits: int  # per mille of rated torque, 0x6072
    most_digits: int  # of 0x6071, the same limit
    max_speed_digits: int  # 0x6080


def drive_scale(drive: DriveSettings, profile: DriveProfile, where: str) -> DriveScale:
    """Return the scale of a drive; raises UsageError if a limit exceeds the range of its object."""
    ratio, counts = drive.gear_ratio, drive.counts_per_revolution
    rated = drive.rated_torque * ratio
    torque = rated / profile.units.torque
    max_speed = profile.units.max_speed.radians_per_second(counts) / ratio
    limit = rated if drive.max_torque is None else drive.max_torque
    torque_digits = math.floor(PER_MILLE * limit / rated + 1e-9)
    most_digits = math.floor(limit / torque + 1e-9)
    speed_digits = math.floor(drive.max_speed / max_speed + 1e-9)
    if not 1 <= torque_digits <= _I16_MAX:
        raise UsageError(
            f"{where}: max_torque {limit:g} N*m is {torque_digits} per mille of the rated torque at the pulley "
            f"({rated:g} N*m); allowed are 1 to {_I16_MAX}; correct max_torque or rated_torque"
        )
    if not 1 <= most_digits <= _I16_MAX:
        raise UsageError(
            f"{where}: max_torque {limit:g} N*m is {most_digits} digits of 0x6071 ({profile.units.torque:g} at rated "
            f"torque); allowed are 1 to {_I16_MAX}; correct max_torque, or [units] torque in the drive's profile"
        )
    if not 1 <= speed_digits <= 0xFFFFFFFF:
        raise UsageError(
            f"{where}: max_speed {drive.max_speed:g} rad/s is {speed_digits} {profile.units.max_speed.value} of the "
            "motor; allowed are 1 to 4294967295; correct max_speed or gear_ratio"
        )
    return DriveScale(
        torque=drive.torque_sign * torque,
        position=drive.position_sign * 2.0 * math.pi / (counts * ratio),
        velocity=drive.position_sign * profile.units.velocity.radians_per_second(counts) / ratio,
        max_torque_digits=torque_digits,
        most_digits=most_digits,
        max_speed_digits=speed_digits,
    )


def encoder_scale(encoder: EncoderSettings) -> float:
    """Radians of the joint per count, with sign."""
    return encoder.sign * 2.0 * math.pi / encoder.counts_per_revolution


_SLOW_RAMP = 0.1  # s from zero to max_torque; a faster ramp is over before the joint has moved


def check_torque_path(
    session: Session, node: Node, written: Collection[tuple[int, int]]
) -> tuple[list[Row], list[str]]:
    """Read the objects of the torque path that the plan does not write.

    Args:
        session: an open session; nothing is written.
        node: the drive.
        written: keys of the objects that the plan writes; they are left out.

    Returns:
        Rows of the objects to watch while the loop runs, and a note for each object that limits or ramps the torque.
    """
    rows, notes = [], []
    for influence in TORQUE_PATH:
        entry = influence.entry.of(node.axis.drive.slot)
        if entry.key in written or not node.profile.has(entry):
            continue
        try:
            found = session.read_if_there(node.node_id, entry)
        except SdoRefusedError:
            notes.append(f"{entry} cannot be read, so its effect on the torque is not known")
            continue
        if found is None:
            continue
        if influence.watched:
            rows.append(Row(entry, found, found))
        effect = _effect(influence, found, node)
        if effect:
            notes.append(f"{entry.name} (0x{entry.index:04X}) is {found} {influence.unit}: {effect}")
    return rows, notes


def _effect(influence: Influence, found: int, node: Node) -> str:
    """Return the effect of a value on the torque, or an empty text if it has none."""
    drive = node.axis.drive
    most = drive_scale(drive, node.profile, f"axis '{node.axis.name}'").max_torque_digits
    rated = drive.rated_torque * drive.gear_ratio / PER_MILLE
    if influence.effect is Effect.LIMITS and found < most:
        return (
            f"the drive delivers no more than {found * rated:.3g} N*m, and max_torque in [axis.drive] is "
            f"{most * rated:.3g} N*m; raise the limit with the maker's tool, or lower max_torque"
        )
    if influence.effect is Effect.RAMPS and influence.unit and 0 < found * _SLOW_RAMP < most:
        return (
            f"{most / found:.3g} s from zero to max_torque; CiA 402 applies it in the profile torque mode only, but "
            "some drives also apply it in cyclic torque; raise it with the maker's tool if the torque lags"
        )
    return ""
