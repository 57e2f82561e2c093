"""Keep the events of a run in order, for the status, the summary and connected clients; nothing here prints."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from tsa_ctrl.config import AxisSettings
from tsa_ctrl.ipc.mailbox import TEXT
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.safety.causes import Cause
from tsa_ctrl.sensors.process import LineState, SerialSensors

MOST = 50  # events that are kept, the first fault among them
LONGEST = 1000  # characters of a text; the first fault always has room in the mailbox
LONGEST_NAME = 100  # characters of an axis' name


class Events:
    """Keep the newest events and the first fault, which is never dropped because it is the cause."""

    def __init__(self) -> None:
        self._kept: list[Event] = []
        self._number = 0
        self.changed = False

    def add(self, t: float, axis: str, text: str, cause: Cause | None = None) -> None:
        """Keep an event; with a `cause` it is a fault."""
        cause_id = "" if cause is None else cause.id
        self._kept.append(Event(self._number, t, axis[:LONGEST_NAME], text[:LONGEST], cause is not None, cause_id))
        self._number += 1
        self.changed = True
        if len(self._kept) > MOST:
            self._kept.pop(1 if self.first_fault is self._kept[0] else 0)

    @property
    def first_fault(self) -> Event | None:
        return next((event for event in self._kept if event.fault), None)

    @property
    def faults(self) -> tuple[Event, ...]:
        return tuple(event for event in self._kept if event.fault)

    @property
    def all(self) -> tuple[Event, ...]:
        return tuple(self._kept)

    @property
    def next_number(self) -> int:
        """Return the number of the next event."""
        return self._number

    def since(self, number: int) -> tuple[Event, ...]:
        """Return the kept events from this number on."""
        return tuple(event for event in self._kept if event.number >= number)

    def encoded(self) -> bytes:
        """Return JSON of the first fault and of as many of the newest events as fit into the mailbox."""
        kept = list(self._kept)
        cause = self.first_fault
        spared = 0 if cause is None else 1
        while len(text := msgspec.json.encode(kept)) > TEXT and len(kept) > spared:
            kept.pop(1 if cause is not None and kept[0] is cause else 0)
        return text


TOLD = {
    LineState.READING: "values come",
    LineState.SILENT: "open, but no value that can be read comes",
    LineState.LOST: "cannot be opened, or was unplugged",
}


class AxisSensors:
    """Run one process per serial sensor, provide its values to the loop, and report its health as events.

    Create this before real-time scheduling is requested, so that the processes do not inherit it.
    """

    def __init__(self, axes: Sequence[AxisSettings]) -> None:
        self._place = tuple((axis.name, sensor) for axis in axes for sensor in axis.serial)
        self._sensors = SerialSensors([sensor for _, sensor in self._place])
        self._told: dict[int, LineState] = {}
        self._gone: set[int] = set()

    def sources(self, axis: str) -> dict[str, Callable[[float], float]]:
        """Return the function that reads each quantity of the axis `axis`, by the quantity's name."""
        return {
            sensor.quantity: self._sensors.reader(index)
            for index, (name, sensor) in enumerate(self._place)
            if name == axis
        }

    def check(self, t: float, events: Events) -> None:
        """Add an event for each sensor whose state has changed since the last check; call it about once a second."""
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
