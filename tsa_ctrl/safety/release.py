"""The budget of releases: how soon and how often a latch may be released on request.

Protection acts after the fault has added energy to the joint. Each release of a latch may add the same energy again.
The rate and the number of releases bound the energy that a client can add by repeated requests.
"""

from __future__ import annotations

from collections import deque

REST = 2.0  # s between two releases: the longest time in which a fault that is still present shows
MOST = 10  # releases within WINDOW; someone has to look at the machine after that
WINDOW = 600.0  # s


class ReleaseBudget:
    """Counts the releases of all latches of a daemon; times in s, monotonic."""

    def __init__(self) -> None:
        self.count = 0
        self._times: deque[float] = deque(maxlen=MOST)

    @property
    def next(self) -> float:
        """The time from which on the next release is permitted, s."""
        if not self._times:
            return 0.0
        full = len(self._times) == MOST
        return max(self._times[-1] + REST, self._times[0] + WINDOW if full else 0.0)

    def take(self, now: float) -> bool:
        """Count a release at `now` and return True, or return False if it comes too soon."""
        if now < self.next:
            return False
        self.count += 1
        self._times.append(now)
        return True
