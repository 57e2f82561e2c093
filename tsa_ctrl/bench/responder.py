"""Simulated nodes for a bus without nodes: they answer each SYNC, and statusword and torque follow the commands.

`python -m tsa_ctrl.bench.responder` reads the bus settings and the frames of the axes as JSON on stdin. It prints
`ready`, and ends when its stdin closes.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

import msgspec

from tsa_ctrl.bus.canopen import cia301, objects, pdo
from tsa_ctrl.bus.canopen.cia301 import NmtState
from tsa_ctrl.bus.canopen.cia402 import Controlword, Mode
from tsa_ctrl.bus.drive.network import layout_of, torque_sensor_pdo
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.bus.wire.bus import Bus
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.errors import BusError
from tsa_ctrl.system.process_supervisor import READY, Child

PRIORITY = 70  # below the loop, above all other processes
BEAT = 0.02  # s between heartbeats, which are sent at the next SYNC
LOOK = 0.2  # s between checks for a stop request
START = 20.0  # s for the process to start or end
DISABLED = 0x1250  # statusword: switch on disabled
STATUSWORDS = {Controlword.SHUTDOWN: 0x1231, Controlword.SWITCH_ON: 0x1233, Controlword.ENABLE_OPERATION: 0x1237}


class SentPdo(msgspec.Struct, frozen=True):
    """One TPDO: its identifier, the names of its objects, their struct format, and its number of SYNCs."""

    can_id: int
    objects: tuple[str, ...]
    format: str
    every: int


class AxisFrames(msgspec.Struct, frozen=True):
    """The frames of one axis: the identifier of its commands, its TPDOs, and the ids of its nodes."""

    command: int
    answers: tuple[SentPdo, ...]
    nodes: tuple[int, ...]


class Task(msgspec.Struct, frozen=True):
    """Settings of the process, received on stdin."""

    bus: BusSettings
    axes: tuple[AxisFrames, ...]


def frames_of(axes: Sequence[AxisNodes], profiles: Sequence[DriveProfile]) -> tuple[AxisFrames, ...]:
    """Return the frames of each axis, from the tables that the loop uses."""
    found = []
    for axis, profile in zip(axes, profiles, strict=True):
        layout = layout_of(axis.drive, profile)
        sent = dict(zip(layout.tpdo_ids, (layout.motion, layout.position), strict=True))
        if axis.encoder is not None:
            sent[pdo.ENCODER.cob_id(axis.encoder.node_id)] = pdo.ENCODER
        if axis.torque_sensor is not None:
            sent[pdo.TORQUE_SENSOR.cob_id(axis.torque_sensor.node_id)] = torque_sensor_pdo(axis.torque_sensor)
        answers = tuple(
            SentPdo(can_id, tuple(entry.name for entry in table.objects), table.struct.format, table.every)
            for can_id, table in sent.items()
        )
        found.append(AxisFrames(layout.rpdo_id, answers, tuple(node.node_id for _, node in axis.nodes())))
    return tuple(found)


class Responder:
    """Nodes of axes at rest. Their positions change by one count, because a constant position counts as frozen."""

    def __init__(self, bus: Bus, axes: Sequence[AxisFrames]) -> None:
        self._bus = bus
        self._syncs = 0
        self._beat = 0.0
        self._toggle = 0  # bit that changes in each answer to node guarding
        self._axes = {axis.command: axis for axis in axes}
        self._nodes = sorted({node for axis in axes for node in axis.nodes})
        self._values = {
            axis.command: {objects.STATUSWORD.name: DISABLED, objects.MODE_DISPLAY.name: int(Mode.CYCLIC_SYNC_TORQUE)}
            for axis in axes
        }
        self._every = {answer.can_id: answer.every for axis in axes for answer in axis.answers}
        self._frames: dict[int, bytes] = {}
        for axis in axes:
            for answer in axis.answers:
                self._pack(axis, answer)
        bus.accept([cia301.SYNC, *self._axes])

    def _pack(self, axis: AxisFrames, answer: SentPdo) -> None:
        values = self._values[axis.command]
        self._frames[answer.can_id] = struct.pack(answer.format, *(values.get(name, 0) for name in answer.objects))

    def _set(self, axis: AxisFrames, values: Mapping[str, int]) -> None:
        """Change values of an axis in its next answers."""
        self._values[axis.command].update(values)
        for answer in axis.answers:
            if not values.keys().isdisjoint(answer.objects):
                self._pack(axis, answer)

    def run(self, stop: Callable[[], bool]) -> None:
        """Answer frames until `stop` returns True."""
        due = time.monotonic() + LOOK
        while True:
            frame = self._bus.recv(LOOK)
            if frame is None or time.monotonic() > due:
                if stop():
                    return
                due = time.monotonic() + LOOK
            if frame is not None:
                self._take(*frame)

    def _take(self, can_id: int, data: bytes) -> None:
        axis = self._axes.get(can_id)
        if axis is not None and len(data) == pdo.COMMAND.length:
            controlword, torque = pdo.COMMAND.struct.unpack(data)
            status = STATUSWORDS.get(controlword, DISABLED)
            self._set(axis, {objects.STATUSWORD.name: status, objects.TORQUE_ACTUAL.name: torque})
        elif can_id == cia301.SYNC:
            self._syncs += 1
            for identifier, content in self._frames.items():
                if self._syncs % self._every[identifier] == 0:
                    self._bus.send(identifier, content)
            now = time.monotonic()
            if now >= self._beat:
                self._beat = now + BEAT
                self._toggle ^= cia301.TOGGLE
                state = bytes((NmtState.OPERATIONAL | self._toggle,))
                for node in self._nodes:
                    self._bus.send(cia301.HEARTBEAT + node, state)
            for axis in self._axes.values():
                self._set(axis, {objects.POSITION_ACTUAL.name: self._syncs % 2})


@contextlib.contextmanager
def standing_in(settings: BusSettings, axes: Sequence[AxisNodes], profiles: Sequence[DriveProfile]) -> Iterator[None]:
    """Run simulated nodes in a separate process during the block.

    The python-can interface "virtual" exists within one process only, so a thread is used there.

    Raises:
        BusError: the process does not start.
    """
    frames = frames_of(axes, profiles)
    if settings.interface == "virtual":
        with _in_a_thread(settings, frames):
            yield
        return
    process = Child("tsa_ctrl.bench.responder")
    assert process.stdout is not None
    try:
        process.send(msgspec.json.encode(Task(settings, frames)))
        readable, _, _ = select.select([process.stdout], [], [], START)
        if not readable or process.failure():
            raise BusError(
                "bench: the process that simulates the nodes did not start; reduce the load of this machine and repeat"
            )
        yield
    finally:
        process.end(START)


@contextlib.contextmanager
def _in_a_thread(settings: BusSettings, axes: Sequence[AxisFrames]) -> Iterator[None]:
    bus = open_bus(settings)
    done = threading.Event()
    responder = Responder(bus, axes)
    thread = threading.Thread(target=responder.run, args=(done.is_set,), name="stand-in nodes")
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        bus.close()


def main() -> int:
    """Read the task from stdin, and answer frames until the parent closes stdin."""
    task = msgspec.json.decode(sys.stdin.buffer.readline(), type=Task)
    bus = open_bus(task.bus)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    os.write(sys.stdout.fileno(), READY)
    Responder(bus, task.axes).run(lambda: bool(select.select([sys.stdin], [], [], 0.0)[0]))
    bus.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
