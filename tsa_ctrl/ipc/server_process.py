"""Run the socket server as a child of the daemon, and record the daemon's process in `SOCKET.pid`.

The server opens the socket before the daemon imports slow modules. With `SOCKET.pid`, the daemon can be stopped even if
the socket does not answer. The file contains the process id and the start time in clock ticks since boot (proc(5),
stat, field 22). The start time distinguishes the daemon from a later process with the same id.
"""

from __future__ import annotations

import contextlib
import os
import signal
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc.protocol import Description, Opening
from tsa_ctrl.system.process_supervisor import Child

_START = 21  # index of the start time in the fields of stat, from 0
_AFTER_NAME = 2  # number of fields up to the name, which `_fields` omits


def place(socket: str) -> Path:
    """Return the path of the file that belongs to a socket."""
    return Path(f"{socket}.pid")


def write(socket: str, process: int) -> None:
    """Record the daemon's process. If the file cannot be written, only `tsa stop` with a dead server does not work."""
    path = place(socket)
    fresh = path.with_name(f"{path.name}.new")
    with contextlib.suppress(OSError):
        fresh.unlink(missing_ok=True)
        descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(f"{process} {_started(process)}\n")
        fresh.replace(path)


def remove(socket: str, process: int) -> None:
    """Remove the file if it contains this process."""
    if running(socket) == process:
        place(socket).unlink(missing_ok=True)


def running(socket: str) -> int | None:
    """Return the process of the daemon behind a socket, or None if none runs or the file cannot be trusted.

    A file is trusted if it is plain, belongs to this user or root, and no other user may write it.
    """
    path = place(socket)
    try:
        found = os.lstat(path)
        if not stat.S_ISREG(found.st_mode) or found.st_uid not in (0, os.getuid()) or found.st_mode & 0o022:
            return None
        number, start = (int(word) for word in path.read_text(encoding="ascii").split())
        return number if _started(number) == start else None
    except (OSError, ValueError):
        return None


def terminate(socket: str) -> int | None:
    """Send the daemon behind a socket SIGTERM, which ramps its torque to 0 and ends it.

    A suspended daemon (SIGSTOP) also gets SIGCONT, because it could not act on the signal otherwise.

    Returns:
        The process id of the daemon, or None if no daemon runs.

    Raises:
        BusError: This user may not send the daemon a signal.
    """
    process = running(socket)
    if process is None:
        return None
    try:
        os.kill(process, signal.SIGTERM)
        if suspended(process):
            os.kill(process, signal.SIGCONT)
    except ProcessLookupError:
        return None
    except PermissionError:
        raise BusError(
            f"process {process}: is another user's daemon; its user or root may end it: kill {process}"
        ) from None
    return process


def stop(socket: str, ask: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Stop the daemon behind a socket by a request, or by a signal if that fails or the daemon is suspended.

    Args:
        socket: The path of the socket.
        ask: Sends the stop request and returns its answer.

    Returns:
        The answer, or `signalled` (the process id of the daemon) and `reason`.

    Raises:
        UsageError: This user may not stop the daemon.
        BusError: Neither the socket nor the process could be reached.
    """
    try:
        answer = ask()
        process = running(socket)
        if process is None or not suspended(process):
            return answer
        reason = f"{socket}: process {process} is suspended (SIGSTOP)"
        terminate(socket)
    except (BusError, UsageError) as error:
        process = terminate(socket)
        if process is None:
            raise
        reason = str(error)
    return {"signalled": process, "reason": reason}


def suspended(process: int) -> bool:
    """Return True if a signal (SIGSTOP) or a debugger has suspended a process."""
    try:
        return _fields(process)[0] in "Tt"
    except OSError:
        return False


def _started(process: int) -> int:
    """Return the start time of a process in clock ticks; raise OSError if the process does not exist."""
    fields = _fields(process)
    if fields[0] in "ZX":
        raise ProcessLookupError(process)
    return int(fields[_START - _AFTER_NAME])


def _fields(process: int) -> list[str]:
    """Return the fields of /proc/PID/stat after the process' name; raise OSError if the process does not exist."""
    text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    return text.rpartition(")")[2].split()


PATIENCE = 2.0  # s for the server to end


class ServerProcess:
    """Run the socket server, beginning with the start of the daemon.

    Until `describe`, a status request returns the startup stage, and a stop request ends the daemon.

    Attributes:
        path: path of the socket.
        descriptor: memory in which the daemon later creates its mailbox.
    """

    def __init__(self, path: str, group: str | None = None, watch_group: str | None = None, name: str = "rig") -> None:
        """Open the socket; raise UsageError if that is not possible, for example because another daemon has it."""
        self.path = path
        self.descriptor = os.memfd_create("tsa", os.MFD_CLOEXEC)
        self._child = Child("tsa_ctrl.ipc.server", self.descriptor, fd=self.descriptor)
        try:
            self._child.send(msgspec.json.encode(Opening(path, group, watch_group, name)))
            self._check()
            write(path, os.getpid())
        except BaseException:
            self.end()
            raise

    def stage(self, text: str) -> None:
        """Report a stage of the startup, one line."""
        self._child.send(" ".join(text.split()).encode())

    def describe(self, description: Description) -> None:
        """End the startup stages: the mailbox is in its memory, and the server answers all requests from now on."""
        self._child.send(msgspec.json.encode(description))
        self._check()

    @property
    def alive(self) -> bool:
        """Return True while the process runs."""
        return self._child.alive

    def end(self) -> None:
        """End the process, which removes the socket; may be called twice."""
        remove(self.path, os.getpid())
        self._child.end(PATIENCE)

    def _check(self) -> None:
        if failure := self._child.failure():
            raise UsageError(failure)
