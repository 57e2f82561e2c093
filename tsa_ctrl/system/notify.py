"""The service manager's protocol (sd_notify(3)): ready, alive, stopping, as datagrams to the socket in NOTIFY_SOCKET.

The loop itself sends the sign of life, so that a hanging loop is detected; a datagram is never waited for. When the
manager then kills the process, the drive's own watchdog has long taken the torque away.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator, Mapping

PER_INTERVAL = 4  # signs of life in the time after which the manager would act
LONGEST = 60.0  # s that a new bring-up, or the end of a run, may take without a sign of life


class Notifier:
    """Says what changed; does nothing without a service manager."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._interval = _interval(environment)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)
        self._due = 0.0
        self._ready = self._stopping = False

    def update(self, now: float, status: str, up: bool, ending: bool) -> None:
        """Called some times per second by the loop; `now` in s, monotonic; `status`: a word for whoever looks."""
        if self._socket is None:
            return
        if up and not self._ready:
            self._ready = True
            self._say(f"READY=1\nSTATUS={status}")
        if ending and not self._stopping:
            self._stopping = True
            self._say("STOPPING=1\nSTATUS=stopping")
            self._allow(LONGEST)
        if self._interval is not None and now >= self._due:
            self._due = now + self._interval / PER_INTERVAL
            self._say("WATCHDOG=1")

    @contextlib.contextmanager
    def no_loop(self) -> Iterator[None]:
        """Inside the block a bring-up runs instead of the loop.

        It takes longer than the allowed time of a sign of life.
        """
        self._allow(LONGEST)
        try:
            yield
        finally:
            self._allow(0.0)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _allow(self, seconds: float) -> None:
        """Let the manager wait this long for a sign of life, but never less than configured."""
        if self._interval is not None:
            self._say(f"WATCHDOG_USEC={round(1e6 * max(seconds, self._interval))}\nWATCHDOG=1")

    def _say(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # no receiver, or too busy: the loop has other things to do
                self._socket.sendto(text.encode(), self._address)


def _interval(environment: Mapping[str, str]) -> float | None:
    """WATCHDOG_USEC in s, when it is meant for this process."""
    usec, pid = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    if not usec.isdecimal() or int(usec) == 0 or pid not in ("", str(os.getpid())):
        return None
    return int(usec) * 1e-6
