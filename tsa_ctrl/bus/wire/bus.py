"""Interface of a CAN bus for the rest of the package, and a group of several buses behind the same interface.

A frame is `(can_id, data)`: an 11-bit identifier and 0 to 8 bytes. An error frame has `ERROR_FLAG` in its identifier,
its class in the bits below and its details in the data (see `ErrorClass` and Linux `can/error.h`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, IntFlag
from select import select
from typing import Protocol

ERROR_FLAG = 0x20000000  # CAN_ERR_FLAG
EXTENDED_FLAG = 0x80000000  # CAN_EFF_FLAG
REMOTE_FLAG = 0x40000000  # CAN_RTR_FLAG

FLUSH_LIMIT = 100_000  # frames; a bus never holds more, so that a flood cannot keep flush() busy forever

Frame = tuple[int, bytes]


class BusFault(Enum):
    """Reason why a bus can no longer carry torque; latched until `Bus.clear_fault`."""

    INTERFACE_DOWN = "the interface is down"
    INTERFACE_GONE = "the interface is gone"
    BUS_OFF = "the controller is bus-off"
    ADAPTER = "the adapter failed"


@dataclass(slots=True)
class Counters:
    """Numbers of frames since the bus was opened. `dropped` frames were passed to `send` and never reached the wire."""

    sent: int = 0
    dropped: int = 0
    error_frames: int = 0


class Bus(Protocol):
    """A CAN bus. It never blocks in `send`, never queues stale frames, and never receives its own frames."""

    name: str
    counters: Counters
    fault: BusFault | None

    def clock(self) -> float:
        """Return the monotonic time of this bus, s: CLOCK_MONOTONIC unless the bus is simulated with its nodes."""
        ...

    def send(self, can_id: int, data: bytes) -> bool:
        """Send one frame; return False if it was dropped (queue full, interface down), which is counted."""
        ...

    def recv(self, timeout: float) -> Frame | None:
        """Return the next frame within `timeout` s, or None if none arrives or the bus has failed (see `fault`)."""
        ...

    def gather(self, until: float, most: int) -> Sequence[Frame]:
        """Sleep until `until` (monotonic s, may be past), then return the received frames, at most `most`."""
        ...

    def listen_for(self, can_id: int) -> None:
        """Set the identifier that `answers` waits for: the last one of a cycle."""
        ...

    def answers(self, timeout: float, most: int) -> Sequence[Frame]:
        """Wait at most `timeout` s for the frame set by `listen_for`, then return the received frames, at most `most`.

        This avoids a wake-up of the cycle by each answer. The call may return early, so the caller waits for the rest.
        """
        ...

    def expect(self, until: float) -> None:
        """Announce before a sleep that the next `answers` need not wait beyond `until` (monotonic s).

        A timer that is set before the sleep takes no time in the cycle. `timeout` still applies, within one kernel
        tick.
        """
        ...

    def accept(self, can_ids: Iterable[int] | None) -> None:
        """Receive only these identifiers and error frames; None receives all."""
        ...

    def flush(self) -> int:
        """Discard the waiting frames, and return their number."""
        ...

    def clear_fault(self) -> None:
        """Clear a latched fault after a request for a new start."""
        ...

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when a frame arrives, or -1."""
        ...

    def close(self) -> None:
        """Release the bus; may be called twice."""
        ...


class BusInProcess:
    """Implement the parts of `Bus` that need no kernel support."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.counters = Counters()
        self.fault: BusFault | None = None

    def clock(self) -> float:
        return time.monotonic()

    def gather(self, until: float, most: int) -> Sequence[Frame]:
        raise NotImplementedError

    def expect(self, until: float) -> None:
        """Do nothing, because a wait sets its own timer."""

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


_NMT = 0x000  # CiA 301: its second byte is the node, 0 means all
_SLICE = 1e-3  # s between two polls of the other buses if a bus has no descriptor


class BusGroup(BusInProcess):
    """Implement `Bus` for several buses: a frame is sent on the bus of its node, or on all buses.

    Node ids, and therefore all identifiers, are unique over the buses of a group. SYNC, the host's heartbeat and NMT
    commands to all nodes go to every bus.

    Attributes:
        wires: the buses.
    """

    def __init__(self, wires: Sequence[Bus], by_id: Mapping[int, int], by_node: Mapping[int, int]) -> None:
        """Join buses.

        Args:
            wires: at least one bus.
            by_id: index in `wires` for each identifier that is sent to one node.
            by_node: index in `wires` for each node.
        """
        self.wires = tuple(wires)
        super().__init__(" and ".join(wire.name for wire in wires))
        self._by_id = {can_id: (self.wires[place],) for can_id, place in by_id.items()}
        self._by_node = {node_id: (self.wires[place],) for node_id, place in by_node.items()}

    def of(self, node_id: int) -> Bus:
        """Return the bus of a node; an unknown node is on the first bus."""
        return self._by_node.get(node_id, self.wires)[0]

    @property
    def counters(self) -> Counters:
        """Return the sum over all buses."""
        each = [wire.counters for wire in self.wires]
        return Counters(
            sum(one.sent for one in each), sum(one.dropped for one in each), sum(one.error_frames for one in each)
        )

    @counters.setter
    def counters(self, counters: Counters) -> None:
        """Do nothing: each bus counts its own frames."""

    @property
    def fault(self) -> BusFault | None:
        """Return the fault of the first bus that has one."""
        return next((wire.fault for wire in self.wires if wire.fault is not None), None)

    @fault.setter
    def fault(self, fault: BusFault | None) -> None:
        """Do nothing: each bus latches its own fault."""

    def clock(self) -> float:
        return self.wires[0].clock()

    def send(self, can_id: int, data: bytes) -> bool:
        wires = self._by_node.get(data[1], self.wires) if can_id == _NMT else self._by_id.get(can_id, self.wires)
        sent = True
        for wire in wires:
            sent = wire.send(can_id, data) and sent
        return sent

    def recv(self, timeout: float) -> Frame | None:
        place, frame = next_frame(self.wires, timeout)
        return None if frame is None else self._checked(self.wires[place], (frame,))[0]

    def gather(self, until: float, most: int) -> Sequence[Frame]:
        found: list[Frame] = []
        for wire in self.wires:
            found += self._checked(wire, wire.gather(until, most))
        return found

    def listen_for(self, can_id: int) -> None:
        """Set the last identifier on the bus of its node; the last ones of the other buses stay."""
        for wire in self._by_id.get(can_id, ()):
            wire.listen_for(can_id)

    def expect(self, until: float) -> None:
        for wire in self.wires:
            wire.expect(until)

    def answers(self, timeout: float, most: int) -> Sequence[Frame]:
        end = self.clock() + timeout
        found: list[Frame] = []
        for wire in self.wires:
            found += self._checked(wire, wire.answers(end - self.clock(), most))
        return found

    def accept(self, can_ids: Iterable[int] | None) -> None:
        accepted = None if can_ids is None else set(can_ids)
        for wire in self.wires:
            wire.accept(accepted)

    def clear_fault(self) -> None:
        for wire in self.wires:
            wire.clear_fault()

    def fileno(self) -> int:
        """Return -1, because one descriptor cannot represent several buses."""
        return -1

    def close(self) -> None:
        for wire in self.wires:
            wire.close()

    def _checked(self, wire: Bus, frames: Sequence[Frame]) -> Sequence[Frame]:
        """Latch bus-off at the bus whose controller reports it."""
        for can_id, _ in frames:
            if can_id & ERROR_FLAG and can_id & ErrorClass.BUS_OFF and wire.fault is None:
                wire.fault = BusFault.BUS_OFF
        return frames


def next_frame(wires: Sequence[Bus], timeout: float) -> tuple[int, Frame | None]:
    """Wait at most `timeout` s for a frame on any bus; return the index of its bus, and the frame or None."""
    if len(wires) == 1:
        return 0, wires[0].recv(timeout)
    clock = wires[0].clock
    end = clock() + timeout
    while True:
        for place, wire in enumerate(wires):
            frame = wire.recv(0.0)
            if frame is not None:
                return place, frame
        left = end - clock()
        if left <= 0.0 or any(wire.fault is not None for wire in wires):
            return 0, None
        descriptors = [wire.fileno() for wire in wires]
        if min(descriptors) >= 0:
            select(descriptors, (), (), left)
        elif (frame := wires[0].recv(min(left, _SLICE))) is not None:
            return 0, frame


def wires_of(bus: Bus) -> tuple[Bus, ...]:
    """Return the buses of a group, or the bus itself."""
    return bus.wires if isinstance(bus, BusGroup) else (bus,)


def wire_of(bus: Bus, node_id: int) -> Bus:
    """Return the bus of a node."""
    return bus.of(node_id) if isinstance(bus, BusGroup) else bus
