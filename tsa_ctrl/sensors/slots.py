"""The newest value of each serial sensor in shared memory: one writer per slot, read by the loop without a lock."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

from tsa_ctrl.system.shared_memory import Newest, SharedMemory, space

_READING = struct.Struct("=ddQQq")  # value, monotonic time in s, values, rejected lines, LineState


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
    """One newest reading for each of `count` sensors; made by the daemon, mapped again by each reader process."""

    def __init__(self, count: int, fd: int | None = None) -> None:
        each = space(2, _READING.size)
        self.count = count
        self._memory = SharedMemory(count * each, fd)
        self.fd = self._memory.descriptor
        self._newest = [Newest(self._memory, index * each, _READING.size) for index in range(count)]

    def write(self, index: int, reading: Reading) -> None:
        """Store a reading; only the one process that owns the slot may."""
        self._newest[index].write(
            _READING.pack(reading.value, reading.time, reading.count, reading.rejected, reading.state)
        )

    def read(self, index: int) -> Reading:
        """The newest reading; NOTHING before the first, or when it was written over while it was read, each time."""
        number, content = self._newest[index].read()
        if not number:
            return NOTHING
        value, time, count, rejected, state = _READING.unpack(content)
        return Reading(value, time, count, rejected, LineState(state))

    def fresh(self, index: int, now: float, timeout: float) -> float:
        """The newest value if it is at most `timeout` s old at monotonic `now`, else nan; for the loop."""
        number, content = self._newest[index].read()
        if not number:
            return math.nan
        value, time, *_ = _READING.unpack(content)
        return math.nan if now - time > timeout else float(value)

    def close(self) -> None:
        self._memory.close()
