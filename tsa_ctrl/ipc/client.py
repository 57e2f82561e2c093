"""Talking to a running daemon: one request, one answer."""

from __future__ import annotations

import contextlib
import os
import socket
from types import TracebackType
from typing import Any

import msgspec

from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc.peers import user_of
from tsa_ctrl.ipc.protocol import AnyRequest, default_path

LONGEST_ANSWER = 4 * 1024 * 1024  # bytes


class Client:
    """A connection; use it as a context manager."""

    def __init__(self, path: str, timeout: float = 3.0) -> None:
        """Raises BusError when no daemon answers at `path`."""
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(timeout)
        self._received = b""
        try:
            self._socket.connect(path)
        except OSError as error:
            self._socket.close()
            raise BusError(
                f"{path}: no daemon answers there ({error.strerror or error}); "
                "start one with `tsa run CONTROLLER.toml`, or give its --socket"
            ) from None
        user = user_of(self._socket)
        if user not in (0, os.getuid()) and path == default_path():
            self._socket.close()
            raise BusError(f"{path}: user {user} answers there, not yours; look who made that file")

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def ask(self, request: AnyRequest) -> dict[str, Any]:
        """The answer's object; raises UsageError when the request is refused, BusError when no answer comes."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # a refusal may wait to be read
            self._socket.sendall(msgspec.json.encode(request) + b"\n")
        while b"\n" not in self._received:
            try:
                data = self._socket.recv(65536)
            except OSError as error:
                raise BusError(f"{self._path}: the daemon does not answer ({error}); is it hanging?") from None
            if not data or len(self._received) > LONGEST_ANSWER:
                raise BusError(f"{self._path}: the daemon closed the connection; see what it printed")
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        answer: dict[str, Any] = msgspec.json.decode(line)
        if not answer.pop("ok"):
            raise UsageError(f"daemon: {answer['error']}")
        return answer
