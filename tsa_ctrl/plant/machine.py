"""The simulated machine: axes and their nodes on one bus, in real time, in one thread.

Time is CLOCK_MONOTONIC. The mechanics are brought up to now at every SYNC before the sensors are read, and by a timer
when there is none. Housekeeping is done right after a SYNC was answered, never before the next one.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from dataclasses import dataclass

from tsa_ctrl.bus.seam import ERROR_FLAG, Bus, BusFault
from tsa_ctrl.errors import BusError
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.drive import Drive
from tsa_ctrl.plant.node import Node, Send
from tsa_ctrl.plant.record import Recorder
from tsa_ctrl.plant.sensors import Encoder, TorqueSensor
from tsa_ctrl.plant.settings import AxisSettings, PlantSettings

SYNC = 0x080
TICK = 1e-3  # s between two looks at the timers
_AFTER_SYNC = 1.5e-3  # s: with a SYNC every millisecond the timer never comes before it
_LONGEST_GAP = 0.25  # s that the mechanics make up for; more is time in which this machine stood still


@dataclass
class AxisNodes:
    """One axis and its nodes."""

    axis: Axis
    drive: Drive
    encoder: Encoder | None
    torque_sensor: TorqueSensor | None

    @property
    def nodes(self) -> tuple[Node, ...]:
        return tuple(node for node in (self.drive, self.encoder, self.torque_sensor) if node is not None)


@dataclass
class Counts:
    """What happened while running."""

    syncs: int = 0
    frames: int = 0
    skipped: float = 0.0  # s of real time that the mechanics did not follow


def build_axis(settings: AxisSettings, plant: PlantSettings, send: Send, place: int) -> AxisNodes:
    """Axis and nodes, not yet booted; each with noise of its own from the plant's seed."""
    axis = Axis(settings, plant.physics)

    def noise(number: int) -> random.Random:
        return random.Random(plant.physics.seed * 1000 + place * 10 + number)

    drive = Drive(settings.drive, axis.readings, axis.command, noise(0), send)
    encoder = Encoder(settings.encoder, axis.readings, send) if settings.encoder.present else None
    sensor = None
    if settings.torque_sensor.present:
        sensor = TorqueSensor(settings.torque_sensor, axis.readings, noise(1), send)
    return AxisNodes(axis, drive, encoder, sensor)


class Machine:
    """All axes on `bus`. `run` until `stop` says so."""

    def __init__(self, plant: PlantSettings, bus: Bus, clock: Callable[[], float] = time.monotonic) -> None:
        self.plant = plant
        self.bus = bus
        self.clock = clock
        self.counts = Counts()
        self.axes = [build_axis(axis, plant, bus.send, place) for place, axis in enumerate(plant.axis)]
        self.recorder: Recorder | None = None
        self._epoch = clock()
        self._routes: dict[int, tuple[Node, ...]] = {}
        self._next_tick = self._epoch
        for unit in self.axes:
            unit.axis.advance(1e-9)  # compiles, or loads what was compiled before
            unit.drive.before_change = self._bring_up(unit.axis)
            for node in unit.nodes:
                node.reroute = self._reroute
        self._reroute()

    def start(self) -> None:
        """Power on: every node boots."""
        self._epoch = self.clock()
        self._next_tick = self._epoch
        for unit in self.axes:
            for node in unit.nodes:
                node.boot(self._epoch)

    def run(self, stop: Callable[[], bool]) -> None:
        """Answer the bus and let time pass; raises BusError when the interface is gone."""
        while not stop():
            frame = self.bus.recv(max(0.0, self._next_tick - self.clock()))
            now = self.clock()
            if frame is not None:
                self.handle(*frame, now)
            elif self.bus.fault is not None:
                self._bus_fault(self.bus.fault)
            if now >= self._next_tick:
                self.tick(now)

    def handle(self, can_id: int, data: bytes, now: float) -> None:
        """One frame from the bus."""
        self.counts.frames += 1
        if can_id & ERROR_FLAG:
            return
        if can_id == SYNC:
            self.counts.syncs += 1
            self.advance(now)
        for node in self._routes.get(can_id, ()):
            node.receive(can_id, data, now)
        if can_id == SYNC:
            self.tick(now)
            self._next_tick = now + _AFTER_SYNC

    def tick(self, now: float) -> None:
        """Mechanics up to now, timers of the nodes, record."""
        self._next_tick = now + TICK
        self.advance(now)
        for unit in self.axes:
            for node in unit.nodes:
                node.tick(now)
        self._record(now)

    def advance(self, now: float) -> None:
        behind = now - self._epoch - self.axes[0].axis.time
        if behind > _LONGEST_GAP:
            self.counts.skipped += behind
            self._epoch += behind
        for unit in self.axes:
            unit.axis.advance(now - self._epoch)

    def _bring_up(self, axis: Axis) -> Callable[[float], None]:
        return lambda now: axis.advance(min(now - self._epoch, axis.time + _LONGEST_GAP))

    def _reroute(self) -> None:
        routes: dict[int, list[Node]] = {}
        for unit in self.axes:
            for node in unit.nodes:
                for can_id in node.routes:
                    routes.setdefault(can_id, []).append(node)
        self._routes = {can_id: tuple(nodes) for can_id, nodes in routes.items()}

    def _record(self, now: float) -> None:
        recorder = self.recorder
        if recorder is None or not recorder.due(self.axes[0].axis.time):
            return
        for place, unit in enumerate(self.axes):
            recorder.row((now, unit.axis.time, place, unit.drive.machine.state.value, *unit.axis.truth()))
        recorder.flush(now)

    def _bus_fault(self, fault: BusFault) -> None:
        if fault is BusFault.INTERFACE_GONE:
            raise BusError(f"bus {self.bus.name}: {fault.value}; make the interface again and start the plant again")
        time.sleep(TICK)
        self.bus.clear_fault()
