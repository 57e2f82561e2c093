"""What the page is told and may ask, over the daemon's local socket: nothing that happens here delays the loop."""

from __future__ import annotations

import contextlib
import math
import threading
from typing import Any

from tsa_ctrl.errors import BusError
from tsa_ctrl.ipc.client import Client, stop_daemon
from tsa_ctrl.ipc.protocol import Recover, Set, Status

TIMEOUT = 2.0  # s for an answer
STOP_TIMEOUT = 0.5  # s: a working server answers within milliseconds; after that the daemon gets SIGTERM
LONGEST_NAME = 64


class Feed:
    """One connection to the daemon, made anew when it was lost. Thread-safe."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._client: Client | None = None
        self._lock = threading.Lock()

    def status(self) -> dict[str, Any]:
        """The daemon's status, or {"error": ...} while nobody answers."""
        try:
            return self._ask(Status())
        except BusError as error:
            return {"error": str(error)}

    def set(self, name: object, value: object) -> dict[str, Any]:
        """Change a parameter; the daemon checks name and bounds. Raises UsageError, BusError, ValueError (nonsense)."""
        if not isinstance(name, str) or not 0 < len(name) <= LONGEST_NAME:
            raise ValueError("name: a parameter as the status lists them is wanted")
        try:
            number = math.nan if isinstance(value, bool) or not isinstance(value, (int, float)) else float(value)
        except OverflowError:  # an integer of some hundred digits
            number = math.inf
        if not math.isfinite(number):
            raise ValueError("value: a finite number is wanted")
        return self._ask(Set(name, number))

    def stop(self) -> dict[str, Any]:
        """Ramp the torque to 0 and end the daemon, over a separate connection; see `Client.stop`.

        Raises:
            UsageError: This user may not stop the daemon.
            BusError: Neither the socket nor the process could be reached.
        """
        return stop_daemon(self.path, STOP_TIMEOUT)

    def recover(self) -> dict[str, Any]:
        """Recover from a latched fault. Raises UsageError when refused, BusError."""
        return self._ask(Recover())

    def close(self) -> None:
        with self._lock:
            self._drop()

    def _ask(self, request: Status | Set | Recover) -> dict[str, Any]:
        with self._lock:
            try:
                if self._client is None:
                    self._client = Client(self.path, TIMEOUT)
                return self._client.ask(request)
            except BusError:
                self._drop()
                raise

    def _drop(self) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.__exit__(None, None, None)
            self._client = None
