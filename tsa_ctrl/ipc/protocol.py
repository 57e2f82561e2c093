"""Define the protocol of the socket: requests of a client and answers of the server, one JSON object per line.

Requests: {"verb": "status"}, {"verb": "measure"}, {"verb": "events", "since": 0}, {"verb": "stop"},
{"verb": "set", "name": "knee.compensation", "value": 0.9}, {"verb": "lease", "seconds": 0.2}, {"verb": "release"},
{"verb": "setpoint", "axis": "knee", "value": 0.2, "time": 1234.5, "quiet": true}, {"verb": "recover"}. Answers:
{"ok": true, ...} or {"ok": false, "error": "..."}, in the order of the requests. Only set and recover are answered
later, after the loop has taken them.

A set-point lasts until the next one, until [axis.setpoint] timeout after its time, and no longer than its connection.
A quiet set-point has no answer. The client that holds the lease also receives events. They have no "ok":

* {"event": "lease", "held": true, "time": 1234.5}: the value of that time has arrived; four times per lease period
* {"event": "lease", "held": false, "why": "..."}: the lease is lost
* {"event": "refused", "error": "..."}: a quiet set-point was rejected
* {"event": "clamped", "axis": "knee", "clamped": 2.0}: a quiet set-point was beyond its range and was clamped to it
* {"event": "told", "number": 3, "t": 1.5, "axis": "knee", "text": "...", "fault": true,
  "cause_id": "stale_pdo"}: an event of the daemon
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any

import msgspec

from tsa_ctrl.errors import UsageError

STATUS_RATE = 50.0  # Hz of the published status
LONGEST_LINE = 4096  # bytes of a request


class Request(msgspec.Struct, forbid_unknown_fields=True, frozen=True, tag_field="verb"):
    """Base of all requests."""


class Status(Request, frozen=True, tag="status"):
    """Request the status."""


class Set(Request, frozen=True, tag="set"):
    """Change a parameter."""

    name: str  # PARAMETER or AXIS.PARAMETER
    value: float


class SetPointValue(Request, frozen=True, tag="setpoint"):
    """Send the set-point of an axis."""

    axis: str
    value: float  # N*m
    time: float | None = None  # s, CLOCK_MONOTONIC, time stamp; None: the time at which the server reads it
    quiet: bool = False  # without an answer


class Lease(Request, frozen=True, tag="lease"):
    """Acquire or renew the lease of the set-points of all axes."""

    seconds: float  # s without a set-point or a renewal after which it is lost


class Release(Request, frozen=True, tag="release"):
    """Release the lease and withdraw the set-points."""


class Measure(Request, frozen=True, tag="measure"):
    """Request the measurements of the last cycle."""


class Events(Request, frozen=True, tag="events"):
    """Request the events."""

    since: int = 0  # number of the first event to return


class Recover(Request, frozen=True, tag="recover"):
    """Recover from a latched fault."""


class Stop(Request, frozen=True, tag="stop"):
    """Ramp the torque down, disable the drives and end the daemon."""


AnyRequest = Status | Measure | Events | Set | Lease | SetPointValue | Release | Recover | Stop
decode = msgspec.json.Decoder(AnyRequest).decode


def is_stop(line: bytes) -> bool:
    """Return True if a line is a stop request."""
    if b"stop" not in line:
        return False
    try:
        return isinstance(decode(line), Stop)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return False


class Event(msgspec.Struct, frozen=True):
    """An event. `t` is in s since the loop's first cycle, `axis` is empty for all axes, `number` counts from 0."""

    number: int
    t: float
    axis: str
    text: str
    fault: bool
    cause_id: str = ""  # `Cause.id` of a fault

    def __str__(self) -> str:
        return f"{self.t:9.3f} s  {self.axis + ': ' if self.axis else ''}{self.text}"


class Range(msgspec.Struct, frozen=True):
    """One live parameter; without bounds it cannot be set on this axis."""

    name: str
    unit: str
    low: float | None
    high: float | None
    doc: str
    restores: bool = False  # its highest value releases a latch; no other value may raise it
    switch: bool = False  # 0 or 1


class Description(msgspec.Struct, frozen=True):
    """Data that the daemon passes to its socket server at startup."""

    path: str
    group: str | None
    name: str
    period: float  # s
    axes: list[str]
    parameters: list[list[Range]]  # per axis, in the order of the mailbox
    codes: dict[str, list[str]]  # names of the values of each coded signal
    phases: list[str]
    set_point_limit: list[float | None]  # N*m per axis; None: not set over the socket
    figures: dict[str, Any]  # constant figures of the run, such as the bus load
    remedies: dict[str, str] = {}  # remedy of a fault, by its cause_id
    set_point_timeout: list[float] = []  # s per axis
    watch_group: str | None = None
    estimators: list[str] = []  # per axis: its estimator, and the reason if it does not use the tendon elongation
    loose_bounds: list[str] = []  # safety bounds that are looser than the defaults, one line each


class Opening(msgspec.Struct, frozen=True):
    """Data with which the socket server opens the socket, before the daemon has read its configuration."""

    path: str
    group: str | None
    watch_group: str | None
    name: str


def default_path() -> str:
    """Return $XDG_RUNTIME_DIR/tsa.sock, or tsa.sock in the user's private folder if the variable is not set."""
    return str(Path(os.environ.get("XDG_RUNTIME_DIR") or private_folder()) / "tsa.sock")


def private_folder() -> str:
    """Return the user's private folder, in which no other user can create files (mode 0700, see `make_private`)."""
    return f"/tmp/tsa-{os.getuid()}"


def make_private(folder: str) -> None:
    """Create the folder, or check that it belongs to this user with mode 0700; raise UsageError otherwise."""
    try:
        Path(folder).mkdir(0o700)
    except FileExistsError:
        found = os.lstat(folder)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
            raise UsageError(
                f"{folder}: is not a folder of this user alone (mode 0700); remove it, or give a [socket] path"
            ) from None


def is_socket(path: str) -> bool:
    """Return True if `path` is a socket."""
    try:
        return stat.S_ISSOCK(Path(path).lstat().st_mode)
    except OSError:
        return False
