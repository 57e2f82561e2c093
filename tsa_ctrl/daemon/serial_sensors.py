"""The serial sensors of all axes: their processes, what the loop reads from them, and their health as events."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tsa_ctrl.config import AxisSettings
from tsa_ctrl.daemon.events import Events
from tsa_ctrl.sensors.process import SerialSensors
from tsa_ctrl.sensors.slots import LineState

TOLD = {
    LineState.READING: "values come",
    LineState.SILENT: "open, but no value that can be read comes",
    LineState.LOST: "cannot be opened, or was unplugged",
}


class AxisSensors:
    """Starts one process per sensor; before real-time scheduling is taken, which children would inherit."""

    def __init__(self, axes: Sequence[AxisSettings]) -> None:
        self._place = tuple((axis.name, sensor) for axis in axes for sensor in axis.serial)
        self._sensors = SerialSensors([sensor for _, sensor in self._place])
        self._told: dict[int, LineState] = {}
        self._gone: set[int] = set()

    def sources(self, axis: str) -> dict[str, Callable[[float], float]]:
        """What reads each quantity of an axis, by its name."""
        return {
            sensor.quantity: self._sensors.reader(index)
            for index, (name, sensor) in enumerate(self._place)
            if name == axis
        }

    def check(self, t: float, events: Events) -> None:
        """Say what has changed since the last look; about once a second is enough."""
        for index, (axis, sensor) in enumerate(self._place):
            where = f"serial {sensor.quantity} on {sensor.port}"
            if not self._sensors.alive(index):
                if index not in self._gone:
                    self._gone.add(index)
                    events.add(t, axis, f"{where}: its process is gone; no more values")
                continue
            state = self._sensors.reading(index).state
            if state is not self._told.get(index, LineState.STARTING) and state in TOLD:
                self._told[index] = state
                events.add(t, axis, f"{where}: {TOLD[state]}")

    def close(self) -> None:
        self._sensors.close()
