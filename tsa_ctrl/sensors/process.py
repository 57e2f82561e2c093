"""Start and end the processes that read serial sensors, and provide their newest values to the loop."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import msgspec

from tsa_ctrl.sensors.settings import SerialSensorSettings
from tsa_ctrl.system.process_supervisor import Child
from tsa_ctrl.system.shared_memory import Newest, SharedMemory, space

# One slot in shared memory per sensor, with one writer each; the loop reads it without a lock.
_READING = struct.Struct("=ddQQq")  # value, monotonic time in s, values, rejected lines, LineState


class LineState(IntEnum):
    """List the states of a serial line, reported by its reading process."""

    STARTING = 0
    READING = 1
    SILENT = 2  # open, but no valid value arrives
    LOST = 3  # cannot be opened, or was unplugged


@dataclass(frozen=True)
class Reading:
    """Hold the newest `value` in SI units, its arrival `time` (s, monotonic) and the counts since the start."""

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


PATIENCE = 2.0  # s for a reader to end


class SerialSensors:
    """The sensors of a configuration, each with its process; start them before real-time scheduling is taken."""

    def __init__(self, settings: Sequence[SerialSensorSettings]) -> None:
        self.settings = tuple(settings)
        self._slots = Slots(max(1, len(self.settings)))
        self._children = [self._start(index) for index in range(len(self.settings))]

    def _start(self, index: int) -> Child:
        text = msgspec.json.encode(self.settings[index]).decode()
        fd, count = self._slots.fd, self._slots.count
        return Child("tsa_ctrl.sensors.reader", fd, count, index, text, reports=False, fd=fd)

    def reader(self, index: int) -> Callable[[float], float]:
        """SI value of a sensor at a monotonic time, nan if the newest is older than its time-out; about 1 us."""
        return functools.partial(self._slots.fresh, index, timeout=self.settings[index].timeout)

    def reading(self, index: int) -> Reading:
        """The newest reading with its counts and state, for status pages."""
        return self._slots.read(index)

    def alive(self, index: int) -> bool:
        """Return True if the process of a sensor runs."""
        return self._children[index].alive

    def close(self) -> None:
        """End the processes; may be called twice."""
        for child in self._children:
            if child.stdin is not None:
                child.stdin.close()
        for child in self._children:
            child.end(PATIENCE)
        if self._children:
            self._children = []
            self._slots.close()
