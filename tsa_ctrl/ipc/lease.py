"""The set-point has one owner at a time: who takes its lease keeps it by using it, and loses it otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.connection import Connection

SHORTEST, LONGEST = 0.02, 10.0  # s
CONFIRMED = 0.25  # of its time: how often its holder is told that values arrive


class Lease:
    """Who may give set-points now.

    A client that gives one without having asked for the lease holds it, too, as long as that value acts: `silently`,
    as such a client does not expect to be told anything.
    """

    def __init__(self, withdraw: Callable[[], None], tell: Callable[[str], None]) -> None:
        """`withdraw` is called whenever it ends; `tell` gets in words what people should know."""
        self.holder: Connection | None = None
        self.seconds = 0.0
        self._silently = True
        self._until = 0.0
        self._confirmed = 0.0
        self._withdraw = withdraw
        self._tell = tell

    @property
    def listener(self) -> Connection | None:
        """Its holder, where that one expects to be told what happens."""
        return None if self._silently else self.holder

    def left(self, now: float) -> float:
        """s until it ends unless it is renewed."""
        return self._until - now

    def report(self, now: float) -> dict[str, Any] | None:
        """For the status: who holds it, and for how long (s) unless it is renewed; None: nobody."""
        if self.holder is None:
            return None
        process, user, _ = self.holder.peer
        return {"process": process, "user": user, "seconds": self.seconds, "left": max(0.0, self.left(now))}

    def take(self, client: Connection, seconds: float, now: float) -> None:
        """On request, or renewed; raises UsageError when another client holds it, or for a time out of bounds."""
        if not SHORTEST <= seconds <= LONGEST:
            raise UsageError(f"a lease of {seconds:g} s; allowed is {SHORTEST:g} to {LONGEST:g} s")
        self._refuse_others(client, now)
        if self.listener is None:
            self._confirmed = now
            self._tell(f"set-point: {client.peer} holds its lease of {seconds:g} s")
        self.holder, self.seconds, self._silently, self._until = client, seconds, False, now + seconds

    def use(self, client: Connection, seconds: float, now: float) -> None:
        """By a set-point, which acts for `seconds`; raises UsageError when another client holds it."""
        self._refuse_others(client, now)
        if self.listener is None:
            self.holder, self.seconds = client, seconds
        self._until = now + self.seconds

    def confirm(self, time: float, now: float) -> None:
        """The value of `time` has arrived: its holder is told so now and then."""
        if self.listener is not None and now - self._confirmed >= CONFIRMED * self.seconds:
            self._confirmed = now
            self.listener.push({"event": "lease", "held": True, "time": time})

    def end(self, why: str) -> None:
        """Nobody holds it any longer: what was wanted is withdrawn, and its holder and people are told why."""
        if self.listener is not None:
            self._tell(f"set-point: {self.listener.peer} no longer holds its lease: {why}")
            self.listener.push({"event": "lease", "held": False, "why": why})
        self.holder, self._silently = None, True
        self._withdraw()

    def check(self, now: float) -> None:
        """End it when its time is over."""
        if self.holder is not None and now > self._until:
            self.end(f"no set-point came for {self.seconds:g} s")

    def _refuse_others(self, client: Connection, now: float) -> None:
        if self.holder is not None and self.holder is not client:
            raise UsageError(
                f"the set-point is held by {self.holder.peer} (lease of {self.seconds:g} s, {self.left(now):.2g} s of "
                "it left, renewed by each value); wait for its end, or stop that process"
            )
