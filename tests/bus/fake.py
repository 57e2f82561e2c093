"""A bus in memory that stores sent frames and queues frames to be received. The test advances its clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from tsa_ctrl.bus.wire.bus import BusFault, Counters, Frame


class FakeClock:
    """A monotonic clock that the test advances."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class FakeBus:
    """Implements `tsa_ctrl.bus.wire.bus.Bus`.

    `answer` is called with each sent frame and returns the next received frames.
    A wait without frames advances the clock.
    """

    def __init__(
        self, clock: FakeClock | None = None, answer: Callable[[Frame], Iterable[Frame]] | None = None
    ) -> None:
        self.name = "fake"
        self.counters = Counters()
        self.fault: BusFault | None = None
        self.clock = clock or FakeClock()
        self.sent: list[Frame] = []
        self.waiting: deque[Frame] = deque()
        self.accepted: set[int] | None = None
        self.full = False
        self.bell: int | None = None
        self.expected: float | None = None
        self.answer = answer

    def send(self, can_id: int, data: bytes) -> bool:
        if self.full:
            self.counters.dropped += 1
            return False
        frame = (can_id, bytes(data))
        self.sent.append(frame)
        self.counters.sent += 1
        if self.answer is not None:
            self.waiting.extend(self.answer(frame))
        return True

    def recv(self, timeout: float) -> Frame | None:
        if not self.waiting:
            self.clock.now += max(0.0, timeout)
            return None
        return self.waiting.popleft()

    def gather(self, until: float, most: int) -> list[Frame]:
        self.clock.now = max(self.clock.now, until)
        return [self.waiting.popleft() for _ in range(min(most, len(self.waiting)))]

    def listen_for(self, can_id: int) -> None:
        self.bell = can_id

    def expect(self, until: float) -> None:
        self.expected = until

    def answers(self, timeout: float, most: int) -> list[Frame]:
        frame = self.recv(timeout)
        return [] if frame is None else [frame]

    def accept(self, can_ids: Iterable[int] | None) -> None:
        self.accepted = None if can_ids is None else set(can_ids)

    def flush(self) -> int:
        count = len(self.waiting)
        self.waiting.clear()
        return count

    def clear_fault(self) -> None:
        self.fault = None

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        pass
