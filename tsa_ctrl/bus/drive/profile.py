"""Read drive profiles: units and objects from a drive's public documentation, and the resulting scales in SI units.

A profile is a TOML file in `drives/` next to the configuration. The profile "generic" needs no file.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from tsa_ctrl import settings
from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.cia402 import OFFSETS
from tsa_ctrl.bus.canopen.eds import read_eds
from tsa_ctrl.bus.settings import MOST_SLOTS, DriveSettings, EncoderSettings, Patience, Word
from tsa_ctrl.errors import UsageError


class VelocityUnit(Enum):
    """Units that drives use for 0x606C and 0x6080."""

    RPM = "rpm"
    DECI_RPM = "0.1 rpm"
    CENTI_RPM = "0.01 rpm"
    MILLI_RPM = "mrpm"
    COUNTS = "counts/s"
    DECI_COUNTS = "0.1 counts/s"
    KINCO = "1/16.384 counts/s"  # 1875 / (512 counts per revolution) rpm
    TECHNOSOFT = "1/65.536 counts/s"  # 2^-16 counts per loop of 1 ms

    @property
    def si_code(self) -> int | None:
        """Return the value of 0x60A9 (prefix, revolutions, per minute), or None if it cannot express the unit."""
        return _SI_CODES.get(self)

    def radians_per_second(self, counts_per_revolution: int) -> float:
        """Return the value of one digit in rad/s of the motor."""
        if self in _RPM:
            return _RPM[self] * 2.0 * math.pi / 60.0
        return _COUNTS[self] * 2.0 * math.pi / counts_per_revolution


_RPM = {
    VelocityUnit.RPM: 1.0,
    VelocityUnit.DECI_RPM: 0.1,
    VelocityUnit.CENTI_RPM: 0.01,
    VelocityUnit.MILLI_RPM: 0.001,
}
_COUNTS = {
    VelocityUnit.COUNTS: 1.0,
    VelocityUnit.DECI_COUNTS: 0.1,
    VelocityUnit.KINCO: 1.0 / 16.384,
    VelocityUnit.TECHNOSOFT: 1.0 / 65.536,
}
_SI_CODES = {  # CiA 303-2: prefix exponent in the high byte, 0xB4 revolutions, 0x47 minutes
    VelocityUnit.RPM: 0x00B44700,
    VelocityUnit.DECI_RPM: 0xFFB44700,
    VelocityUnit.CENTI_RPM: 0xFEB44700,
    VelocityUnit.MILLI_RPM: 0xFDB44700,
}


class Identity(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Identity (0x1018) of a drive model; missing values are displayed but not compared."""

    vendor_id: Word | None = None
    product_codes: list[Word] = []


class Units(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Values of one digit of the objects whose unit is vendor-specific."""

    rated_torque: Annotated[float, Meta(gt=0.0)] = 1e-3  # N*m per digit of 0x6076
    torque: Annotated[float, Meta(gt=0.0)] = 1000.0  # digits of 0x6071 and 0x6077 at rated torque
    velocity: VelocityUnit = VelocityUnit.MILLI_RPM  # 0x606C
    max_speed: VelocityUnit = VelocityUnit.RPM  # 0x6080


Keep = Literal["keep"]
IntegerType = Literal["i8", "i16", "i32", "u8", "u16", "u32"]
NumberType = Literal[
    "bool", "i8", "i16", "i24", "i32", "i40", "i48", "i56", "i64",
    "u8", "u16", "u24", "u32", "u40", "u48", "u56", "u64", "f32", "f64",
]  # fmt: skip
Index = Annotated[int, Meta(ge=0x1000, le=0xFFFF)]
Subindex = Annotated[int, Meta(ge=0, le=0xFF)]
EmcyCode = Annotated[int, Meta(ge=1, le=0xFFFF)]


class Reactions(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Option codes 0x605A to 0x605E and 0x1029:1; "keep" leaves the drive's value unchanged."""

    quick_stop: int | Keep = 0  # 0: the drive is disabled and the motor coasts
    shutdown: int | Keep = 0
    disable_operation: int | Keep = 0
    halt: int | Keep = "keep"
    fault: int | Keep = 0
    communication_error: int | Keep = 0  # 0: pre-operational, 1: no change, 2: stopped


REACTIONS = {  # object -> its key in [reactions]
    objects.ERROR_BEHAVIOUR: "communication_error",
    objects.QUICK_STOP_OPTION: "quick_stop",
    objects.SHUTDOWN_OPTION: "shutdown",
    objects.DISABLE_OPTION: "disable_operation",
    objects.HALT_OPTION: "halt",
    objects.FAULT_REACTION_OPTION: "fault",
}


class TorqueClamp(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The object that limits the torque of a drive without 0x6072, and its value at rated torque.

    The value at rated torque is in another object (`rated_index`) or is the number `rated`. With `rated`, `zero` is the
    value without torque.
    """

    index: Index
    subindex: Subindex = 0
    rated_index: Index | None = None
    rated_subindex: Subindex = 0
    rated: int | None = None
    zero: int = 0
    type: IntegerType = "u32"
    name: str = "torque clamp"


class ExtraWrite(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A vendor-specific object that must have a certain value."""

    index: Index
    subindex: Subindex = 0
    type: NumberType
    value: bool | int | float
    name: str

    @property
    def entry(self) -> objects.Object:
        return objects.Object(self.index, self.subindex, objects.Type[self.type.upper()], self.name)

    @property
    def raw(self) -> int:
        """Return the raw value; raise ValueError if the type cannot hold it."""
        return self.entry.type.raw(self.value)


class DriveProfile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Properties of one drive model."""

    name: str = "generic CiA 402 drive"
    sources: list[str] = []  # documents with these values
    unknown: list[str] = []  # missing values that the user must determine
    eds: str | None = None  # EDS file next to the profile; default: none, the built-in dictionary is used
    identity: Identity = Identity()
    units: Units = Units()
    reactions: Reactions = Reactions()
    absent: list[str] = []  # names of missing objects, as in the object table
    torque_clamp: TorqueClamp | None = None  # if the drive lacks 0x6072
    reports_following: bool = True  # statusword bit 12 as in CiA 402
    mode_shows: Literal["written", "operational", "enabled"] = "written"  # stage at which 0x6061 displays 0x6060
    warnings: list[EmcyCode] = []  # EMCY codes that are reported without a stop
    supervision: Literal["heartbeat", "guarding"] = "heartbeat"  # how drive and controller supervise each other
    needs_sync_period: bool = False  # True: 0x1006 must be our SYNC period, otherwise 0
    produces_sync: bool = False  # the drive may send SYNC at power-on, which startup disables (0x1005 bit 30)
    boot_timeout: Patience = 3.0  # s, from a reset to the boot-up
    answer_timeout: Patience = 0.5  # s, of one SDO answer
    rpdo_count: Annotated[int, Meta(ge=1, le=4)] = 4  # RPDOs of the drive; unused ones are disabled
    tpdo_count: Annotated[int, Meta(ge=2, le=4)] = 4
    extra: list[ExtraWrite] = []

    def has(self, entry: objects.Object) -> bool:
        """Return True unless the profile lists the object as absent."""
        return entry.name not in self.absent


def load_profile(name: str, folder: str | Path) -> DriveProfile:
    """Return the profile `name`, a path to a .toml or `drives/NAME.toml` in `folder`; raise UsageError if invalid."""
    path = Path(folder) / (name if name.endswith(".toml") else f"drives/{name}.toml")
    if name == "generic" and not path.exists():
        return DriveProfile()
    if not path.exists():
        known = sorted({"generic", *(found.stem for found in path.parent.glob("*.toml"))})
        raise UsageError(
            f"{path}: no such drive profile '{name}'; available: {', '.join(known)}; correct profile in "
            "[axis.drive], or write one with tsa drive probe"
        )
    profile = settings.load(path, DriveProfile)
    names = {entry.name for entry in objects.TABLE}
    for absent in profile.absent:
        if absent not in names:
            near = difflib.get_close_matches(absent, names, n=1)
            advice = f"did you mean '{near[0]}'?" if near else "use a name of the object table"
            raise UsageError(f"{path}: absent: unknown object '{absent}'; {advice}")
    offsets = {entry.of(slot).index for entry in OFFSETS for slot in range(1, MOST_SLOTS + 1)}
    for extra in profile.extra:
        try:
            _ = extra.raw
        except ValueError as error:
            raise UsageError(
                f"{path}: [[extra]] '{extra.name}': value {extra.value} does not fit {error}; correct value or type"
            ) from None
        if extra.value and extra.index in offsets:
            raise UsageError(
                f"{path}: [[extra]] '{extra.name}' writes {extra.value} to 0x{extra.index:04X}, which the drive adds "
                "to the command; allowed is 0; remove this entry"
            )
    if not profile.has(objects.MAX_TORQUE) and profile.torque_clamp is None:
        raise UsageError(
            f"{path}: no object limits the drive's torque; write [torque_clamp] for a drive without 0x6072"
        )
    clamp = profile.torque_clamp
    if clamp is not None and (clamp.rated_index is None) is (clamp.rated is None):
        raise UsageError(
            f"{path}: torque_clamp: give either rated_index (the object that holds the value at rated torque) or rated "
            "(that value itself)"
        )
    if profile.eds is None:
        return profile
    eds = path.parent / profile.eds
    read_eds(eds)
    return msgspec.structs.replace(profile, eds=str(eds))


PER_MILLE = 1000
_I16_MAX = 32767


@dataclass(frozen=True)
class DriveScale:
    """Signed factors between device units and SI units at the motor pulley, and limits in device units."""

    torque: float  # N*m per digit of 0x6071 and 0x6077
    position: float  # rad per digit of 0x6064
    velocity: float  # rad/s per digit of 0x606C
    max_torque_digits: int  # per mille of rated torque, 0x6072
    most_digits: int  # digits of 0x6071 at the same limit
    max_speed_digits: int  # 0x6080


def drive_scale(drive: DriveSettings, profile: DriveProfile, where: str) -> DriveScale:
    """Return the scale of a drive; raise UsageError if a limit exceeds the range of its object."""
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
            f"{where}: max_torque {limit:g} N*m is {torque_digits:.6g} per mille of the rated torque at the pulley "
            f"({rated:g} N*m); allowed are 1 to {_I16_MAX}; correct limits.torque or rated_torque"
        )
    if not 1 <= most_digits <= _I16_MAX:
        raise UsageError(
            f"{where}: max_torque {limit:g} N*m is {most_digits:.6g} digits of 0x6071 ({profile.units.torque:g} at "
            f"rated torque); allowed are 1 to {_I16_MAX}; correct limits.torque, or [units] torque in the profile"
        )
    if not 1 <= speed_digits <= 0xFFFFFFFF:
        raise UsageError(
            f"{where}: max_speed {drive.max_speed:g} rad/s is {speed_digits:.6g} {profile.units.max_speed.value} of "
            "the motor; allowed are 1 to 4294967295; correct limits.motor_over_speed or gear_ratio"
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
    """Return the signed joint angle per count, rad."""
    return encoder.sign * 2.0 * math.pi / encoder.counts_per_revolution
