"""The newest value of each serial sensor in shared memory: one writer per slot, read by the loop without a lock.

A slot carries a sequence number that is odd while it is written (a seqlock); the memory has no name and is handed to
child processes as a descriptor.
"""

from __future__ import annotations

import math
import mmap
import os
import struct
from dataclasses import dataclass
from enum import IntEnum

SIZE = 64  # bytes per slot: a cache line of its own
_VALUE = struct.Struct("=ddQQq")  # value, monotonic time in s, values, rejected lines, LineState
_SEQUENCE = struct.Struct("=Q")
_TRIES = 3  # a reader that meets a write takes the value of the next cycle


class LineState(IntEnum):
    """What the reading process says of its line."""

    STARTING = 0
    READING = 1
    SILENT = 2  # open, but nothing that can be read comes
    LOST = 3  # cannot be opened, or was unplugged


@dataclass(frozen=True)
class Reading:
    """`value` in SI units, sampled at monotonic `time` in s; counts since the start."""

    value: float
    time: float
    count: int
    rejected: int
    state: LineState


NOTHING = Reading(math.nan, -math.inf, 0, 0, LineState.STARTING)


class Slots:
    """Shared memory for `count` sensors; made by the daemon, mapped again by each reader process."""

    def __init__(self, count: int, fd: int | None = None) -> None:
        self.count = count
        if fd is None:
            fd = os.memfd_create("tsa-serial", os.MFD_CLOEXEC)
            os.ftruncate(fd, count * SIZE)
        self.fd = fd
        self._map = mmap.mmap(fd, count * SIZE)
        if not any(self._map[:]):
            for index in range(count):
                self.write(index, NOTHING)

    def write(self, index: int, reading: Reading) -> None:
        """Store a reading; only the one process that owns the slot may."""
        base = index * SIZE
        sequence = _SEQUENCE.unpack_from(self._map, base)[0]
        _SEQUENCE.pack_into(self._map, base, sequence + 1)
        _VALUE.pack_into(
            self._map, base + 8, reading.value, reading.time, reading.count, reading.rejected, reading.state
        )
        _SEQUENCE.pack_into(self._map, base, sequence + 2)

    def read(self, index: int) -> Reading:
        """The newest reading; NOTHING when it was being written each time."""
        base = index * SIZE
        for _ in range(_TRIES):
            before = _SEQUENCE.unpack_from(self._map, base)[0]
            value, time, count, rejected, state = _VALUE.unpack_from(self._map, base + 8)
            if before % 2 == 0 and _SEQUENCE.unpack_from(self._map, base)[0] == before:
                return Reading(value, time, count, rejected, LineState(state))
        return NOTHING

    def fresh(self, index: int, now: float, timeout: float) -> float:
        """The newest value if it is at most `timeout` s old at monotonic `now`, else nan; for the loop."""
        base = index * SIZE
        before = _SEQUENCE.unpack_from(self._map, base)[0]
        value: float
        value, time, *_ = _VALUE.unpack_from(self._map, base + 8)
        if before % 2 or _SEQUENCE.unpack_from(self._map, base)[0] != before or now - time > timeout:
            return math.nan
        return value

    def close(self) -> None:
        self._map.close()
        os.close(self.fd)
