"""Simulated nodes for a bus without nodes: they answer each SYNC, and statusword and torque follow the commands.

`python -m tsa_ctrl.bench.responder` reads the bus settings and the axes' node ids as JSON on stdin. It prints `ready`,
and ends when its stdin closes.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import msgspec

from tsa_ctrl.bus.canopen import cia301, pdo
from tsa_ctrl.bus.canopen.cia402 import Controlword, Mode
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.bus.wire.bus import Bus, Frame
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.errors import BusError
from tsa_ctrl.system.process_supervisor import READY, Child

PRIORITY = 70  # below the loop, above all other processes
BEAT = 0.02  # s between heartbeats, which are sent at the next SYNC
LOOK = 0.2  # s between checks for a stop request
START = 20.0  # s for the process to start or end
DISABLED = 0x1250  # statusword: switch on disabled
STATUSWORDS = {Controlword.SHUTDOWN: 0x1231, Controlword.SWITCH_ON: 0x1233, Controlword.ENABLE_OPERATION: 0x1237}


_POSITIONS = tuple(pdo.POSITION.struct.pack(count, Mode.CYCLIC_SYNC_TORQUE, 0) for count in (0, 1))


class Ids(msgspec.Struct, frozen=True):
    """Node ids of one axis."""

    drive: int
    encoder: int | None
    torque_sensor: int | None


class Task(msgspec.Struct, frozen=True):
    """Settings of the process, received on stdin."""

    bus: BusSettings
    axes: tuple[Ids, ...]


def ids_of(axes: Sequence[AxisNodes]) -> tuple[Ids, ...]:
    """Return the node ids of each axis."""
    return tuple(
        Ids(
            axis.drive.node_id,
            None if axis.encoder is None else axis.encoder.node_id,
            None if axis.torque_sensor is None else axis.torque_sensor.node_id,
        )
        for axis in axes
    )


class Responder:
    """Nodes of axes at rest. Their positions change by one count, because a constant position counts as frozen."""

    def __init__(self, bus: Bus, axes: Sequence[Ids]) -> None:
        self._bus = bus
        self._syncs = 0
        self._beat = 0.0
        self._status = {0x200 + axis.drive: 0x180 + axis.drive for axis in axes}
        self._answers: dict[int, bytes] = {}
        self._positions = [0x280 + axis.drive for axis in axes]
        self._beats: list[Frame] = []
        for axis in axes:
            self._answers[0x180 + axis.drive] = pdo.MOTION.struct.pack(DISABLED, 0, 0)
            self._answers[0x280 + axis.drive] = _POSITIONS[0]
            if axis.encoder is not None:
                self._answers[0x180 + axis.encoder] = struct.pack("<I", 0)
            if axis.torque_sensor is not None:
                self._answers[0x180 + axis.torque_sensor] = struct.pack("<i", 0)
            nodes = (axis.drive, axis.encoder, axis.torque_sensor)
            self._beats += [(cia301.HEARTBEAT + node, b"\x05") for node in nodes if node is not None]
        bus.accept([cia301.SYNC, *self._status])

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
        answer = self._status.get(can_id)
        if answer is not None and len(data) == pdo.COMMAND.length:
            controlword, torque = pdo.COMMAND.struct.unpack(data)
            self._answers[answer] = pdo.MOTION.struct.pack(STATUSWORDS.get(controlword, DISABLED), torque, 0)
        elif can_id == cia301.SYNC:
            for identifier, content in self._answers.items():
                self._bus.send(identifier, content)
            now = time.monotonic()
            if now >= self._beat:
                self._beat = now + BEAT
                for identifier, content in self._beats:
                    self._bus.send(identifier, content)
            self._syncs += 1
            for identifier in self._positions:
                self._answers[identifier] = _POSITIONS[self._syncs % 2]


@contextlib.contextmanager
def standing_in(settings: BusSettings, axes: Sequence[AxisNodes]) -> Iterator[None]:
    """Run simulated nodes in a separate process during the block.

    The python-can interface "virtual" exists within one process only, so a thread is used there.

    Raises:
        BusError: the process does not start.
    """
    if settings.interface == "virtual":
        with _in_a_thread(settings, axes):
            yield
        return
    process = Child("tsa_ctrl.bench.responder")
    assert process.stdout is not None
    try:
        process.send(msgspec.json.encode(Task(settings, ids_of(axes))))
        readable, _, _ = select.select([process.stdout], [], [], START)
        if not readable or process.failure():
            raise BusError(
                "bench: the process that simulates the nodes did not start; reduce the load of this machine and repeat"
            )
        yield
    finally:
        process.end(START)


@contextlib.contextmanager
def _in_a_thread(settings: BusSettings, axes: Sequence[AxisNodes]) -> Iterator[None]:
    bus = open_bus(settings)
    done = threading.Event()
    responder = Responder(bus, ids_of(axes))
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
