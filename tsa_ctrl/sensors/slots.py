"""The newest value of each serial sensor in shared memory: one writer per slot, read by the loop without a lock.

A slot has two places, written in turn, and the number of the last write, which names the place that is whole: a
writer that is stopped in the middle of a write keeps nobody from the value before. The memory has no name and is handed
to child processes as a descriptor.
"""

from __future__ import annotations

import math
import mmap
import os
import struct
from dataclasses import dataclass
from enum import IntEnum

SIZE = 128  # bytes per slot: cache lines of its own
_VALUE = struct.Struct("=ddQQq")  # value, monotonic time in s, values, rejected lines, LineState
_WRITES = struct.Struct("=Q")
_PLACES = (8, 8 + _VALUE.size)  # offsets in the slot: of an even and of an odd number of writes
_TRIES = 5  # a try is lost only when a whole write ended meanwhile


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
_NOTHING = (math.nan, -math.inf, 0, 0, int(LineState.STARTING))


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
        writes = _WRITES.unpack_from(self._map, base)[0] + 1
        _VALUE.pack_into(
            self._map,
            base + _PLACES[writes & 1],
            reading.value,
            reading.time,
            reading.count,
            reading.rejected,
            reading.state,
        )
        _WRITES.pack_into(self._map, base, writes)

    def read(self, index: int) -> Reading:
        """The newest reading; NOTHING when it was overwritten while it was read, each time."""
        value, time, count, rejected, state = self._newest(index)
        return Reading(value, time, count, rejected, LineState(state))

    def fresh(self, index: int, now: float, timeout: float) -> float:
        """The newest value if it is at most `timeout` s old at monotonic `now`, else nan; for the loop."""
        value, time, *_ = self._newest(index)
        return math.nan if now - time > timeout else value

    def _newest(self, index: int) -> tuple[float, float, int, int, int]:
        base = index * SIZE
        for _ in range(_TRIES):
            writes = _WRITES.unpack_from(self._map, base)[0]
            found: tuple[float, float, int, int, int] = _VALUE.unpack_from(self._map, base + _PLACES[writes & 1])
            if _WRITES.unpack_from(self._map, base)[0] == writes:  # else this place may be in use again
                return found
        return _NOTHING

    def close(self) -> None:
        self._map.close()
        os.close(self.fd)
