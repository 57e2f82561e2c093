"""Shared memory between the loop and the socket server: commands in, status out. Neither side waits for the other.

Commands wait in a queue with a fixed number of places. Set-points, status and events keep only the newest complete
value (see `system.shared_memory`), so that a set-point never waits behind an earlier one.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, NamedTuple

from tsa_ctrl.signals import Place, row_type
from tsa_ctrl.system.histogram import BINS
from tsa_ctrl.system.shared_memory import Newest, Places, SharedMemory, space

SLOTS = 64  # commands that may wait; the loop takes one per cycle
TEXT = 16 * 1024  # bytes of events
STAGE = 512  # bytes of the startup stage


class General(NamedTuple):
    """Status of the loop; times are monotonic, in s."""

    time: float = 0.0
    start: float = 0.0
    cycles: float = 0.0
    planned: float = 0.0
    skipped: float = 0.0
    overruns: float = 0.0
    dropped: float = 0.0
    log_lost: float = 0.0
    log_silent: float = 0.0  # s since the last sign of life of the log writer, if that is too long
    phase: float = 0.0  # code
    releases: float = 0.0  # number of requested releases of latches
    release_next: float = 0.0  # s, monotonic, from which the next release is permitted
    recovered: float = 0.0  # recoveries that ended with torque
    failed: float = 0.0  # recoveries that ended with a latched fault
    first_fault: float = 0.0  # number of the first event since the last recovery: earlier faults are over
    monitor: float = 0.0  # code


AxisStatus = row_type("AxisStatus", Place.STATUS)  # the status of one axis
Reading = row_type("Reading", Place.CLIENT)  # the measurements of one axis in a cycle
Row = tuple[float, ...]  # values of an `AxisStatus` or a `Reading`, in the order of its fields
Parameters = tuple[float, ...]  # live parameters of an axis, in the order of the description

_SINCE = struct.Struct("=d")  # s, monotonic
_COMMAND = struct.Struct("=qqd")  # axis, parameter, value
_WANTED = struct.Struct("=dd")  # set-point, N*m; its time stamp, s, monotonic
# Byte offsets of the header's words: number of taken commands, stop request, last sign of life of the server (ns,
# monotonic), number of replaced servers, number of printed events.
_TAIL, _STOP, _HEARD, _REPLACED, _PRINTED = 0, 8, 16, 24, 32
_LATENESS = 64
_WORK = _LATENESS + 8 * BINS
_COMMANDS = -(-(_WORK + 8 * BINS) // 64) * 64
_TEXT = _COMMANDS + space(SLOTS, _COMMAND.size)
_STAGE = _TEXT + space(2, TEXT)
_STATUS = _STAGE + space(2, STAGE)


@dataclass(frozen=True)
class Command:
    """A command. `parameter` is an index in the table of live parameters, or one of the negative codes."""

    axis: int
    parameter: int
    value: float


RECOVER = -1  # bring the bus up again after a latched fault
RELEASE = -2  # release the latch of the axis' guard


class Mailbox:
    """Both ends of the mailbox: the loop's process creates the memory, the server's maps it from the descriptor."""

    def __init__(self, axes: int, parameters: int, descriptor: int | None = None) -> None:
        """`parameters` is the number of live parameters per axis, whose values are part of the status."""
        axis = len(AxisStatus._fields) + parameters
        self._status_format = struct.Struct(f"={len(General._fields) + axes * axis}d")
        wanted = _STATUS + space(2, self._status_format.size)
        each = space(2, _WANTED.size)
        measured = wanted + axes * each
        self._reading_format = struct.Struct(f"=dqq{axes * len(Reading._fields)}d")  # time, number, phase
        told = measured + space(2, self._reading_format.size)
        memory = SharedMemory(told + space(2, STAGE), descriptor)
        self._memory = memory
        self.descriptor = memory.descriptor
        self.lateness = memory.array(_LATENESS, BINS)
        self.work = memory.array(_WORK, BINS)
        self._axes = axes
        self._words = memory.words
        self._commands = Places(memory, _COMMANDS, SLOTS, _COMMAND.size)
        self._text = Newest(memory, _TEXT, TEXT)
        self._stage = Newest(memory, _STAGE, STAGE)
        self._status = Newest(memory, _STATUS, self._status_format.size)
        self._wanted = [Newest(memory, wanted + axis * each, _WANTED.size) for axis in range(axes)]
        self._measured = Newest(memory, measured, self._reading_format.size)
        self._told = Newest(memory, told, STAGE)
        self._put, _ = self._commands.newest()
        self._seen = bytes(self._status_format.size)  # the last complete status
        self._seen_text = (0, b"")
        self._seen_stage = b""

    @property
    def heard(self) -> float:
        """Return the time of the server's last sign of life, s, monotonic; 0 before the first."""
        return self._words[_HEARD // 8] * 1e-9

    @property
    def replaced(self) -> int:
        """Return the number of socket servers that were replaced."""
        return self._words[_REPLACED // 8]

    def close(self) -> None:
        """Unmap the memory; the kernel releases it after its last user."""
        self.lateness.release()
        self.work.release()
        self._memory.close()

    # The server's side

    def alive(self) -> None:
        """Record a sign of life of the server."""
        self._words[_HEARD // 8] = time.monotonic_ns()

    @property
    def printed(self) -> int:
        """Return the number of the last event that a server printed, -1 before the first."""
        return self._words[_PRINTED // 8] - 1

    def print_up_to(self, number: int) -> None:
        """Record that the events up to this number are printed; a server that replaces this one prints the others."""
        self._words[_PRINTED // 8] = number + 1

    def replace(self, number: int) -> None:
        """Record that `number` servers were replaced."""
        self._words[_REPLACED // 8] = number

    def put(self, command: Command) -> int | None:
        """Queue a command and return its ticket, or None if the queue is full."""
        if self._put - self._words[_TAIL // 8] >= SLOTS:
            return None
        self._put += 1
        self._commands.write(self._put, _COMMAND.pack(command.axis, command.parameter, command.value))
        return self._put - 1

    def taken(self, ticket: int) -> bool:
        """Return True if the loop has taken the command of this ticket."""
        return self._words[_TAIL // 8] > ticket

    def want(self, axis: int, value: float, time: float) -> None:
        """Replace the set-point of an axis (N*m); `time` is its time stamp in s, monotonic."""
        self._wanted[axis].write(_WANTED.pack(value, time))

    def withdraw(self) -> None:
        """Withdraw the set-points of all axes."""
        for register in self._wanted:
            register.write(_WANTED.pack(0.0, -math.inf))

    def tell(self, now: float, text: str) -> None:
        """Pass a text about the socket to the loop's events; it replaces an earlier text. `now` is monotonic, s."""
        self._told.write(_timed(now, text))

    def measured(self) -> tuple[float, int, int, list[Any]]:
        """Return time (s, monotonic), number and phase of the newest cycle, and a `Reading` per axis, or zeros."""
        number, content = self._measured.read()
        if number == 0:
            return 0.0, 0, 0, [Reading() for _ in range(self._axes)]
        time, cycle, phase, *values = self._reading_format.unpack(content)
        size = len(Reading._fields)
        return time, cycle, phase, [Reading(*values[n * size : (n + 1) * size]) for n in range(self._axes)]

    def request_stop(self) -> None:
        """Request the end of the loop, ahead of every queued command."""
        self._words[_STOP // 8] = 1

    def status(self) -> tuple[General, list[tuple[Any, Parameters]]]:
        """Return the last complete status, and an `AxisStatus` with live parameters per axis, or zeros."""
        self._seen = self._status.read()[1] or self._seen
        values = self._status_format.unpack(self._seen)
        general = len(General._fields)
        size = (len(values) - general) // max(1, self._axes)  # a starting daemon has no axes yet
        rows = [values[general + n * size : general + (n + 1) * size] for n in range(self._axes)]
        fields = len(AxisStatus._fields)
        return General(*values[:general]), [(AxisStatus(*row[:fields]), row[fields:]) for row in rows]

    def text(self) -> tuple[int, bytes]:
        """Return number and bytes of the last complete events; 0 and no bytes before the first."""
        found = self._text.read()
        self._seen_text = found if found[0] else self._seen_text
        return self._seen_text

    def stage(self) -> tuple[float, str]:
        """Return the start (s, monotonic) and the name of the startup stage; the name is empty while the loop runs."""
        found = self._stage.read()
        self._seen_stage = found[1] if found[0] else self._seen_stage
        return _of_time(self._seen_stage)

    # The loop's side

    def take(self) -> Command | None:
        """Return the next command or None. The loop takes one per cycle, so that no client can fill a cycle."""
        number = self._words[_TAIL // 8] + 1
        content = self._commands.read(number)
        if content is None:
            return None
        self._words[_TAIL // 8] = number
        return Command(*_COMMAND.unpack(content))

    def wanted(self, axis: int) -> tuple[float, float] | None:
        """Return the newest set-point of an axis and its time (-inf after a withdrawal) once, otherwise None."""
        content = self._wanted[axis].take()
        return None if content is None else _WANTED.unpack(content)

    @property
    def stop_requested(self) -> bool:
        return self._words[_STOP // 8] != 0

    def told(self) -> tuple[float, str] | None:
        """Return time and text of the last `tell` once, otherwise None."""
        content = self._told.take()
        return None if content is None else _of_time(content)

    def measure(self, now: float, cycle: int, phase: int, axes: Iterable[Iterable[float]]) -> None:
        """Write the values of the `Reading` of each axis in a cycle; `now` in s, monotonic."""
        values = chain.from_iterable(axes)
        self._measured.write(self._reading_format.pack(now, cycle, phase, *values))

    def publish(self, general: General, axes: Sequence[tuple[Row, Parameters]]) -> None:
        """Write a new status."""
        values = [value for axis, parameters in axes for value in (*axis, *parameters)]
        self._status.write(self._status_format.pack(*general, *values))

    def publish_stage(self, now: float, text: str) -> None:
        """Write the startup stage that begins at `now` (s); an empty text ends the startup."""
        self._stage.write(_timed(now, text))

    def publish_text(self, text: bytes) -> None:
        """Write the events; the caller limits them to `TEXT` bytes."""
        self._text.write(text)


def _timed(now: float, text: str) -> bytes:
    return _SINCE.pack(now) + text.encode()[: STAGE - _SINCE.size]


def _of_time(content: bytes) -> tuple[float, str]:
    if len(content) < _SINCE.size:
        return 0.0, ""
    return _SINCE.unpack_from(content)[0], content[_SINCE.size :].decode(errors="replace")
