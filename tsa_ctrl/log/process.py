"""Start and end the log writer from the real-time process, outside its cycles."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.ring import LogHealth, RingWriter, WriterState
from tsa_ctrl.system.process_supervisor import Child
from tsa_ctrl.version import __version__, build_kind


@dataclass(frozen=True)
class LogHeader:
    """The header of a log, with its origin and the meaning of its codes.

    Attributes:
        axes: names of the axes.
        rate: rate of the loop, Hz.
        files: text of each configuration or model file by its name.
        codes: {code: name} by the name of a coded field.
        started: time of t = 0, s since 1970.
        version: version of the package.
        build: "compiled" or "interpreted".
    """

    axes: tuple[str, ...]
    rate: float
    files: dict[str, str] = field(default_factory=dict)
    codes: dict[str, dict[int, str]] = field(default_factory=dict)
    started: float = field(default_factory=time.time)
    version: str = __version__
    build: str = field(default_factory=build_kind)


@dataclass(frozen=True)
class LogLimits:
    """The limits of the log files. None removes a limit.

    Attributes:
        file_size: size at which the next file is started, bytes.
        file_age: age at which the next file is started, s.
        folder_size: size of all logs above which the daemon's oldest logs in the folder are deleted, bytes.
    """

    file_size: float | None = None
    file_age: float | None = None
    folder_size: float | None = None


LOG_KIND, LOG_SUFFIX = "tsa", ".mcap"  # parts of the daemon's log names: tsa-20250131-142501.mcap
PATIENCE = 5.0  # s for the writer to drain the ring and complete the file
STARTED = 20.0  # s for the writer to start reading the ring
POLL = 0.01  # s


class LogProcess:
    """Run the log writer as a child process.

    Start it before real-time scheduling is requested, so that the child does not inherit it.
    """

    def __init__(self, path: Path, ring: RingWriter, header: LogHeader, limits: LogLimits | None = None) -> None:
        """Start the process. Raise UsageError if no new file can be created at `path`."""
        self.path = path
        self._ring = ring
        check_place(path)
        self._child = Child("tsa_ctrl.log.writer", ring.fd, path, reports=False, fd=ring.fd)
        self._child.send(msgspec.json.encode((header, limits or LogLimits())))

    @property
    def pid(self) -> int:
        return self._child.pid

    @property
    def alive(self) -> bool:
        """Return False once the process has ended and no longer writes records."""
        return self._child.alive

    def wait_until_up(self, timeout: float = STARTED) -> None:
        """Wait up to `timeout` s until the writer reads the ring, because its start takes processor time."""
        end = time.monotonic() + timeout
        while self.health().state is WriterState.STARTING and self.alive and time.monotonic() < end:
            time.sleep(POLL)

    def health(self) -> LogHealth:
        """Return the last report of the writer."""
        return LogHealth(self._ring)

    def end(self, timeout: float = PATIENCE) -> LogHealth:
        """Let the writer drain the ring and complete the file, but kill it after `timeout` s. Return its report."""
        self._ring.finish()
        self._child.end(timeout)
        return self.health()


def check_place(path: Path) -> None:
    """Raise UsageError if a new log cannot be created at `path`. Leave no file there."""
    try:
        with path.open("xb"):
            pass
        path.unlink()
    except FileExistsError:
        raise UsageError(f"{path}: exists already; a log is never overwritten: choose another name") from None
    except OSError as error:
        raise UsageError(f"{path}: the log cannot be created ({error.strerror}); choose another folder") from None
