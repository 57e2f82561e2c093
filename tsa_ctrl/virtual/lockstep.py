"""Simulate a CAN bus inside the process, with a virtual time that passes only while a caller waits.

The wire carries one frame at a time, (47 + 8 n) bits long. The waiting frame with the lowest identifier is sent next
(CAN arbitration), and its sender does not receive it. While a caller waits at the host's end, all due events are
processed in the order of time: arriving frames, timers of the machine, and scheduled events. The same calls therefore
produce the same bytes.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Protocol

from tsa_ctrl.bus.wire.bus import BusFault, Counters, Frame

NAME = "virtual time"
QUEUE = 128  # most waiting frames of one end; others are dropped
_OVERHEAD, _PER_BYTE = 47, 8  # bits of a frame with an 11-bit identifier, interframe space included, without stuffing

Action = Callable[[float], None]


class Nodes(Protocol):
    """Describe the other end of the wire: the simulated machine."""

    @property
    def due(self) -> float:
        """Return the time of the next event without a frame, s."""
        ...

    def step(self, frame: Frame | None, now: float, place: int = 0) -> None:
        """Process everything due at `now`, and a frame that has arrived on the wire at `place`."""
        ...


class Wire:
    """Hold the time (`now`, s), the frames in transit between the two ends, and the scheduled events."""

    def __init__(self, bitrate: float) -> None:
        """Create an idle wire; `bitrate` in bit/s."""
        self.now = 0.0
        self.host = HostEnd(self)
        self.plant = End(self)
        self.listeners: list[Callable[[Frame, float], None]] = []  # receive every transmitted frame and the time
        self._bit = 1.0 / bitrate
        self._up = True
        self._nodes: Nodes | None = None
        self._waiting: list[tuple[int, int, bytes, End]] = []  # identifier, order of sending, data, sender
        self._sent = 0
        self._frame: tuple[int, bytes, End] | None = None  # on the wire
        self._arrives = math.inf  # s, when its transmission ends
        self._scheduled = itertools.count()
        self._script: list[tuple[float, int, Action]] = []
        self._beside: list[Wire] = []  # further wires with the same clock
        self.place: tuple[int, ...] = ()  # place of this wire among several of the machine

    def attach(self, nodes: Nodes) -> None:
        """Connect the machine to the plant's end."""
        self._nodes = nodes

    def at(self, time: float, action: Action) -> None:
        """Call `action(now)` when the clock reaches `time`; if `time` is past, as soon as a caller waits."""
        heapq.heappush(self._script, (time, next(self._scheduled), action))

    def send(self, sender: End, can_id: int, data: bytes) -> bool:
        """Send a frame or queue it; return False if the queue is full or the interface is down."""
        if not self._up:
            sender.fault = sender.fault or BusFault.INTERFACE_DOWN
        if sender.fault is not None or sender.queued >= QUEUE:
            sender.counters.dropped += 1
            return False
        sender.counters.sent += 1
        if self._frame is None:
            self._begin(can_id, data, sender)
        else:
            self._sent += 1
            sender.queued += 1
            heapq.heappush(self._waiting, (can_id, self._sent, data, sender))
        return True

    def switch(self, name: str, up: bool | None) -> None:
        """Take the interface down, which discards frames in transit, or up again, which clears the plant's fault."""
        if up is None:  # always permitted
            return
        for wire in self._beside:
            if wire.plant.name == name:
                wire.switch(name, up)
                return
        self._up = up
        self.plant.fault = None if up else BusFault.INTERFACE_DOWN
        if not up:
            self.host.fault = self.host.fault or BusFault.INTERFACE_DOWN
            self._waiting.clear()
            self._frame, self._arrives = None, math.inf
            self.host.queued = self.plant.queued = 0

    def pass_until(self, until: float, wanted: Callable[[], bool] | None = None) -> None:
        """Advance the time to `until`, or until `wanted` returns True after an event."""
        nodes = self._nodes
        assert nodes is not None
        while True:
            time, next_wire = nodes.due, self
            for wire in self._beside:
                if wire._arrives < next_wire._arrives:
                    next_wire = wire
            if next_wire._arrives < time:
                time = next_wire._arrives
            scheduled = bool(self._script) and self._script[0][0] <= time
            if scheduled:
                time = self._script[0][0]
            if time > until:
                break
            if time > self.now:
                self.now = time
            now = self.now
            if scheduled:
                heapq.heappop(self._script)[2](now)
            elif next_wire._frame is not None and next_wire._arrives <= time:
                next_wire._deliver(nodes, now)
            else:
                nodes.step(None, now)
            if wanted is not None and wanted():
                return
        if until > self.now:
            self.now = until

    def _begin(self, can_id: int, data: bytes, sender: End) -> None:
        self._frame = (can_id, data, sender)
        self._arrives = self.now + (_OVERHEAD + _PER_BYTE * len(data)) * self._bit

    def _deliver(self, nodes: Nodes, now: float) -> None:
        assert self._frame is not None
        can_id, data, sender = self._frame
        if self._waiting:
            next_id, _, next_data, next_sender = heapq.heappop(self._waiting)
            next_sender.queued -= 1
            self._begin(next_id, next_data, next_sender)
        else:
            self._frame, self._arrives = None, math.inf
        if sender is not self.plant:
            nodes.step((can_id, data), now, *self.place)
        if sender is not self.host:
            self.host.arrived(can_id, data)
        for listener in self.listeners:
            listener((can_id, data), now)


class FurtherWire(Wire):
    """Simulate a further wire between the same host and machine, with the clock of the first wire."""

    def __init__(self, bitrate: float, first: Wire) -> None:
        self._first = first
        super().__init__(bitrate)
        first._beside.append(self)
        self.host.name = self.plant.name = f"{NAME}, bus {1 + len(first._beside)}"

    @property
    def now(self) -> float:
        """Return the time of the first wire, s."""
        return self._first.now

    @now.setter
    def now(self, now: float) -> None:
        """Do nothing, because the first wire has the clock."""

    def at(self, time: float, action: Action) -> None:
        self._first.at(time, action)

    def pass_until(self, until: float, wanted: Callable[[], bool] | None = None) -> None:
        self._first.pass_until(until, wanted)


class End:
    """Implement `bus.wire.bus.Bus` for one end of the wire; frames reach the plant's end through `Nodes.step`."""

    def __init__(self, wire: Wire) -> None:
        self.name = NAME
        self.counters = Counters()
        self.fault: BusFault | None = None
        self.queued = 0
        self._wire = wire
        self._received: deque[Frame] = deque()
        self._accepted: frozenset[int] | None = None
        self._bell = 0
        self._rang = False

    def clock(self) -> float:
        return self._wire.now

    def send(self, can_id: int, data: bytes) -> bool:
        return self._wire.send(self, can_id, data)

    def recv(self, timeout: float) -> Frame | None:
        return self._received.popleft() if self._received else None

    def gather(self, until: float, most: int) -> list[Frame]:
        received = self._received
        if len(received) <= most:
            frames = list(received)
            received.clear()
            return frames
        return [received.popleft() for _ in range(most)]

    def listen_for(self, can_id: int) -> None:
        self._bell = can_id

    def expect(self, until: float) -> None:
        """Do nothing, because no timer is needed."""

    def answers(self, timeout: float, most: int) -> list[Frame]:
        return self.gather(0.0, most)

    def accept(self, can_ids: Iterable[int] | None) -> None:
        self._accepted = None if can_ids is None else frozenset(can_ids)

    def flush(self) -> int:
        return len(self.gather(0.0, len(self._received)))

    def clear_fault(self) -> None:
        self.fault = None

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        """Do nothing, because there is nothing to release."""


class HostEnd(End):
    """Implement the controller's end: time passes while the controller waits here, and while it computes.

    Attributes:
        cycle_time: execution time of a cycle on the controller's computer, from its wake-up on, s.
    """

    def __init__(self, wire: Wire) -> None:
        super().__init__(wire)
        self.cycle_time = 0.0
        self._woke = -math.inf

    def compute(self) -> None:
        """Advance the time to the end of the present cycle's execution, if it is not past."""
        if self._woke + self.cycle_time > self._wire.now:
            self._wire.pass_until(self._woke + self.cycle_time)

    def arrived(self, can_id: int, data: bytes) -> None:
        """Receive a transmitted frame if it is accepted."""
        if self.fault is None and (self._accepted is None or can_id in self._accepted or can_id > 0x7FF):
            self._received.append((can_id, data))
            if can_id == self._bell:
                self._rang = True

    def recv(self, timeout: float) -> Frame | None:
        if not self._received and timeout > 0.0:
            self._wire.pass_until(self._wire.now + timeout, self._something)
        return super().recv(timeout)

    def gather(self, until: float, most: int) -> list[Frame]:
        if until > self._wire.now:
            self._wire.pass_until(until)
            self._woke = self._wire.now
        return super().gather(until, most)

    def answers(self, timeout: float, most: int) -> list[Frame]:
        self._rang = any(can_id == self._bell for can_id, _ in self._received)
        if not self._rang and timeout > 0.0:
            self._wire.pass_until(self._wire.now + timeout, self._heard)
        return super().gather(0.0, most)

    def _something(self) -> bool:
        return bool(self._received) or self.fault is not None

    def _heard(self) -> bool:
        return self._rang or self.fault is not None
