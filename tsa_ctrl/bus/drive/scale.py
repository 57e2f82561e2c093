"""Device units to SI and back: each factor is written once here and used both ways."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import DriveSettings, EncoderSettings
from tsa_ctrl.errors import UsageError

PER_MILLE = 1000
_I16_MAX = 32767


@dataclass(frozen=True)
class DriveScale:
    """One digit of each channel of a drive, at the motor pulley, sign included."""

    torque: float  # N*m per digit of 0x6071 and 0x6077
    position: float  # rad per digit of 0x6064
    velocity: float  # rad/s per digit of 0x606C
    max_torque_digits: int  # per mille of rated torque, 0x6072
    most_digits: int  # of 0x6071, the same limit
    max_speed_digits: int  # 0x6080


def drive_scale(drive: DriveSettings, profile: DriveProfile, where: str) -> DriveScale:
    """Scale of a drive; raises UsageError when a clamp does not fit its object."""
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
