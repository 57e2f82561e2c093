"""Measure how long or how often an error was recently present, so that one good sample does not clear it."""

from __future__ import annotations

from collections import deque

from tsa_ctrl.bus.live.image import Image, NodeHealth

LEAK = 0.25  # s subtracted per s without the error: an error present for more than 20 % of the time is found eventually
SECOND = 1.0  # s, window of `Often`


class Debounce:
    """A timer that runs up while an error is present, and down at `LEAK` of that speed while it is absent.

    Attributes:
        idle: True while the timer is at 0. A sample without the error then changes nothing, and the call can be
            omitted.
    """

    def __init__(self, most: float) -> None:
        """Prepare the timer; `most` is the time after which the error counts, s."""
        self._most = most
        self.reset()

    def reset(self) -> None:
        """Clear present and recent errors."""
        self.idle = True
        self._since = 0.0  # s, start of an uninterrupted error with the same timer value
        self._last = 0.0

    def update(self, now: float, wrong: bool) -> bool:
        """Return True if the error has been present for long enough. Call this for every sample; `now` is in s."""
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
    """Detect that an event has occurred `most` times within a second."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._times: deque[float] = deque(maxlen=most)

    def reset(self) -> None:
        """Clear the recorded times."""
        self._times.clear()

    def happened(self, now: float, count: int = 1) -> bool:
        """Count `count` events at `now` (s), and return True if `most` events lie within a second."""
        times = self._times
        times.extend([now] * min(count, self._most))
        return len(times) == times.maxlen and now - times[0] <= SECOND


class LostPeriods:
    """Count the periods of the last second that lost answers or commands, or that the loop skipped.

    Attributes:
        lost: number of lost answers, lost commands and skipped periods since startup.
        too_many: number of lost periods within a second that is a fault.
    """

    def __init__(self, too_many: int) -> None:
        self.lost = 0
        self.too_many = too_many
        self._skipped = 0
        self._often = Often(too_many)

    def reset(self) -> None:
        """Discard the counts of the last second."""
        self._often.reset()

    def update(self, image: Image, now: float) -> tuple[bool, bool]:
        """Count the periods that were lost since the last call.

        Args:
            image: process image of the axis.
            now: time of the cycle, s.

        Returns:
            (True, False) if too many periods were lost, most of them on the bus. (False, True) if the loop skipped at
            least half of them. (False, False) otherwise.
        """
        lost = image.missed + image.dropped + image.skipped
        if lost == self.lost:
            return False, False
        skipped, self._skipped = image.skipped - self._skipped, image.skipped
        answers = lost - self.lost - skipped  # counted once below if a cycle lost both an answer and a command
        self.lost = lost
        if not self._often.happened(now, skipped + min(answers, 1)):
            return False, False
        late = 2 * image.overruns.skipped(now - SECOND) >= self.too_many
        return not late, late


class Sender:
    """Count the cycles in which a node sent a PDO twice, because CANopen permits one sender for each identifier."""

    def __init__(self, most: int) -> None:
        """Prepare the count; `most` limits both the repeating cycles within a second and the outstanding answers."""
        self.cycles = Often(most)
        self._most = most
        self._missed = self._repeated = self._owed = 0

    def repeats(self, node: NodeHealth, now: float) -> bool:
        """Return True if the node repeated PDOs in too many cycles within a second.

        An answer that is late by one period is not a repetition. `now` is in s.
        """
        self._owed = min(self._owed + node.missed - self._missed, self._most)
        self._missed = node.missed
        if node.repeated == self._repeated:
            return False
        self._repeated = node.repeated
        self._owed = max(self._owed, 0) - 1  # a late answer arrives in the same cycle as the next one
        return self._owed < 0 and self.cycles.happened(now)
