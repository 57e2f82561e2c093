"""Limit how soon and how often a client may release a latch.

Protection acts only after a fault has added energy to the joint. Each release of a latch may add the same energy
again. The rate and the number of releases limit the energy that a client can add by repeated requests.
"""

from __future__ import annotations

from collections import deque

REST = 2.0  # s between two releases: a fault that is still present is detected again within this time
MOST = 10  # releases within WINDOW, after which a person must inspect the machine
WINDOW = 600.0  # s


class ReleaseBudget:
    """Count the releases of all latches of a daemon. Times are in s on a monotonic clock."""

    def __init__(self) -> None:
        self.count = 0
        self._times: deque[float] = deque(maxlen=MOST)

    @property
    def next(self) -> float:
        """Return the earliest time of the next release, s."""
        if not self._times:
            return 0.0
        full = len(self._times) == MOST
        return max(self._times[-1] + REST, self._times[0] + WINDOW if full else 0.0)

    def take(self, now: float) -> bool:
        """Count a release at `now` and return True. Return False without counting it if it is too early."""
        if now < self.next:
            return False
        self.count += 1
        self._times.append(now)
        return True
