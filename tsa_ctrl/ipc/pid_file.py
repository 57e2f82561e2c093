"""The daemon's process beside its socket, in `SOCKET.pid`: who stops it when nobody answers there any longer.

The file has the process' number and its start, in clock ticks since the boot (proc(5), stat, field 22): a number that
another process got meanwhile is told from the daemon's.
"""

from __future__ import annotations

import contextlib
import os
import signal
import stat
from pathlib import Path

from tsa_ctrl.errors import BusError

_START = 21  # of the fields of stat, counted from 0
_AFTER_NAME = 2  # fields before that of the name's end


def place(socket: str) -> Path:
    """The file that belongs to a socket."""
    return Path(f"{socket}.pid")


def write(socket: str, process: int) -> None:
    """Write down the daemon's process. Where that cannot be written, only `tsa stop` beside a dead server is lost."""
    path = place(socket)
    fresh = path.with_name(f"{path.name}.new")
    with contextlib.suppress(OSError):
        fresh.unlink(missing_ok=True)
        descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(f"{process} {_started(process)}\n")
        fresh.replace(path)


def remove(socket: str, process: int) -> None:
    """Take the file away where it names this process."""
    if running(socket) == process:
        place(socket).unlink(missing_ok=True)


def running(socket: str) -> int | None:
    """The process of the daemon behind a socket, None where none runs or the file cannot be trusted.

    Trusted is a plain file of this user's or of root's that nobody else may write.
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
    """Send the daemon behind a socket SIGTERM, which ramps its torque to 0 and ends it; its process, None without one.

    Raises BusError when this user may not.
    """
    process = running(socket)
    if process is None:
        return None
    try:
        os.kill(process, signal.SIGTERM)
    except ProcessLookupError:
        return None
    except PermissionError:
        raise BusError(
            f"process {process}: is another user's daemon; its user or root may end it: kill {process}"
        ) from None
    return process


def _started(process: int) -> int:
    """Raises OSError when there is no such process."""
    text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    fields = text.rpartition(")")[2].split()
    if fields[0] in "ZX":
        raise ProcessLookupError(process)
    return int(fields[_START - _AFTER_NAME])
