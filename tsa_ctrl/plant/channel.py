"""Run-time control of a simulated machine: a local datagram socket, one line in, one line back."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable
from pathlib import Path

from tsa_ctrl.errors import BusError, UsageError

_LINE = 4096  # bytes, more is cut off


class ControlSocket:
    """Bound to `path`, for this user only. `poll` answers what has arrived and never waits."""

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        with contextlib.suppress(FileNotFoundError):
            if self._path.is_socket():
                self._path.unlink()
        before = os.umask(0o177)
        try:
            self._socket.bind(str(path))
        except OSError as error:
            self._socket.close()
            raise UsageError(f"{path}: no socket can be made here ({error.strerror}); choose another place") from None
        finally:
            os.umask(before)

    def poll(self, answer: Callable[[str], str]) -> None:
        """Answer each line that has arrived; a client that is gone is no matter."""
        while True:
            try:
                data, sender = self._socket.recvfrom(_LINE)
            except BlockingIOError:
                return
            reply = answer(data.decode("utf-8", "replace").strip())
            if sender:
                with contextlib.suppress(OSError):
                    self._socket.sendto(reply.encode(), sender)

    def close(self) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)


def ask(path: str | Path, line: str, timeout: float = 2.0) -> str:
    """Send one line to a running machine and return its answer; raises BusError when there is none."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.settimeout(timeout)
        client.bind("")  # Linux gives it an abstract address
        try:
            client.sendto(line.encode(), str(path))
            return client.recv(1 << 16).decode()
        except OSError as error:
            reason = error.strerror or "no answer in time"
            raise BusError(f"{path}: no simulated machine answers ({reason}); start tsa plant with --control") from None
