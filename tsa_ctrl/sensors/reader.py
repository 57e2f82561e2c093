"""The process that reads one serial sensor: `python -m tsa_ctrl.sensors.reader FD COUNT INDEX SETTINGS-JSON`.

It opens the port, and opens it again after it was unplugged; it stamps each value with the monotonic time of its
arrival and leaves it in its slot. It ends when its standard input is closed, that is when the daemon is gone.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import time

import msgspec
import serial

from tsa_ctrl.sensors.parser import LineParser
from tsa_ctrl.sensors.settings import SerialSensorSettings
from tsa_ctrl.sensors.slots import LineState, Reading, Slots
from tsa_ctrl.system.signals import ignore

RETRY = 0.5  # s between attempts to open a port
TICK = 0.05  # s: how often the parent's life and the line's silence are looked at
CHUNK = 4096  # bytes


class SerialReader:
    """Reads one line into one slot until told to end."""

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
        """Until standard input is closed."""
        while not parent_gone(0.0):
            try:
                port = serial.serial_for_url(self.settings.port, self.settings.baud_rate, timeout=0, write_timeout=TICK)
            except (serial.SerialException, OSError, ValueError):
                self.say(LineState.LOST)
                if parent_gone(RETRY):
                    return
                continue
            self.parser.reset()
            with contextlib.suppress(serial.SerialException, OSError), port:
                if self.listen(port):
                    return
            self.say(LineState.LOST)
            if parent_gone(RETRY):
                return

    def listen(self, port: serial.SerialBase) -> bool:
        """Read until the port fails (SerialException, OSError); True when the parent is gone."""
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
        """Send the request when it is time, for sensors that answer only when asked."""
        now = time.monotonic()
        if self.settings.request and now >= self._next_request:
            port.write(self.settings.request.encode("ascii", errors="replace"))
            self._next_request = max(self._next_request + 1.0 / self.settings.rate, now)

    def say(self, state: LineState) -> None:
        self.slots.write(self.index, Reading(self.value, self.time, self.count, self.parser.rejected, state))


def parent_gone(wait: float) -> bool:
    """Whether standard input is closed within `wait` s."""
    ready, _, _ = select.select([sys.stdin], [], [], wait)
    return bool(ready) and os.read(sys.stdin.fileno(), 1) == b""


def main() -> None:
    """Read one sensor until the daemon ends this process."""
    ignore(signal.SIGINT, signal.SIGHUP)  # they are for the daemon, which then ends this process
    fd, count, index, text = sys.argv[1:]
    settings = msgspec.json.decode(text, type=SerialSensorSettings)
    SerialReader(settings, Slots(int(count), int(fd)), int(index)).run()


if __name__ == "__main__":
    main()
