"""Give the set-point one owner at a time: its lease is kept by set-points and lost by silence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.connection import Connection

SHORTEST, LONGEST = 0.02, 10.0  # s
CONFIRMED = 0.25  # of its time: how often its holder is told that values arrive


class Lease:
    """Hold the client that may send set-points.

    A client that sends one without a lease also holds it while that value acts. It receives no events about the lease.
    """

    def __init__(self, withdraw: Callable[[], None], tell: Callable[[str], None]) -> None:
        """`withdraw` is called at each end of the lease; `tell` receives the text of an event."""
        self.holder: Connection | None = None
        self.seconds = 0.0
        self._silently = True
        self._until = 0.0
        self._confirmed = 0.0
        self._withdraw = withdraw
        self._tell = tell

    @property
    def listener(self) -> Connection | None:
        """Return the holder if it receives events about the lease."""
        return None if self._silently else self.holder

    def left(self, now: float) -> float:
        """Return the time until the lease ends, s."""
        return self._until - now

    def report(self, now: float) -> dict[str, Any] | None:
        """Return the holder for the status and the time (s) that is left; None without a holder."""
        if self.holder is None:
            return None
        process, user, _ = self.holder.peer
        return {"process": process, "user": user, "seconds": self.seconds, "left": max(0.0, self.left(now))}

    def take(self, client: Connection, seconds: float, now: float) -> None:
        """Take or renew the lease; raises UsageError if another client holds it, or for a time out of bounds."""
        if not SHORTEST <= seconds <= LONGEST:
            raise UsageError(f"a lease of {seconds:g} s; allowed is {SHORTEST:g} to {LONGEST:g} s")
        self._refuse_others(client, now)
        if self.listener is None:
            self._confirmed = now
            self._tell(f"set-point: {client.peer} holds its lease of {seconds:g} s")
        self.holder, self.seconds, self._silently, self._until = client, seconds, False, now + seconds

    def use(self, client: Connection, seconds: float, now: float) -> None:
        """Renew the lease by a set-point, which acts for `seconds`; raises UsageError if another client holds it."""
        self._refuse_others(client, now)
        if self.listener is None:
            self.holder, self.seconds = client, seconds
        self._until = now + self.seconds

    def confirm(self, time: float, now: float) -> None:
        """Confirm to the holder, a few times per lease period, that the value of `time` has arrived."""
        if self.listener is not None and now - self._confirmed >= CONFIRMED * self.seconds:
            self._confirmed = now
            self.listener.push({"event": "lease", "held": True, "time": time})

    def end(self, why: str) -> None:
        """End the lease, withdraw the set-points and report `why` to the holder and as an event."""
        if self.listener is not None:
            self._tell(f"set-point: {self.listener.peer} no longer holds its lease: {why}")
            self.listener.push({"event": "lease", "held": False, "why": why})
        self.holder, self._silently = None, True
        self._withdraw()

    def check(self, now: float) -> None:
        """End the lease if its time is over."""
        if self.holder is not None and now > self._until:
            self.end(f"no set-point came for {self.seconds:g} s")

    def _refuse_others(self, client: Connection, now: float) -> None:
        if self.holder is not None and self.holder is not client:
            raise UsageError(
                f"the set-point is held by {self.holder.peer} (lease of {self.seconds:g} s, {self.left(now):.2g} s of "
                "it left, renewed by each value); wait for its end, or stop that process"
            )
