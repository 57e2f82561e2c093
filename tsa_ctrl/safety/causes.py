"""Define the causes of faults as data: title, remedy, and whether the nodes need a new bring-up.

Everything that reports a fault reads this table: status, dashboard, summary, events and the manual's table of hazards.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

_RECOVER = "then recover with tsa set recover 1"
_BRING_UP = f"{_RECOVER}, which configures the nodes again"
# EMCY codes of `HELD_UP`: no heartbeat of the host, RPDO timed out (CiA 301)
HELD_UP_CODES = frozenset({0x8130, 0x8250})


class Cause(Enum):
    """The cause of a fault.

    Attributes:
        id: stable name for programs, `cause_id` in JSON.
        title: readable name, with which the text of a fault begins.
        remedy: steps for the user.
        needs_bring_up: True if the nodes may have lost their configuration, so that a reset alone is not sufficient.
    """

    BUS_FAULT = (
        "bus fault",
        f"check cable, termination, bit rate, and that the interface is up; {_BRING_UP}",
        True,
    )
    SECOND_MASTER = (
        "second master",
        f"end the other program that commands this bus (the message contains its identifier); {_BRING_UP}",
        True,
    )
    ALTERED = (
        "a node's configuration changed",
        f"end the tool that wrote to the node, or check why the node lost its settings; {_BRING_UP}",
        True,
    )
    BOOT_UP = (
        "node booted while running",
        f"check the power supply and the plug of the node, and look for brown-outs; {_BRING_UP}",
        True,
    )
    HEARTBEAT_LOST = (
        "heartbeat lost",
        f"check the power and the plug of the node, and the bus load (tsa doctor); {_BRING_UP}",
        True,
    )
    NMT_STATE = (
        "node left the operational state",
        f"end the other master, or check why the node left the operational state by itself; {_BRING_UP}",
        True,
    )
    EMERGENCY_STOP = (
        "emergency stop",
        f"remove the reason for the stop and release it; {_RECOVER}",
    )
    EMERGENCY = (
        "emergency",
        f"look up the code in the manual of the drive and remove its cause; {_RECOVER}",
    )
    HELD_UP = (
        "emergency, commands too late",
        "the loop was held up for longer than the time-out of the drive: run tsa doctor and choose a lower "
        f"rate; {_RECOVER}",
    )
    DRIVE_FAULT = (
        "drive fault",
        f"look up the error code of the drive (0x603F) in its manual and remove its cause; {_RECOVER}",
    )
    STALE_PDO = (
        "stale PDO",
        f"check the bus load, nodes that answer late, and whether the computer stalls (tsa doctor); {_RECOVER}",
    )
    SKIPPED = (
        "skipped periods",
        f"a cycle takes longer than its period: choose a lower rate in [controller] (tsa doctor); {_RECOVER}",
    )
    REPEATED_PDO = (
        "repeated PDOs",
        "two nodes have the same id: give each its own id by its switches, the tool of its maker, or tsa "
        f"drive set-node-id; {_BRING_UP}",
        True,
    )
    COMMAND_DROPPED = (
        "commands not sent",
        f"the send queue is full because no node acknowledges or the bus is too slow: run tsa doctor; {_RECOVER}",
    )
    COMMANDS_MISSED = (
        "the drive misses commands",
        "commands are lost, or the drive reads them too rarely: check the bus load (tsa doctor), and the "
        "cycle of the drive against rate in [controller]; if the drive only reports 0x6071 late, raise "
        f"lost_share in [bus.supervision]; {_RECOVER}",
    )
    WRONG_MODE = (
        "wrong mode",
        f"end the tool that changed the mode of the drive, or check why the drive changed it; {_RECOVER}",
    )
    COMMAND_IGNORED = (
        "drive ignores the command",
        "check the enable input, quick stop and internal limits of the drive; if it never sets bit 12, set "
        f"reports_following = false in its profile; {_RECOVER}",
    )
    STATE_LOST = (
        "drive left operation enabled",
        f"check safe torque off, switches at the drive, and warnings that became a fault; {_RECOVER}",
    )
    ENABLE_TIMEOUT = (
        "drive does not enable",
        "check safe torque off, main power and the enable input; for a slow drive, raise enable_timeout in "
        f"[bus.supervision]; {_RECOVER}",
    )
    DISABLE_TIMEOUT = (
        "drive does not confirm that it is disabled",
        "cut the power of the drive, which may still give torque, then check it",
    )
    RESET_TIMEOUT = (
        "drive does not leave its fault",
        "look up the fault in the manual of the drive and remove its cause, which is still present, then "
        "switch the drive off and on",
    )
    OVER_SPEED = (
        "over-speed",
        "check the tendons before anything else: they may be torn or off the pulley; then check the joint "
        f"encoder, and over_speed and motor_over_speed in [axis.limits]; {_RECOVER}",
    )
    NOT_FINITE = (
        "value that is not finite",
        f"a measurement or a parameter is not a number: check the sensors and the last tsa set; {_RECOVER}",
    )
    TORQUE_ERROR = (
        "reported torque differs from the command",
        f"check limits, derating, torque constant and sign of the drive; {_RECOVER}",
    )
    FROZEN = (
        "the drive's feedback is frozen",
        f"the drive repeats old values: check its firmware, and every device between the drive and the bus; {_RECOVER}",
    )
    MOVED_APART = (
        "motor and joint moved apart",
        "check the tendons, which may be torn, loose or slipped; then coupling, counts and signs of the "
        "encoders (torque_sign, position_sign); if the tendons are softer than axial_stiffness, set "
        f"[axis.plausibility] slip; {_RECOVER}",
    )
    POLARITY = (
        "motor and joint answer the motor's torque the wrong way round",
        "check torque_sign and position_sign of the drive, the sign of the encoder, and crossed tendons or "
        f"motor wires; {_RECOVER}",
    )
    VELOCITY = (
        "velocity contradicts position",
        "check the encoder of the drive and the unit of 0x606C; if the drive does not fill 0x606C, set "
        f"velocity_source in [axis.drive]; {_RECOVER}",
    )
    ENCODER_STUCK = (
        "joint encoder is stuck",
        f"check the encoder, its cable and its coupling, and any device that repeats old values; {_RECOVER}",
    )
    TORQUE_SENSOR_STUCK = (
        "joint torque sensor is stuck",
        f"check the sensor, its amplifier and its cable, and any device that repeats old values; {_RECOVER}",
    )
    JOINT_TORQUE = (
        "joint torque sensor contradicts the model",
        "compare zero, gain and sign of sensor and motor at a small torque, then check the model (tsa "
        f"calibrate); {_RECOVER}",
    )
    SOFT_TENDONS = (
        "tendons too soft for the reported torque",
        "check the pretension, the tendons, and torque constant and rated torque of the motor; then check "
        f"axial_stiffness in the model file, or set a fixed angle by [axis.plausibility] slip; {_RECOVER}",
    )
    TORQUE_GAIN = (
        "joint torque exceeds the reported motor torque",
        f"check torque constant and rated torque of the motor, and the gain of the sensor; {_RECOVER}",
    )
    MONITOR_STOPPED = (
        "stopped by the monitor",
        f"remove the reported cause; {_BRING_UP} and starts a new monitor",
    )
    MONITOR_ENDED = (
        "monitor ended",
        f"find out what ended its process (memory, a kill); {_RECOVER}, which starts a new monitor",
    )
    MONITOR_SILENT = (
        "monitor silent",
        f"check whether the computer is overloaded or the monitor was stopped (tsa doctor); {_RECOVER}",
    )

    def __init__(self, title: str, remedy: str, needs_bring_up: bool = False) -> None:
        self.id = self.name.lower()
        self.title = title
        self.remedy = remedy
        self.needs_bring_up = needs_bring_up


REMEDIES = {cause.id: cause.remedy for cause in Cause}


class Finding(NamedTuple):
    """The result of a failed check: its cause, and one line with the place and the values."""

    cause: Cause
    detail: str

    def __str__(self) -> str:
        return f"{self.cause.title}: {self.detail}"


@dataclass(frozen=True, slots=True)
class Fault:
    """A latched fault.

    Attributes:
        cause: cause of the fault.
        detail: node and finding in one line.
        time: time of the cycle, s.
    """

    cause: Cause
    detail: str
    time: float

    def __str__(self) -> str:
        return f"{self.cause.title}: {self.detail}"
