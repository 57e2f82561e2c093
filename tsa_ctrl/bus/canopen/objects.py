"""Object dictionary of this master: one line for each CANopen object that it reads or writes.

No EDS is needed. Types and numbers are from CiA 301, 402, 404 and 406.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import dataclass, replace
from enum import Enum

from tsa_ctrl.errors import UsageError

AXIS_OFFSET = 0x800  # between the objects of two axes of one device
_PROFILE = range(0x6000, 0xA000)  # objects of the device profile


class Type(Enum):
    """Basic data types: struct format (empty if struct has none), CiA 301 code, bytes and kind.

    Values are raw integers. A real number is represented by its IEEE 754 bits, so that it compares exactly.
    Source: CiA 301, 7.4.4 and table 44.
    """

    BOOL = ("?", 0x0001, 1, "unsigned")
    I8 = ("b", 0x0002, 1, "signed")
    I16 = ("h", 0x0003, 2, "signed")
    I32 = ("i", 0x0004, 4, "signed")
    U8 = ("B", 0x0005, 1, "unsigned")
    U16 = ("H", 0x0006, 2, "unsigned")
    U32 = ("I", 0x0007, 4, "unsigned")
    F32 = ("f", 0x0008, 4, "real")
    I24 = ("", 0x0010, 3, "signed")
    F64 = ("d", 0x0011, 8, "real")
    I40 = ("", 0x0012, 5, "signed")
    I48 = ("", 0x0013, 6, "signed")
    I56 = ("", 0x0014, 7, "signed")
    I64 = ("q", 0x0015, 8, "signed")
    U24 = ("", 0x0016, 3, "unsigned")
    U40 = ("", 0x0018, 5, "unsigned")
    U48 = ("", 0x0019, 6, "unsigned")
    U56 = ("", 0x001A, 7, "unsigned")
    U64 = ("Q", 0x001B, 8, "unsigned")

    def __init__(self, code: str, number: int, size: int, kind: str) -> None:
        self.code = code
        self.number = number
        self.size = size
        self.real = kind == "real"
        self.signed = kind == "signed"
        bits = 1 if number == 0x0001 else 8 * size
        self.low = -(1 << bits - 1) if self.signed else 0
        self.high = (1 << bits - 1) - 1 if self.signed else (1 << bits) - 1

    def raw(self, value: float) -> int:
        """Return the raw integer of a number; raise ValueError with the allowed range if the type cannot hold it."""
        if self.real:
            most = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0] if self.size == 4 else sys.float_info.max
            if not -most <= value <= most:  # false for nan too
                raise ValueError(f"{self.name.lower()} ({-most:g} to {most:g})")
            return int.from_bytes(struct.pack(f"<{self.code}", value), "little")
        if value != int(value) or not self.low <= value <= self.high:
            raise ValueError(f"{self.name.lower()} (whole numbers from {self.low} to {self.high})")
        return int(value)

    def number_of(self, raw: int) -> int | float:
        """Return the number that a raw integer represents."""
        if not self.real:
            return raw
        return float(struct.unpack(f"<{self.code}", raw.to_bytes(self.size, "little"))[0])


@dataclass(frozen=True, slots=True)
class Object:
    """One entry of an object dictionary."""

    index: int
    subindex: int
    type: Type
    name: str

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex} {self.name}"

    @property
    def key(self) -> tuple[int, int]:
        return self.index, self.subindex

    def of(self, slot: int) -> Object:
        """Return this object for the axis in a slot; profile objects of two axes are 0x800 apart (CiA 301)."""
        if slot == 1 or self.index not in _PROFILE:
            return self
        return replace(self, index=self.index + AXIS_OFFSET * (slot - 1))

    @property
    def mapping(self) -> int:
        """Return the PDO mapping entry (0x1600.., 0x1A00..) of this object: index, subindex and length in bits."""
        return self.index << 16 | self.subindex << 8 | self.type.size * 8

    def encode(self, value: int) -> bytes:
        """Return a value as SDO data; raise UsageError if it does not fit the type."""
        if not self.type.low <= value <= self.type.high:
            raise UsageError(
                f"{self}: value {value} does not fit {self.type.name.lower()} "
                f"({self.type.low} to {self.type.high}); correct the setting that determines it"
            )
        return value.to_bytes(self.type.size, "little", signed=self.type.signed)

    def decode(self, data: bytes) -> int:
        """Return the value in SDO data. Short data is extended, long data truncated: devices pad differently."""
        return int.from_bytes(data[: self.type.size], "little", signed=self.type.signed)

    def shown(self, raw: int) -> str:
        """Return a raw value as text: hexadecimal, or the number of a real type."""
        return f"{self.type.number_of(raw):.{7 if self.type.size == 4 else 15}g}" if self.type.real else f"{raw:#x}"


@dataclass(frozen=True)
class Write:
    """An object and its required value. `kept` masks the bits that keep the node's value."""

    entry: Object
    value: int
    optional: bool = False  # the node may lack the object
    kept: int = 0
    rated: Object | None = None  # if set, `value` is in per mille of the value of this object
    watchdog: bool = False  # makes the drive stop if this computer fails
    fine: frozenset[int] = frozenset()  # equivalent values that the node may keep instead


# CiA 301
DEVICE_TYPE = Object(0x1000, 0, Type.U32, "device type")
ERROR_REGISTER = Object(0x1001, 0, Type.U8, "error register")
ERROR_HISTORY_COUNT = Object(0x1003, 0, Type.U8, "error history count")
ERROR_HISTORY = Object(0x1003, 1, Type.U32, "newest entry of the error history")
SYNC_COB_ID = Object(0x1005, 0, Type.U32, "SYNC COB-ID")
SYNC_PERIOD = Object(0x1006, 0, Type.U32, "SYNC period")  # us
SYNC_WINDOW = Object(0x1007, 0, Type.U32, "SYNC window")  # us
GUARD_TIME = Object(0x100C, 0, Type.U16, "guard time")  # ms
LIFE_TIME_FACTOR = Object(0x100D, 0, Type.U8, "life time factor")
EMCY_COB_ID = Object(0x1014, 0, Type.U32, "EMCY COB-ID")
EMCY_INHIBIT = Object(0x1015, 0, Type.U16, "inhibit time EMCY")  # 100 us
HEARTBEAT_CONSUMERS = Object(0x1016, 0, Type.U8, "number of heartbeat consumers")
HEARTBEAT_CONSUMER = Object(0x1016, 1, Type.U32, "heartbeat consumer")  # node << 16 | ms
HEARTBEAT_PRODUCER = Object(0x1017, 0, Type.U16, "heartbeat producer")  # ms
VENDOR_ID = Object(0x1018, 1, Type.U32, "vendor")
PRODUCT_CODE = Object(0x1018, 2, Type.U32, "product code")
REVISION = Object(0x1018, 3, Type.U32, "revision")
SERIAL_NUMBER = Object(0x1018, 4, Type.U32, "serial number")
SYNC_COUNTER = Object(0x1019, 0, Type.U8, "SYNC counter")  # value at which it wraps; 0: SYNC without a counter
ERROR_BEHAVIOUR = Object(0x1029, 1, Type.U8, "reaction to communication errors")  # 0 pre-operational, 1 none, 2 stopped
RPDO_EVENT_TIMER = Object(0x1400, 5, Type.U16, "RPDO event timer")  # ms

# CiA 402
CONNECTION_LOSS = Object(0x6007, 0, Type.I16, "reaction to a lost connection")
ERROR_CODE = Object(0x603F, 0, Type.U16, "error code")
CONTROLWORD = Object(0x6040, 0, Type.U16, "controlword")
STATUSWORD = Object(0x6041, 0, Type.U16, "statusword")
QUICK_STOP_OPTION = Object(0x605A, 0, Type.I16, "quick stop reaction")
SHUTDOWN_OPTION = Object(0x605B, 0, Type.I16, "shutdown reaction")
DISABLE_OPTION = Object(0x605C, 0, Type.I16, "disable operation reaction")
HALT_OPTION = Object(0x605D, 0, Type.I16, "halt reaction")
FAULT_REACTION_OPTION = Object(0x605E, 0, Type.I16, "fault reaction")
MODE = Object(0x6060, 0, Type.I8, "mode of operation")
MODE_DISPLAY = Object(0x6061, 0, Type.I8, "mode of operation display")
POSITION_ACTUAL = Object(0x6064, 0, Type.I32, "position actual value")
VELOCITY_ACTUAL = Object(0x606C, 0, Type.I32, "velocity actual value")
TARGET_TORQUE = Object(0x6071, 0, Type.I16, "target torque")
MAX_TORQUE = Object(0x6072, 0, Type.U16, "max torque")  # per mille of rated torque
MAX_CURRENT = Object(0x6073, 0, Type.U16, "max current")  # per mille of rated current
RATED_CURRENT = Object(0x6075, 0, Type.U32, "motor rated current")  # mA
RATED_TORQUE = Object(0x6076, 0, Type.U32, "motor rated torque")
TORQUE_ACTUAL = Object(0x6077, 0, Type.I16, "torque actual value")
MAX_MOTOR_SPEED = Object(0x6080, 0, Type.U32, "max motor speed")
POLARITY = Object(0x607E, 0, Type.U8, "polarity")
TORQUE_SLOPE = Object(0x6087, 0, Type.U32, "torque slope")  # per mille of rated torque per s
TORQUE_PROFILE = Object(0x6088, 0, Type.I16, "torque profile type")  # 0 linear, 1 sine squared
ENCODER_INCREMENTS = Object(0x608F, 1, Type.U32, "encoder increments")
ENCODER_REVOLUTIONS = Object(0x608F, 2, Type.U32, "motor revolutions")
GEAR_MOTOR = Object(0x6091, 1, Type.U32, "motor shaft revolutions")
GEAR_SHAFT = Object(0x6091, 2, Type.U32, "driving shaft revolutions")
FEED = Object(0x6092, 1, Type.U32, "feed constant")
FEED_SHAFT = Object(0x6092, 2, Type.U32, "driving shaft revolutions of the feed constant")
VELOCITY_UNIT = Object(0x60A9, 0, Type.U32, "SI unit velocity")
DIGITAL_INPUTS = Object(0x60FD, 0, Type.U32, "digital inputs")
POSITION_OFFSET = Object(0x60B0, 0, Type.I32, "position offset")
VELOCITY_OFFSET = Object(0x60B1, 0, Type.I32, "velocity offset")
TORQUE_OFFSET = Object(0x60B2, 0, Type.I16, "torque offset")  # per mille of rated torque
POSITIVE_TORQUE_LIMIT = Object(0x60E0, 0, Type.U16, "positive torque limit")  # per mille of rated torque
NEGATIVE_TORQUE_LIMIT = Object(0x60E1, 0, Type.U16, "negative torque limit")  # per mille of rated torque
INTERPOLATION_PERIOD = Object(0x60C2, 1, Type.U8, "interpolation period")
INTERPOLATION_EXPONENT = Object(0x60C2, 2, Type.I8, "interpolation period exponent")
AXIS_DEVICE_TYPE = Object(0x67FF, 0, Type.U32, "device type of the axis")
SUPPORTED_MODES = Object(0x6502, 0, Type.U32, "supported modes")

# CiA 404 and 406
PROCESS_VALUE = Object(0x9130, 1, Type.I32, "process value")
MEASURING_UNITS = Object(0x6001, 0, Type.U32, "measuring units per revolution")
TOTAL_RANGE = Object(0x6002, 0, Type.U32, "total measuring range")
ENCODER_POSITION = Object(0x6004, 0, Type.U32, "position value")

TABLE: tuple[Object, ...] = tuple(value for value in dict(globals()).values() if isinstance(value, Object))
