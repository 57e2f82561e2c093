"""Define the causes of faults as data: title, remedy, and whether the nodes need a new bring-up.

Everything that reports a fault reads this table: status, dashboard, summary, events and the manual's table of hazards.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

_BRING_UP = "then recover: the nodes are configured again"


class Cause(Enum):
    """The cause of a fault.

    Attributes:
        id: stable name for programs, `cause_id` in JSON.
        title: name for people; the text of a fault begins with it.
        remedy: the steps that the user takes.
        needs_bring_up: True if the nodes may have lost their configuration, so that a reset alone is not enough.
    """

    BUS_FAULT = "bus fault", f"check cable, termination and bit rate; the interface may be down; {_BRING_UP}", True
    SECOND_MASTER = (
        "second master",
        f"another program commands this bus: end it (the message has its identifier); {_BRING_UP}",
        True,
    )
    ALTERED = (
        "a node's configuration changed",
        f"another tool wrote to the node, or it lost its settings by itself: end that; {_BRING_UP}",
        True,
    )
    BOOT_UP = (
        "node booted while running",
        f"the node lost its power or was reset: check supply and plug, look for brown-outs; {_BRING_UP}",
        True,
    )
    HEARTBEAT_LOST = (
        "heartbeat lost",
        f"check the node's power and plug, and the bus load (tsa doctor); {_BRING_UP}",
        True,
    )
    NMT_STATE = (
        "node left the operational state",
        f"another master or the node itself left the operational state: end that; {_BRING_UP}",
        True,
    )
    EMERGENCY_STOP = "emergency stop", "remove the reason for the stop and release it; then recover"
    EMERGENCY = "emergency", "look up the code in the drive's manual and remove its reason; then recover"
    HELD_UP = (
        "emergency, commands too late",
        "the loop was held up for longer than the drive's time-out: run tsa doctor, choose a lower rate; then recover",
    )
    DRIVE_FAULT = (
        "drive fault",
        "look up the drive's error code (0x603F) in its manual and remove its reason; then recover",
    )
    STALE_PDO = (
        "stale PDO",
        "check bus load, nodes that answer late, and a computer that stalls: tsa doctor; then recover",
    )
    SKIPPED = (
        "skipped periods",
        "a cycle takes longer than its period: choose a lower rate in [controller] (tsa doctor); then recover",
    )
    REPEATED_PDO = (
        "repeated PDOs",
        f"two nodes have one id: give each its own (switches, maker's tool, tsa drive set-node-id); {_BRING_UP}",
        True,
    )
    COMMAND_DROPPED = (
        "commands not sent",
        "the send queue is full: no node acknowledges, or the bus is too slow: tsa doctor; then recover",
    )
    COMMANDS_MISSED = (
        "the drive misses commands",
        "commands are lost, or the drive reads them too seldom: check the bus load (tsa doctor) and the drive's cycle "
        "against rate in [controller]; if it only shows 0x6071 late: lost_share in [bus.supervision]; then recover",
    )
    WRONG_MODE = "wrong mode", "another tool or the drive changed its mode: end that; then recover"
    COMMAND_IGNORED = (
        "drive ignores the command",
        "check its enable input, quick stop and internal limits; if it never sets bit 12: reports_following = false in "
        "its profile; then recover",
    )
    STATE_LOST = (
        "drive left operation enabled",
        "check safe torque off, a switch at the drive, a warning that became a fault; then recover",
    )
    ENABLE_TIMEOUT = (
        "drive does not enable",
        "check safe torque off, main power and enable input; a slow drive needs more enable_timeout in "
        "[bus.supervision]; then recover",
    )
    DISABLE_TIMEOUT = (
        "drive does not confirm that it is disabled",
        "cut its power: it may still give torque; then check the drive",
    )
    RESET_TIMEOUT = (
        "drive does not leave its fault",
        "the reason of the drive's fault is still present: see its manual, remove it; then power the drive off and on",
    )
    OVER_SPEED = (
        "over-speed",
        "check the tendons before anything else: torn or off the pulley; then the joint encoder; then [axis.limits] "
        "speed; then recover",
    )
    NOT_FINITE = (
        "value that is not finite",
        "a measurement or a parameter is not a number: check the sensors and the last tsa set; then recover",
    )
    TORQUE_ERROR = (
        "reported torque differs from the command",
        "check the drive's limits, derating, torque constant and sign; then recover",
    )
    FROZEN = (
        "the drive's feedback is frozen",
        "the drive repeats old values: check its firmware, and every device between it and the bus; then recover",
    )
    MOVED_APART = (
        "motor and joint moved apart",
        "check the tendons: torn, loose or slipped; then coupling, counts and signs of the encoders (torque_sign, "
        "position_sign); tendons softer than axial_stiffness: set [axis.plausibility] slip; then recover",
    )
    POLARITY = (
        "motor and joint answer the motor's torque the wrong way round",
        "check torque_sign and position_sign of the drive, the sign of the encoder, crossed tendons or motor wires; "
        "then recover",
    )
    VELOCITY = (
        "velocity contradicts position",
        "check the drive's encoder and the unit of 0x606C; if the drive does not fill 0x606C: velocity_source in "
        "[axis.drive]; then recover",
    )
    ENCODER_STUCK = (
        "joint encoder is stuck",
        "check the encoder, its cable and its coupling, and any device that repeats old values; then recover",
    )
    TORQUE_SENSOR_STUCK = (
        "joint torque sensor is stuck",
        "check the sensor, its amplifier and its cable, and any device that repeats old values; then recover",
    )
    JOINT_TORQUE = (
        "joint torque sensor contradicts the model",
        "compare sensor and motor at a small torque: zero, gain and sign of both; then the model (tsa calibrate); then "
        "recover",
    )
    SOFT_TENDONS = (
        "tendons too soft for the reported torque",
        "check pretension and tendons, torque constant and rated torque of the motor; then axial_stiffness in the "
        "model file ([axis.plausibility] slip replaces it by a given angle); then recover",
    )
    TORQUE_GAIN = (
        "joint torque exceeds the reported motor torque",
        "check torque constant and rated torque of the motor, and the gain of the sensor; then recover",
    )
    MONITOR_STOPPED = (
        "stopped by the monitor",
        "remove the reported cause; then recover: the nodes are configured again, and a new monitor starts",
    )
    MONITOR_ENDED = (
        "monitor ended",
        "find out what ended its process (memory, a kill); then recover: a new monitor starts",
    )
    MONITOR_SILENT = (
        "monitor silent",
        "the computer is overloaded, or the monitor was stopped: tsa doctor; then recover",
    )

    def __init__(self, title: str, remedy: str, needs_bring_up: bool = False) -> None:
        self.id = self.name.lower()
        self.title = title
        self.remedy = remedy
        self.needs_bring_up = needs_bring_up


REMEDIES = {cause.id: cause.remedy for cause in Cause}


class Finding(NamedTuple):
    """Hold the result of a check: the cause, and one line with the place and the values of the finding."""

    cause: Cause
    detail: str

    def __str__(self) -> str:
        return f"{self.cause.title}: {self.detail}"


@dataclass(frozen=True, slots=True)
class Fault:
    """Hold a latched fault: `detail` has node and finding in one line; `time`: of the cycle, s."""

    cause: Cause
    detail: str
    time: float

    def __str__(self) -> str:
        return f"{self.cause.title}: {self.detail}"
