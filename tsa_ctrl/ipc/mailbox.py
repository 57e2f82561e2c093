"""Shared memory between the loop and the socket server: commands in, status out. Neither side ever waits for the other.

Anonymous memory (memfd), inherited by descriptor: no name, no leftovers. Every counter has one writer. Commands are a
ring with a bound; the status is a snapshot under a sequence number that is odd while it is being written.
"""

from __future__ import annotations

import mmap
import os
import struct
from dataclasses import dataclass

from tsa_ctrl.system.histogram import BINS

SLOTS = 64  # commands that may wait; the loop takes one per cycle
TEXT = 16 * 1024  # bytes of events
GENERAL = ("time", "start", "cycles", "planned", "skipped", "overruns", "dropped", "log_lost", "phase")
AXIS = (
    "t",
    "tau_j_des",
    "tau_m_cmd",
    "tau_m",
    "tau_j",
    "omega_j",
    "q_j",
    "sigma",
    "friction_term",
    "friction_angle",
    "pretension",
    "estimate_state",
    "state",
    "limit_reason",
    "missed",
    "pdo_age",
    "late",
    "repeated",
    "malformed",
)
COUNTS = ("missed", "late", "repeated", "malformed")  # of AXIS: whole numbers since the start

_COMMAND = struct.Struct("<qqd")  # axis, parameter, value
_WORD = struct.Struct("<Q")
_HEAD, _TAIL, _STOP, _STATUS_SEQUENCE, _TEXT_SEQUENCE, _TEXT_LENGTH = (64 * n for n in range(6))  # a cache line each
_COMMANDS = 64 * 6
_LATENESS = _COMMANDS + SLOTS * _COMMAND.size
_WORK = _LATENESS + 8 * BINS
_TEXT = _WORK + 8 * BINS
_STATUS = _TEXT + TEXT
_TRIES = 100  # of reading a snapshot that is being written; the writer needs microseconds


@dataclass(frozen=True)
class Command:
    """One command for the loop; `parameter` indexes the table of live parameters, or is one of the negative codes."""

    axis: int
    parameter: int
    value: float


SET_POINT = -1  # value: joint torque wanted, N*m
RECOVER = -2  # bring the bus up again after a latched fault


class Mailbox:
    """Both ends; `create` in the loop's process, `attach` in the server's."""

    def __init__(self, descriptor: int, axes: int, parameters: int) -> None:
        """`parameters`: live parameters per axis, whose values are part of the status."""
        self.descriptor = descriptor
        self._axes = axes
        self._general = struct.Struct(f"<{len(GENERAL)}d")
        self._axis = struct.Struct(f"<{len(AXIS) + parameters}d")
        self._size = self.size(axes, parameters)
        self._memory = mmap.mmap(descriptor, self._size)
        self._view = memoryview(self._memory)
        self.lateness = self._view[_LATENESS:_WORK].cast("Q")
        self.work = self._view[_WORK:_TEXT].cast("Q")

    @staticmethod
    def size(axes: int, parameters: int) -> int:
        return _STATUS + 8 * (len(GENERAL) + axes * (len(AXIS) + parameters))

    @classmethod
    def create(cls, axes: int, parameters: int) -> Mailbox:
        descriptor = os.memfd_create("tsa-mailbox", os.MFD_CLOEXEC)
        os.ftruncate(descriptor, cls.size(axes, parameters))
        return cls(descriptor, axes, parameters)

    def close(self) -> None:
        """Unmap; the memory goes with its last user."""
        self.lateness.release()
        self.work.release()
        self._view.release()
        self._memory.close()
        os.close(self.descriptor)

    # The server's side

    def put(self, command: Command) -> int | None:
        """Queue a command; its ticket, or None when the queue is full."""
        head = self._word(_HEAD)
        if head - self._word(_TAIL) >= SLOTS:
            return None
        at = _COMMANDS + head % SLOTS * _COMMAND.size
        _COMMAND.pack_into(self._memory, at, command.axis, command.parameter, command.value)
        _WORD.pack_into(self._memory, _HEAD, head + 1)
        return head

    def taken(self, ticket: int) -> bool:
        """Whether the loop has taken the command of this ticket."""
        return self._word(_TAIL) > ticket

    def request_stop(self) -> None:
        """Ask the loop to end; never queued behind anything."""
        _WORD.pack_into(self._memory, _STOP, 1)

    def status(self) -> tuple[tuple[float, ...], list[tuple[float, ...]]]:
        """The last snapshot: GENERAL, and for each axis AXIS followed by its live parameters."""
        for _ in range(_TRIES):
            before = self._word(_STATUS_SEQUENCE)
            copy = bytes(self._view[_STATUS : self._size])
            if before % 2 == 0 and self._word(_STATUS_SEQUENCE) == before:
                break
        at = self._general.size
        axes = [self._axis.unpack_from(copy, at + n * self._axis.size) for n in range(self._axes)]
        return self._general.unpack_from(copy), axes

    def text(self) -> tuple[int, bytes]:
        """Sequence number and bytes of the events as last published."""
        for _ in range(_TRIES):
            before = self._word(_TEXT_SEQUENCE)
            copy = bytes(self._view[_TEXT : _TEXT + self._word(_TEXT_LENGTH)])
            if before % 2 == 0 and self._word(_TEXT_SEQUENCE) == before:
                break
        return before, copy

    # The loop's side

    def take(self) -> Command | None:
        """The next command, or None; never more than one, so that no client can fill a cycle."""
        tail = self._word(_TAIL)
        if tail == self._word(_HEAD):
            return None
        command = Command(*_COMMAND.unpack_from(self._memory, _COMMANDS + tail % SLOTS * _COMMAND.size))
        _WORD.pack_into(self._memory, _TAIL, tail + 1)
        return command

    @property
    def stop_requested(self) -> bool:
        return self._word(_STOP) != 0

    def publish(self, general: tuple[float, ...], axes: list[tuple[float, ...]]) -> None:
        """Write a new snapshot."""
        sequence = self._word(_STATUS_SEQUENCE)
        _WORD.pack_into(self._memory, _STATUS_SEQUENCE, sequence + 1)
        self._general.pack_into(self._memory, _STATUS, *general)
        at = _STATUS + self._general.size
        for values in axes:
            self._axis.pack_into(self._memory, at, *values)
            at += self._axis.size
        _WORD.pack_into(self._memory, _STATUS_SEQUENCE, sequence + 2)

    def publish_text(self, text: bytes) -> None:
        """Write the events, cut to what fits by the caller (`TEXT` bytes)."""
        sequence = self._word(_TEXT_SEQUENCE)
        _WORD.pack_into(self._memory, _TEXT_SEQUENCE, sequence + 1)
        self._view[_TEXT : _TEXT + len(text)] = text
        _WORD.pack_into(self._memory, _TEXT_LENGTH, len(text))
        _WORD.pack_into(self._memory, _TEXT_SEQUENCE, sequence + 2)

    def _word(self, at: int) -> int:
        value: int = _WORD.unpack_from(self._memory, at)[0]
        return value
