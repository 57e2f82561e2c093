"""Starting and ending the processes that read serial sensors; the loop only asks for values."""

from __future__ import annotations

import functools
import subprocess
from collections.abc import Callable, Sequence

import msgspec

from tsa_ctrl.sensors.settings import SerialSensorSettings
from tsa_ctrl.sensors.slots import Reading, Slots
from tsa_ctrl.system.parent import child as start

PATIENCE = 2.0  # s for a reader to end


class SerialSensors:
    """The sensors of a configuration, each with its process; start them before real-time scheduling is taken."""

    def __init__(self, settings: Sequence[SerialSensorSettings]) -> None:
        self.settings = tuple(settings)
        self._slots = Slots(max(1, len(self.settings)))
        self._children = [self._start(index) for index in range(len(self.settings))]

    def _start(self, index: int) -> subprocess.Popen[bytes]:
        text = msgspec.json.encode(self.settings[index]).decode()
        fd, count = self._slots.fd, self._slots.count
        return start("tsa_ctrl.sensors.reader", fd, count, index, text, stdout=subprocess.DEVNULL, fd=fd)

    def reader(self, index: int) -> Callable[[float], float]:
        """SI value of a sensor at a monotonic time, nan when there is none younger than its time-out; about 1 us."""
        return functools.partial(self._slots.fresh, index, timeout=self.settings[index].timeout)

    def reading(self, index: int) -> Reading:
        """The newest reading with its counts and state, for status pages."""
        return self._slots.read(index)

    def alive(self, index: int) -> bool:
        """Whether the process of a sensor runs."""
        return self._children[index].poll() is None

    def close(self) -> None:
        """End the processes; may be called twice."""
        for child in self._children:
            if child.stdin is not None:
                child.stdin.close()
        for child in self._children:
            try:
                child.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        if self._children:
            self._children = []
            self._slots.close()
