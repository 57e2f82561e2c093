"""The one seam to the world: the interface of a CAN bus for the rest of the package.

A frame is `(can_id, data)`: an 11-bit identifier and 0 to 8 bytes. An error frame has `ERROR_FLAG` set in its
identifier, its class in the bits below and its details in the data (Linux `can/error.h`, see `ErrorClass`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, IntFlag
from typing import Protocol

ERROR_FLAG = 0x20000000  # CAN_ERR_FLAG
EXTENDED_FLAG = 0x80000000  # CAN_EFF_FLAG
REMOTE_FLAG = 0x40000000  # CAN_RTR_FLAG

FLUSH_LIMIT = 100_000  # frames; a bus never holds more, so a flood cannot keep flush() busy for ever

Frame = tuple[int, bytes]


class BusFault(Enum):
    """Why a bus cannot carry torque any longer; latched until `Bus.clear_fault`."""

    INTERFACE_DOWN = "the interface is down"
    INTERFACE_GONE = "the interface is gone"
    BUS_OFF = "the controller is bus-off"
    ADAPTER = "the adapter failed"


@dataclass(slots=True)
class Counters:
    """Frames since the bus was opened; `dropped` were given to `send` and never reached the wire."""

    sent: int = 0
    dropped: int = 0
    error_frames: int = 0


class Bus(Protocol):
    """A CAN bus. Never blocks in `send`, never queues stale frames, never receives its own frames."""

    name: str
    counters: Counters
    fault: BusFault | None

    def clock(self) -> float:
        """The time that this bus lives in, s, monotonic: CLOCK_MONOTONIC unless the bus is simulated with its nodes."""
        ...

    def send(self, can_id: int, data: bytes) -> bool:
        """Send one frame; False when it was dropped (queue full, interface down), which is counted."""
        ...

    def recv(self, timeout: float) -> Frame | None:
        """The next frame, waiting at most `timeout` s; None without one or if the bus has failed (see `fault`)."""
        ...

    def gather(self, until: float, most: int) -> Sequence[Frame]:
        """Sleep until `until` (monotonic s; not at all when it is over), then take what has come, `most` at most."""
        ...

    def listen_for(self, can_id: int) -> None:
        """Name the identifier that `answers` waits for: the last one of a cycle."""
        ...

    def answers(self, timeout: float, most: int) -> Sequence[Frame]:
        """Wait for the frame named to `listen_for`, `timeout` s at most, then take what has come, `most` at most.

        Spares a cycle to be woken by each answer. It may be woken early, so the caller waits for the rest.
        """
        ...

    def expect(self, until: float) -> None:
        """Said before the sleep: the next `answers` need not wait longer than `until` (monotonic s).

        A timer that is set then costs the cycle nothing; `timeout` holds all the same, give or take the kernel's tick.
        """
        ...

    def accept(self, can_ids: Iterable[int] | None) -> None:
        """Receive these identifiers (and error frames) only; None receives all."""
        ...

    def flush(self) -> int:
        """Throw away what waits to be received; the number of frames thrown away."""
        ...

    def clear_fault(self) -> None:
        """Clear a latched fault after a request for a new start."""
        ...

    def fileno(self) -> int:
        """Descriptor that becomes readable with a frame, or -1."""
        ...

    def close(self) -> None:
        """Release the bus; may be called twice."""
        ...


class BusInProcess:
    """Implement the parts of `Bus` that need no support by the kernel."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.counters = Counters()
        self.fault: BusFault | None = None

    def clock(self) -> float:
        return time.monotonic()

    def gather(self, until: float, most: int) -> Sequence[Frame]:
        raise NotImplementedError

    def expect(self, until: float) -> None:
        """Do nothing: waiting sets its own timer."""

    def flush(self) -> int:
        return len(self.gather(0.0, FLUSH_LIMIT))

    def clear_fault(self) -> None:
        self.fault = None


class ErrorClass(IntFlag):
    """Class bits in the identifier of an error frame of a CAN controller."""

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
    ErrorClass.NO_ACKNOWLEDGE: "no acknowledge: no other node is on the bus",
    ErrorClass.BUS_OFF: "bus-off",
    ErrorClass.BUS_ERROR: "bus error",
    ErrorClass.RESTARTED: "controller restarted",
}


def describe(can_id: int, data: bytes) -> str:
    """Return the meaning of an error frame in words."""
    words = [name for error_class, name in NAMES.items() if can_id & error_class]
    if can_id & ErrorClass.CONTROLLER and len(data) > 1:
        words += [name for bit, name in CONTROLLER_STATES if data[1] & bit]
    return ", ".join(words) if words else f"error frame 0x{can_id & 0x1FFFFFFF:08X}"
