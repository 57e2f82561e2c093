"""Define the settings of a sensor on a serial line, and run the processes that read such sensors.

The settings are the port, the format of a line, the maximum age of a value and its valid range. The loop reads the
newest value of each sensor from shared memory.
"""

from __future__ import annotations

import functools
import math
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from tsa_ctrl.errors import UsageError
from tsa_ctrl.system.process_supervisor import Child
from tsa_ctrl.system.serial_port import Port, check_port
from tsa_ctrl.system.shared_memory import Newest, SharedMemory, space

NUMBER = r"^\s*(?P<value>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)\s*$"


class SerialSensorSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One sensor. A text line that matches `pattern` is converted to value * scale + offset in SI units."""

    port: Port  # device, or a URL of pyserial
    # tau_j: N*m at the joint; t1, t3: N of tendon a, b at the motor; theta, temperature: rad, degC of the sheath
    quantity: Literal["tau_j", "t1", "t3", "theta", "temperature"]
    baud_rate: Annotated[int, Meta(ge=50, le=12_000_000)] = 115_200
    pattern: str = NUMBER  # regular expression with a group "value" (and optionally "unit")
    unit: str = ""  # if given, the pattern's group "unit" must equal it
    scale: float = 1.0  # SI per unit of the line; a negative scale inverts the sign
    offset: float = 0.0  # SI, added after scaling
    low: float = -1e4  # SI: a value outside low to high is a line error, which is discarded and counted
    high: float = 1e4
    request: str = ""  # sent for each value, for sensors that respond only to requests
    rate: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 100.0  # rate of requests and of expected answers, Hz
    timeout: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.1  # s; an older value counts as missing


def check(settings: SerialSensorSettings, where: str) -> None:
    """Raise UsageError if settings contradict each other, or port or pattern cannot work."""
    check_port(settings.port, where)
    try:
        groups = re.compile(settings.pattern).groupindex
    except re.error as error:
        raise UsageError(
            f"{where}: pattern '{settings.pattern}' is not a regular expression ({error}); correct it"
        ) from None
    if "value" not in groups:
        raise UsageError(
            f"{where}: pattern '{settings.pattern}' has no group 'value'; write (?P<value>...) around the number"
        )
    if settings.unit and "unit" not in groups:
        raise UsageError(f"{where}: unit '{settings.unit}' is asked for, but the pattern has no group 'unit'; add one")
    if settings.scale == 0.0:
        raise UsageError(f"{where}: scale is 0; give SI units per unit of the line")
    if settings.low >= settings.high:
        raise UsageError(f"{where}: low {settings.low:g} is not below high {settings.high:g}; correct one")
    if settings.timeout < 1.0 / settings.rate:
        raise UsageError(
            f"{where}: timeout {settings.timeout:g} s is shorter than the time between two values at "
            f"{settings.rate:g} Hz; raise it, or correct rate"
        )


def check_all(sensors: Sequence[SerialSensorSettings], where: str, measured: set[str]) -> None:
    """Check each sensor, and check that no quantity or port is used twice.

    Args:
        sensors: settings of the serial sensors.
        where: place in the settings, for messages.
        measured: quantities that other sensors measure already.

    Raises:
        UsageError: A sensor is wrong, or two sensors share a quantity or a port.
    """
    seen, ports = set(measured), set[str]()
    for sensor in sensors:
        here = f"{where}: serial {sensor.quantity}"
        check(sensor, here)
        if sensor.quantity in seen:
            raise UsageError(f"{here}: {sensor.quantity} already has a sensor; keep one of them")
        if sensor.port in ports:
            raise UsageError(f"{here}: port {sensor.port} is already read by another sensor; give each its own")
        seen.add(sensor.quantity)
        ports.add(sensor.port)


# Each sensor has one slot in shared memory with one writer. The loop reads it without a lock.
_READING = struct.Struct("=ddQQq")  # value, monotonic time in s, values, rejected lines, LineState


class LineState(IntEnum):
    """The state of a serial line, reported by its reader process."""

    STARTING = 0
    READING = 1
    SILENT = 2  # open, but no valid value arrives
    LOST = 3  # cannot be opened, or was unplugged


@dataclass(frozen=True)
class Reading:
    """The newest reading of a sensor.

    Attributes:
        value: value in SI units.
        time: arrival time, s on the monotonic clock.
        count: number of valid values since startup.
        rejected: number of rejected lines since startup.
        state: state of the serial line.
    """

    value: float
    time: float
    count: int
    rejected: int
    state: LineState


NOTHING = Reading(math.nan, -math.inf, 0, 0, LineState.STARTING)


class Slots:
    """The newest reading of each of `count` sensors. The daemon creates them, and the reader processes map them."""

    def __init__(self, count: int, fd: int | None = None) -> None:
        each = space(2, _READING.size)
        self.count = count
        self._memory = SharedMemory(count * each, fd)
        self.fd = self._memory.descriptor
        self._newest = [Newest(self._memory, index * each, _READING.size) for index in range(count)]

    def write(self, index: int, reading: Reading) -> None:
        """Store a reading. Only the reader process of the slot may call this."""
        self._newest[index].write(
            _READING.pack(reading.value, reading.time, reading.count, reading.rejected, reading.state)
        )

    def read(self, index: int) -> Reading:
        """Return the newest reading, or NOTHING before the first one or if each attempt to read was overwritten."""
        number, content = self._newest[index].read()
        if not number:
            return NOTHING
        value, time, count, rejected, state = _READING.unpack(content)
        return Reading(value, time, count, rejected, LineState(state))

    def fresh(self, index: int, now: float, timeout: float) -> float:
        """Return the newest value, or nan if it is older than `timeout` (s) at the monotonic time `now` (s)."""
        number, content = self._newest[index].read()
        if not number:
            return math.nan
        value, time, *_ = _READING.unpack(content)
        return math.nan if now - time > timeout else float(value)

    def close(self) -> None:
        self._memory.close()


PATIENCE = 2.0  # s for a reader process to end


class SerialSensors:
    """The sensors of a configuration, each with its process. Create it before real-time scheduling is requested."""

    def __init__(self, settings: Sequence[SerialSensorSettings]) -> None:
        self.settings = tuple(settings)
        self._slots = Slots(max(1, len(self.settings)))
        self._children = [self._start(index) for index in range(len(self.settings))]

    def _start(self, index: int) -> Child:
        text = msgspec.json.encode(self.settings[index]).decode()
        fd, count = self._slots.fd, self._slots.count
        return Child("tsa_ctrl.sensors.reader", fd, count, index, text, reports=False, fd=fd)

    def reader(self, index: int) -> Callable[[float], float]:
        """Return a function that maps the monotonic time (s) to a sensor's SI value, or to nan if it is too old."""
        return functools.partial(self._slots.fresh, index, timeout=self.settings[index].timeout)

    def reading(self, index: int) -> Reading:
        """Return the newest reading with its counts and state, for status pages."""
        return self._slots.read(index)

    def alive(self, index: int) -> bool:
        """Return True if the process of a sensor is running."""
        return self._children[index].alive

    def close(self) -> None:
        """End the processes. Repeated calls have no effect."""
        for child in self._children:
            if child.stdin is not None:
                child.stdin.close()
        for child in self._children:
            child.end(PATIENCE)
        if self._children:
            self._children = []
            self._slots.close()
