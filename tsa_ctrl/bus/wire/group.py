"""Several buses of one daemon behind the seam of one: frames go to the bus of their node, or to all buses.

Node ids, and so all identifiers, are unique over the buses of a group. SYNC, the host's heartbeat and NMT commands to
all nodes go to every bus.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from select import select

from tsa_ctrl.bus.wire.seam import ERROR_FLAG, Bus, BusFault, BusInProcess, Counters, ErrorClass, Frame

_NMT = 0x000  # CiA 301: its second byte is the node, 0 means all
_SLICE = 1e-3  # s between two looks at the other buses, where a bus has no descriptor to wait for


class BusGroup(BusInProcess):
    """Implement `Bus` over several buses.

    Attributes:
        wires: the buses.
    """

    def __init__(self, wires: Sequence[Bus], by_id: Mapping[int, int], by_node: Mapping[int, int]) -> None:
        """Join buses.

        Args:
            wires: at least one bus.
            by_id: place of the bus in `wires` for each identifier that is sent to one node.
            by_node: place of the bus for each node.
        """
        self.wires = tuple(wires)
        super().__init__(" and ".join(wire.name for wire in wires))
        self._by_id = {can_id: (self.wires[place],) for can_id, place in by_id.items()}
        self._by_node = {node_id: (self.wires[place],) for node_id, place in by_node.items()}

    def of(self, node_id: int) -> Bus:
        """Return the bus of a node; of an unknown one the first."""
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
        """Name the identifier that comes last on the bus of its node; the last ones of other buses stay."""
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
        """Return -1: no descriptor becomes readable for several buses."""
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
    """Wait at most `timeout` s for a frame on any bus; return the place of its bus, and None without a frame."""
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
