"""What to do about a fault, by the words that its message begins with or holds: for the status, the page, the manual.

The order counts: a contradiction found by the controller comes before the cause that latches it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tsa_ctrl.safety.supervisor import Cause

_BRING_UP = "then recover: the nodes are configured again"

_HELD_UP = "the loop was held up for longer than the drive's time-out: tsa doctor, a lower rate; then recover"

CURES: Mapping[str, str] = MappingProxyType(
    {
        "monitor: its process ended": "find the reason (memory, a kill); then recover: a new monitor starts",
        "monitor: no sign of life": "the computer is overloaded, or the monitor was stopped: tsa doctor; then recover",
        "monitor: ": "remove the reported cause, then recover: nodes are configured again, a new monitor starts",
        "over-speed at the limiter": (
            "look at the tendons before anything else: torn or off the pulley; then the joint encoder; "
            "then [axis.limits] speed"
        ),
        "moved apart": (
            "look at the tendons: torn, loose or slipped; then coupling, counts and signs of the encoders "
            "(torque_sign, position_sign); tendons that give more than axial_stiffness says: [axis.plausibility] slip"
        ),
        "the drive reports a velocity": (
            "its encoder and the unit of 0x606C; a drive that does not fill 0x606C: velocity_source in [axis.drive]"
        ),
        "encoder is stuck": "the encoder, its cable and its coupling; a device that repeats old values; then recover",
        "feedback is frozen": "the drive repeats old values: its firmware, or what sits between it and the bus",
        "the drive reports": "it gives another torque than is asked: its limits, derating, torque constant, sign",
        "the joint torque sensor says": (
            "compare sensor and motor at a small torque: zero, gain and sign of both, then the model (tsa calibrate)"
        ),
        "the wrong way round": (
            "torque_sign and position_sign of the drive, sign of the encoder, crossed tendons or motor wires; "
            "then recover"
        ),
        "the tendons give": (
            "pretension and tendons, torque constant and rated torque of the motor; then axial_stiffness in the model "
            "file ([axis.plausibility] slip takes a given angle instead)"
        ),
        "the joint torque sensor follows": "torque constant and rated torque of the motor, gain of the sensor",
        "held an older command": (
            "commands are lost on their way, or the drive looks for them too seldom: bus load (tsa doctor), its cycle "
            "against rate in [controller]; if it only shows 0x6071 late: lost_share in [bus.supervision]; then recover"
        ),
        Cause.BUS_FAULT.value: f"cable, termination, bit rate, or the interface was taken down; {_BRING_UP}",
        Cause.SECOND_MASTER.value: f"another program commands this bus: end it (who sends is said above); {_BRING_UP}",
        Cause.ALTERED.value: f"another tool wrote to it, or it lost its settings by itself: end that; {_BRING_UP}",
        Cause.BOOT_UP.value: f"the node lost its power or was reset: supply, plug, brown-out; {_BRING_UP}",
        Cause.HEARTBEAT_LOST.value: f"the node's power and plug; bus load (tsa doctor); {_BRING_UP}",
        Cause.NMT_STATE.value: f"somebody or the node itself left the operational state; {_BRING_UP}",
        "EMCY 0x8130": _HELD_UP,
        "EMCY 0x8250": _HELD_UP,
        Cause.EMERGENCY_STOP.value: "release it once the cause is removed; then recover",
        Cause.EMERGENCY.value: "the code in the drive's manual; take away what it names, then recover",
        Cause.DRIVE_FAULT.value: "read the drive's error code (0x603F) in its manual; take it away, then recover",
        Cause.STALE_PDO.value: "bus load, a late node, or a computer that stalls: tsa doctor; then recover",
        Cause.SKIPPED.value: "a cycle outlasts its period: a lower rate in [controller] (tsa doctor); then recover",
        Cause.REPEATED_PDO.value: (
            "two nodes of one id: give each its own (switches, maker's tool, tsa drive set-node-id); then recover"
        ),
        Cause.COMMAND_DROPPED.value: "the send queue is full: nobody acknowledges, or the bus is too slow: tsa doctor",
        Cause.WRONG_MODE.value: "another tool or the drive changed its mode: end that, then recover",
        Cause.COMMAND_IGNORED.value: (
            "the drive does not follow: its enable input, quick stop, internal limits; "
            "if it never sets bit 12: reports_following = false in its profile"
        ),
        Cause.STATE_LOST.value: "safe torque off, a switch at the drive, a warning that became a fault; then recover",
        Cause.ENABLE_TIMEOUT.value: (
            "safe torque off, main power, enable input; a slow drive: enable_timeout in [bus.supervision]"
        ),
        Cause.DISABLE_TIMEOUT.value: "take its power: nobody knows whether it gives torque; then look at the drive",
        Cause.RESET_TIMEOUT.value: "the reason of the drive's fault is still there: its manual; power cycle it",
        Cause.TRIPPED.value: "what the message names; then recover",
    }
)


def cure(message: str) -> str:
    """What to do about a fault with this message; empty for one that says so itself, and for one that nobody knows."""
    if "; " in message:
        return ""
    return next((words for needle, words in CURES.items() if needle in message), "")
