"""Error frames of a CAN controller (Linux `can/error.h`): class bits of the identifier and their names."""

from __future__ import annotations

from enum import IntFlag


class ErrorClass(IntFlag):
    """Bits of the identifier of an error frame."""

    TX_TIMEOUT = 0x001
    LOST_ARBITRATION = 0x002
    CONTROLLER = 0x004
    PROTOCOL = 0x008
    TRANSCEIVER = 0x010
    NO_ACKNOWLEDGE = 0x020
    BUS_OFF = 0x040
    BUS_ERROR = 0x080
    RESTARTED = 0x100


CONTROLLER_STATES = (  # bits of data[1] with CONTROLLER
    (0x01, "receive buffer overflow"),
    (0x02, "transmit buffer overflow"),
    (0x04, "receive warning level"),
    (0x08, "transmit warning level"),
    (0x10, "receive error passive"),
    (0x20, "transmit error passive"),
    (0x40, "error active again"),
)

NAMES = {
    ErrorClass.TX_TIMEOUT: "transmission timed out",
    ErrorClass.LOST_ARBITRATION: "arbitration lost",
    ErrorClass.CONTROLLER: "controller problem",
    ErrorClass.PROTOCOL: "protocol violation",
    ErrorClass.TRANSCEIVER: "transceiver problem",
    ErrorClass.NO_ACKNOWLEDGE: "no acknowledge: nobody else is on the bus",
    ErrorClass.BUS_OFF: "bus-off",
    ErrorClass.BUS_ERROR: "bus error",
    ErrorClass.RESTARTED: "controller restarted",
}


def describe(can_id: int, data: bytes) -> str:
    """What an error frame says, in words."""
    words = [name for error_class, name in NAMES.items() if can_id & error_class]
    if can_id & ErrorClass.CONTROLLER and len(data) > 1:
        words += [name for bit, name in CONTROLLER_STATES if data[1] & bit]
    return ", ".join(words) if words else f"error frame 0x{can_id & 0x1FFFFFFF:08X}"
