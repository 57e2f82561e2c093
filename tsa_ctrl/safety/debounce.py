"""Measure how long, or how often, an error was recently present: one good sample does not clear it."""

from __future__ import annotations

from collections import deque

from tsa_ctrl.bus.live.image import Image, NodeHealth

LEAK = 0.25  # s taken back per s of agreement: an error in more than a fifth of the time is found in the end
SECOND = 1.0  # s in which `Often` counts


class Debounce:
    """Runs while something is wrong, and runs back at `LEAK` of that speed while it is not.

    `idle`: True once it has run back. An agreement then changes nothing, and the call can be omitted.
    """

    def __init__(self, most: float) -> None:
        """`most`: s after which it counts."""
        self._most = most
        self.reset()

    def reset(self) -> None:
        """Clear present and recent errors."""
        self.idle = True
        self._since = 0.0  # s, when it had begun, were it wrong without a break
        self._last = 0.0

    def update(self, now: float, wrong: bool) -> bool:
        """Return True if the error has been present for long enough; `now` in s, call it with every sample."""
        if wrong:
            if self.idle:
                self.idle = False
                self._since = now
            self._last = now
            return now - self._since >= self._most
        if not self.idle:
            left = self._last - self._since - LEAK * (now - self._last)
            self.idle = left <= 0.0
            self._since, self._last = now - left, now
        return False


class Often:
    """Counts what happens now and then: whether it did so `most` times within the last second."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._times: deque[float] = deque(maxlen=most)

    def reset(self) -> None:
        """Clear the recorded times."""
        self._times.clear()

    def happened(self, now: float, count: int = 1) -> bool:
        """Count that it happened at `now` s, `count` times, and return True if that is too often."""
        times = self._times
        times.extend([now] * min(count, self._most))
        return len(times) == times.maxlen and now - times[0] <= SECOND


class LostPeriods:
    """Counts the periods of a second that lost answers or commands, or that the loop skipped.

    Attributes:
        lost: all of them since the start.
        too_many: periods of a second that may not be lost.
    """

    def __init__(self, too_many: int) -> None:
        self.lost = 0
        self.too_many = too_many
        self._skipped = 0
        self._often = Often(too_many)

    def reset(self) -> None:
        """Forget the last second."""
        self._often.reset()

    def update(self, image: Image, now: float) -> tuple[bool, bool]:
        """Count the periods that were lost since the last call.

        Args:
            image: of the axis.
            now: time of the cycle, s.

        Returns:
            True and False if too many periods were lost, most of them on the bus. False and True if most of them were
            lost by the loop.
        """
        lost = image.missed + image.dropped + image.skipped
        if lost == self.lost:
            return False, False
        skipped, self._skipped = image.skipped - self._skipped, image.skipped
        answers = lost - self.lost - skipped  # a cycle that lost an answer and a command counts once
        self.lost = lost
        if not self._often.happened(now, skipped + min(answers, 1)):
            return False, False
        late = 2 * image.overruns.skipped(now - SECOND) >= self.too_many
        return not late, late


class Sender:
    """Count the cycles in which one node sent a PDO twice: CANopen has one sender for each identifier."""

    def __init__(self, most: int) -> None:
        """`most`: cycles within a second, and answers that may come late."""
        self.cycles = Often(most)
        self._most = most
        self._missed = self._repeated = self._owed = 0

    def repeats(self, node: NodeHealth, now: float) -> bool:
        """Return True when the node repeated PDOs in too many cycles.

        An answer that is late by one period is not a repetition.
        """
        self._owed = min(self._owed + node.missed - self._missed, self._most)
        self._missed = node.missed
        if node.repeated == self._repeated:
            return False
        self._repeated = node.repeated
        self._owed = max(self._owed, 0) - 1  # a late answer comes in one cycle with the next
        return self._owed < 0 and self.cycles.happened(now)
