"""Strict settings of a bus and of the nodes of one axis, in SI units. The controller file consists of these."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import Enum
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

NodeId = Annotated[int, Meta(ge=1, le=127)]
# Limits beyond which a value is in another unit
Torque = Annotated[float, Meta(gt=0.0, le=1e4)]  # N*m
Ratio = Annotated[float, Meta(gt=0.0, le=1e4)]
Speed = Annotated[float, Meta(gt=0.0, le=1e4)]  # rad/s
Frequency = Annotated[float, Meta(gt=0.0, le=1e5)]  # Hz
Fraction = Annotated[float, Meta(gt=0.0, le=1.0)]
Sign = Literal[1, -1]
Word = Annotated[int, Meta(ge=0, le=0xFFFFFFFF)]
Seconds = Annotated[float, Meta(ge=0.001, le=10.0)]
Counts = Annotated[int, Meta(ge=1, le=1 << 32)]
Patience = Annotated[float, Meta(ge=0.05, le=60.0)]
MOST_SLOTS = 8  # axes of one device (CiA 301)
Cycles = Annotated[int, Meta(ge=0, le=100)]


class Role(Enum):
    """Roles of a node."""

    DRIVE = "drive"
    ENCODER = "joint encoder"
    TORQUE_SENSOR = "torque sensor"

    @property
    def key(self) -> str:
        """Return the key of its section in the file."""
        return self.name.lower()


class SupervisionSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Conditions that stop a running axis. Every other event (EMCY, boot-up, bus-off, ...) always stops it."""

    tolerated_misses: Cycles = 2  # consecutive cycles without a fresh PDO; one more is a fault
    tolerated_drops: Cycles = 2  # consecutive commands that could not be sent; one more is a fault
    lost_share: Fraction = 0.2  # share, 1, of the periods in a second that were skipped or lost an answer or command
    enable_timeout: Seconds = 2.0  # s, from the request to operation enabled
    disable_timeout: Seconds = 1.0  # s, from the request to the drive's confirmation
    reset_timeout: Seconds = 2.0  # s, until the drive has left its fault

    def most_lost(self, rate: float) -> int:
        """Return the number of lost periods within a second that is a fault, at this rate in Hz."""
        return max(self.tolerated_misses + 1, self.tolerated_drops + 1, math.ceil(self.lost_share * rate))


class BusSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One CAN bus."""

    name: str = ""  # of one of several buses; an axis refers to it
    interface: Annotated[str, Meta(min_length=1)] = "socketcan"  # or "datagram", or any python-can interface
    channel: Annotated[str, Meta(pattern=r"^[^\0]+$")] = "vcan0"
    bitrate: Annotated[int, Meta(ge=10_000, le=1_000_000)] = 1_000_000  # bit/s
    options: dict[str, str | int | float | bool] = {}  # further arguments of the python-can interface
    rpdo: Literal["sync", "arrival"] = "sync"  # a torque is applied at the next SYNC, or on arrival
    host_node_id: NodeId = 127  # of our heartbeat
    host_heartbeat_period: Seconds = 0.02  # s
    max_load: Fraction = 0.9  # share of the bit rate with worst-case bit stuffing; more is rejected at startup
    send_queue: Annotated[int, Meta(ge=4, le=1024)] = 32  # frames that may wait in the kernel
    supervision: SupervisionSettings = SupervisionSettings()

    @property
    def header(self) -> str:
        """Return the header of its table in the file."""
        return f"[[bus]] '{self.name}'" if self.name else "[bus]"


class NodeSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Settings that every node has."""

    node_id: NodeId
    vendor_id: Word | None = None  # 0x1018:1; checked if set
    product_code: Word | None = None  # 0x1018:2; checked if set
    serial_number: Word | None = None  # 0x1018:4; checked if set
    heartbeat_period: Seconds = 0.05  # s, 0x1017
    heartbeat_timeout: Seconds = 0.2  # s without a heartbeat; then a fault
    boot_timeout: Patience | None = None  # s, from a reset to the boot-up; default: 3, or the value of the profile
    answer_timeout: Patience | None = None  # s, for one SDO answer; default: 0.5, or the value of the profile


class DriveSettings(NodeSettings, frozen=True, kw_only=True):
    """A CiA 402 drive in cyclic synchronous torque mode. Torque, speed and angle are at the motor pulley."""

    slot: Annotated[int, Meta(ge=1, le=MOST_SLOTS)] = 1  # place in a device with several axes: objects 0x800 apart
    pdo_node_id: NodeId | None = None  # node id of its PDO identifiers; default: its own, for slots 1 and 2
    profile: str = "generic"  # name of a file in drives/ next to the configuration, or a path
    rated_torque: Torque = 1.0  # N*m of the motor, the required value of 0x6076
    counts_per_revolution: Counts = 65536  # of the motor, 0x6064
    gear_ratio: Ratio = 1.0  # motor revolutions per revolution of the motor pulley
    torque_sign: Sign = 1
    position_sign: Sign = 1  # of position and velocity
    polarity: Annotated[int, Meta(ge=0, le=255)] | None = None  # 0x607E, written; default: it must reverse no sign
    pdo: Literal["standard", "lean"] = "standard"  # lean: one TPDO each SYNC, without 0x606C; mode and error every 50th
    velocity_source: Literal["drive", "position"] = "drive"  # 0x606C, or 0x6064 differentiated
    velocity_cutoff: Frequency = 100.0  # Hz, of the filter of the differentiated position
    max_torque: Torque | None = None  # N*m, the drive's own clamp 0x6072; default: rated torque times gear ratio
    max_speed: Speed = 50.0  # rad/s, the drive's own clamp 0x6080; default in a file: limits.motor_over_speed
    host_timeout: Seconds = 0.1  # s without our heartbeat, 0x1016: the drive stops
    rpdo_timeout: Seconds = 0.02  # s without a command, 0x1400:5, if the drive has it
    connection_loss: Literal["fault", "disable_voltage", "quick_stop"] = "fault"  # 0x6007
    require_watchdog: bool = True  # reject a drive that would continue when this computer fails

    @property
    def differentiates(self) -> bool:
        """Return True if the velocity comes from 0x6064, because 0x606C is not received or not used."""
        return self.pdo == "lean" or self.velocity_source == "position"


class EncoderSettings(NodeSettings, frozen=True, kw_only=True):
    """A CiA 406 joint encoder."""

    counts_per_revolution: Counts = 1 << 20
    counts_range: Counts = 1 << 32  # value at which the position wraps
    sign: Sign = 1
    zero: Annotated[int, Meta(ge=0, le=0xFFFFFFFF)] = 0  # counts at q_j = 0
    velocity_cutoff: Frequency = 50.0  # Hz, first-order low-pass on the differentiated position


class TorqueSensorSettings(NodeSettings, frozen=True, kw_only=True):
    """A CiA 404 joint torque sensor. `control.direction` decides when it determines the slip direction."""

    every: Annotated[int, Meta(ge=1, le=2)] | None = None  # SYNCs per answer; default: 1, or 2 if the bit rate needs it
    resolution: Torque = 1e-6  # N*m per digit of 0x9130:1
    sign: Sign = 1
    offset: Annotated[float, Meta(ge=-1e4, le=1e4)] = 0.0  # N*m, subtracted


class AxisNodes(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The nodes of one axis; only the drive is required."""

    name: Annotated[str, Meta(min_length=1)]
    bus: str | None = None  # name of its bus; default: the only bus
    drive: DriveSettings
    encoder: EncoderSettings | None = None
    torque_sensor: TorqueSensorSettings | None = None

    def nodes(self) -> Iterator[tuple[Role, NodeSettings]]:
        """Yield the configured nodes with their roles, the drive first."""
        yield Role.DRIVE, self.drive
        if self.encoder is not None:
            yield Role.ENCODER, self.encoder
        if self.torque_sensor is not None:
            yield Role.TORQUE_SENSOR, self.torque_sensor
