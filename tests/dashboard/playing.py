"""A socket server with a thread in place of the loop, which takes commands, sets parameters and publishes values."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from tests.daemon.serving import QUARTERS, Serving
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.ipc.mailbox import AxisStatus, Command, General, Parameters, Reading
from tsa_ctrl.safety.causes import Cause

PERIOD = 0.01  # s


class Played:
    """A simulated daemon. `taken` lists the commands so far, in order."""

    def __init__(self, path: Path) -> None:
        self.serving = Serving(path, ["knee", "hip"])
        assert self.serving.ready, self.serving.greeting
        self.path = str(path)
        self.taken: list[Command] = []
        self.compensation = [0.95, 0.95]
        self.phase = LoopPhase.RUNNING
        self._done = threading.Event()
        self._start = time.monotonic()
        self._thread = threading.Thread(target=self._play)
        self._thread.start()

    def _play(self) -> None:
        cycles = 0
        while not self._done.wait(PERIOD):
            cycles += 1
            command = self.serving.mailbox.take()
            if command is not None:
                self.taken.append(command)
                if command.parameter == 0:
                    self.compensation[command.axis] = command.value
            now = time.monotonic()
            general = General(time=now, start=self._start, phase=float(self.phase.value), cycles=cycles)
            self.serving.mailbox.lateness[2] = cycles
            axes = [self._axis(index, now - self._start) for index in range(2)]
            self.serving.mailbox.publish(general, axes)
            readings = [Reading(*(getattr(axis, name, 0.0) for name in Reading._fields)) for axis, _ in axes]
            self.serving.mailbox.measure(now, cycles, self.phase.value, readings)

    def _axis(self, index: int, t: float) -> tuple[AxisStatus, Parameters]:
        wanted = math.sin(2.0 * t)
        axis = QUARTERS._replace(
            t=t,
            tau_j_des=wanted,
            tau_j=0.9 * wanted if index == 0 else math.nan,  # the hip has no sensor
            tau_j_model=math.nan,
            tau_m=t,
            tau_m_cmd=0.7 * wanted,
            q_j=0.25 * (1 + index),
            tau_j_stretch=0.88 * wanted,
            tau_j_stretch_low=0.88 * wanted - 0.1,
            tau_j_stretch_high=0.88 * wanted + 0.1,
        )
        return axis, (self.compensation[index], 45.0)

    def fail(self, text: str) -> None:
        """Latch a fault with this text."""
        self.phase = LoopPhase.FAULTED
        event = {"number": 0, "t": 1.25, "axis": "knee", "text": text, "fault": True, "cause_id": Cause.STALE_PDO.id}
        self.serving.mailbox.publish_text(msgspec.json.encode([event]))

    def end(self) -> None:
        self._done.set()
        self._thread.join()
        self.serving.end()


@contextlib.contextmanager
def played(path: Path) -> Iterator[Played]:
    made = Played(path)
    try:
        yield made
    finally:
        made.end()
