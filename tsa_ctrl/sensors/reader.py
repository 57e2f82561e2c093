"""Read one serial sensor in a separate process: `python -m tsa_ctrl.sensors.reader FD COUNT INDEX SETTINGS-JSON`.

The process opens the port, and reopens it after the sensor was unplugged. It writes the newest value and its arrival
time (monotonic) to its slot. It ends when its standard input is closed, which happens when the daemon ends.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import select
import signal
import sys
import time

import msgspec
import serial

from tsa_ctrl.sensors.process import LineState, Reading, SerialSensorSettings, Slots
from tsa_ctrl.system.process_supervisor import ignore

MOST_LINE = 256  # bytes; a longer line is noise, and all bytes up to the next line end are discarded
_END = re.compile(rb"[\r\n]+")


class LineParser:
    """Convert the bytes of an ASCII line protocol to values in SI units.

    The parser has no I/O, buffers a bounded number of bytes, and tolerates noise and incomplete lines. It discards the
    first line after each connection, because the start of that line may be missing.
    """

    def __init__(self, settings: SerialSensorSettings) -> None:
        self._settings = settings
        self._pattern = re.compile(settings.pattern)
        self._rest = b""
        self._synchronised = False
        self.rejected = 0

    def reset(self) -> None:
        """Discard the incomplete line after a lost connection."""
        self._rest = b""
        self._synchronised = False

    def feed(self, data: bytes) -> list[float]:
        """Return the values of all lines that `data` completes, oldest first.

        An incomplete last line is kept for the next call.
        """
        pieces = _END.split(self._rest + data)
        self._rest = pieces.pop()
        if len(self._rest) > MOST_LINE:
            self._rest = b""
            self._synchronised = False
            self.rejected += 1
        values = []
        for line in pieces:
            if not self._synchronised:
                self._synchronised = True
                continue
            if not line:
                continue
            value = self._value(line)
            if value is None:
                self.rejected += 1
            else:
                values.append(value)
        return values

    def _value(self, line: bytes) -> float | None:
        if len(line) > MOST_LINE:
            return None
        settings = self._settings
        match = self._pattern.search(line.decode("ascii", errors="replace"))
        if match is None or (settings.unit and match["unit"] != settings.unit):
            return None
        try:
            value = float(match["value"]) * settings.scale + settings.offset
        except (TypeError, ValueError):
            return None
        return value if math.isfinite(value) and settings.low <= value <= settings.high else None


RETRY = 0.5  # s between attempts to open a port
TICK = 0.05  # s between two checks for a closed standard input and a silent sensor
CHUNK = 4096  # bytes


class SerialReader:
    """Read one serial line into one slot until the parent ends."""

    def __init__(self, settings: SerialSensorSettings, slots: Slots, index: int) -> None:
        self.settings = settings
        self.slots = slots
        self.index = index
        self.parser = LineParser(settings)
        self.value = math.nan
        self.time = -math.inf
        self.count = 0
        self._next_request = 0.0

    def run(self) -> None:
        """Read until standard input is closed; reopen the port after each failure."""
        address, rate = self.settings.port, self.settings.baud_rate
        wait = 0.0
        while not parent_gone(wait):
            with (
                contextlib.suppress(serial.SerialException, OSError, ValueError),
                serial.serial_for_url(address, rate, timeout=0, write_timeout=TICK) as port,
            ):
                self.parser.reset()
                if self.listen(port):
                    return
            self.say(LineState.LOST)
            wait = RETRY

    def listen(self, port: serial.SerialBase) -> bool:
        """Read until the parent has ended, and then return True.

        Raises:
            SerialException: The port failed.
            OSError: The port failed.
        """
        opened = time.monotonic()
        while True:
            self.ask(port)
            wait = min(TICK, 1.0 / self.settings.rate if self.settings.request else TICK)
            ready, _, _ = select.select([port.fileno(), sys.stdin], [], [], wait)
            if sys.stdin in ready and parent_gone(0.0):
                return True
            now = time.monotonic()
            if port.fileno() in ready:
                data = os.read(port.fileno(), CHUNK)
                if not data:
                    raise OSError("unplugged")
                values = self.parser.feed(data)
                if values:
                    self.value, self.time, self.count = values[-1], now, self.count + len(values)
            quiet = now - max(self.time, opened) > self.settings.timeout
            self.say(LineState.SILENT if quiet else LineState.READING)

    def ask(self, port: serial.SerialBase) -> None:
        """Send the request at the configured rate if the sensor responds only to requests."""
        now = time.monotonic()
        if self.settings.request and now >= self._next_request:
            port.write(self.settings.request.encode("ascii", errors="replace"))
            self._next_request = max(self._next_request + 1.0 / self.settings.rate, now)

    def say(self, state: LineState) -> None:
        self.slots.write(self.index, Reading(self.value, self.time, self.count, self.parser.rejected, state))


def parent_gone(wait: float) -> bool:
    """Return True if standard input is closed within `wait` s."""
    ready, _, _ = select.select([sys.stdin], [], [], wait)
    return bool(ready) and os.read(sys.stdin.fileno(), 1) == b""


def main() -> None:
    """Read one sensor until the daemon ends this process."""
    ignore(signal.SIGINT, signal.SIGHUP)  # the daemon handles both and then ends this process
    fd, count, index, text = sys.argv[1:]
    settings = msgspec.json.decode(text, type=SerialSensorSettings)
    SerialReader(settings, Slots(int(count), int(fd)), int(index)).run()


if __name__ == "__main__":
    main()
