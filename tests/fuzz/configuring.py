"""Bring-up over a bus that corrupts frames succeeds or raises a one-line error, and never commands torque."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from tests.bus.nodes import axis_nodes
from tests.drives.rig import running
from tests.fuzz.frames import any_frame, spoil
from tests.fuzz.part import Holdings, Part
from tests.plant.bench import plant_file
from tsa_ctrl.bus.drive import bring_up as module
from tsa_ctrl.bus.drive import checks, session
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import Bus, Frame
from tsa_ctrl.bus.wire.python_can import PythonCan
from tsa_ctrl.errors import TsaError

PLANT = "[[axis]]\nname = 'joint'\nmotion.kind = 'still'\n"
QUICK = (  # time-outs (s), short because the simulated nodes answer at once
    (session, "_LISTENING", 0.01),
    (module, "START_TIMEOUT", 0.3),
    (checks, "BOOT_TIMEOUT", 0.3),
    (checks, "ANSWER_TIMEOUT", 0.05),
    (checks, "_MODE_TIMEOUT", 0.1),
    (checks, "_OFF_TIMEOUT", 0.1),
)


PATIENCE = DriveProfile(boot_timeout=0.3, answer_timeout=0.05)


class SpoiledBus:
    """A `Bus` that corrupts some received frames and fails to send some frames. Other attributes are those of `bus`."""

    def __init__(self, bus: Bus, draw: random.Random, rate: float, part: Part) -> None:
        self.sent: list[Frame] = []
        self._bus = bus
        self._draw = draw
        self._rate = rate
        self._part = part
        self._waiting: list[Frame] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    def send(self, can_id: int, data: bytes) -> bool:
        self.sent.append((can_id, data))
        if self._draw.random() < 0.2 * self._rate:
            return False
        return self._bus.send(can_id, data)

    def recv(self, timeout: float) -> Frame | None:
        if self._waiting:
            return self._waiting.pop()
        frame = self._bus.recv(timeout)
        if frame is None:
            return None
        self._part.inputs += 1
        draw = self._draw
        if draw.random() < self._rate:
            self._waiting = spoil(frame, draw)
            if draw.random() < 0.3:
                self._waiting.append(any_frame(draw))
            return self.recv(0.0)
        return frame

    def flush(self) -> int:
        self._waiting = []
        return self._bus.flush()


@contextmanager
def quick() -> Iterator[None]:
    """Shorten the time-outs within the block."""
    kept = [(where, name, getattr(where, name)) for where, name, _ in QUICK]
    for where, name, value in QUICK:
        setattr(where, name, value)
    try:
        yield
    finally:
        for where, name, value in kept:
            setattr(where, name, value)


def run(attempts: int, seed: int) -> Part:
    """Try to bring one axis up this many times, with 0 to 20 % of the received frames corrupted."""
    part = Part("bring-up")
    with quick(), part.quiet_threads(), TemporaryDirectory() as folder:
        plant = plant_file(Path(folder), PLANT)
        for number in range(attempts):
            draw = random.Random(seed * 1_000_000 + number)
            _attempt(plant, draw, part, number)
            if number <= attempts // 4:
                part.before = Holdings.of()
    part.after = Holdings.of()
    return part


def _attempt(plant: Path, draw: random.Random, part: Part, number: int) -> None:
    with running(plant) as (channel, _), closing(PythonCan("virtual", channel, 1_000_000)) as ours:
        bus = SpoiledBus(ours, draw, draw.choice((0.0, 0.003, 0.02, 0.2)), part)
        with part.surviving(f"attempt {number}"):
            try:
                module.bring_up(cast(Bus, bus), BusSettings(interface="virtual"), [axis_nodes()], [PATIENCE], 0.001)
                part.counts["succeeded"] += 1
            except TsaError as error:
                part.counts["refused"] += 1
                if "\n" in str(error):
                    part.blame(f"attempt {number}: more than one line: {error}")
    _check(bus.sent, part, number)


def _check(sent: list[Frame], part: Part, number: int) -> None:
    """Report RPDOs, controlwords other than 0 and target torques other than 0 as problems."""
    for can_id, data in sent:
        if 0x200 < can_id < 0x280:
            part.blame(f"attempt {number}: an RPDO was sent")
        if can_id == 0x601 and data[0] & 0xE0 == 0x20:
            index, sub, value = struct.unpack_from("<HBI", data, 1)
            if (index, sub) in ((0x6040, 0), (0x6071, 0)) and value != 0:
                part.blame(f"attempt {number}: 0x{index:04X} = {value} was written")
