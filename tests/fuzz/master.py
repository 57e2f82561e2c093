"""Run the daemon's loop on a bus with random frames. A judge checks the torque from the frames alone.

The judge implements the rules a second time, independently. Torque is permitted only under these conditions:

- The last answer of the drive reports that it is enabled, follows the command and is in mode 10.
- No more answers are missing than tolerated, and every heartbeat is present.
- There was no emergency, boot-up, other master or bus-off since the last recovery.
"""

from __future__ import annotations

import contextlib
import math
import random
import struct
import tempfile
from collections.abc import Iterable
from pathlib import Path

from tests.daemon.machine import CONSTANT, Drive, Machine
from tests.fuzz.frames import STATUSWORDS, any_frame, spoil
from tests.fuzz.part import Holdings, Part
from tsa_ctrl.bus.wire.bus import Frame
from tsa_ctrl.ipc.mailbox import RECOVER, Command

CYCLES = 700  # length of an episode
AFTERWARDS = 60  # cycles of the episode after the first fault
TOLERATED = 2  # cycles without all answers; the default of the configuration
HEARTBEAT = 0.2 + 1e-3  # s; the default plus one period
LENGTHS = {0x181: 8, 0x281: 7, 0x1A0: 4}  # answers that each cycle requires, with their lengths in bytes
FOLLOWING = 0x1000


class OverError(Exception):
    """The episode has ended."""


class Judge:
    """Read the frames on the bus and determine the reason why torque is not permitted now."""

    def __init__(self) -> None:
        self.statusword = self.mode = 0
        self.missing = 0
        self.reason = ""
        self._later = ""
        self._heard = dict.fromkeys((1, 32, 64), math.inf)

    def cycle(self, frames: list[Frame], now: float) -> None:
        """Evaluate one SYNC and the frames after it. An event forbids torque from the next cycle on."""
        self.reason = self.reason or self._later
        expected = dict(LENGTHS)
        for can_id, data in frames:
            if expected.get(can_id) == len(data):
                del expected[can_id]
                if can_id == 0x181:
                    (self.statusword,) = struct.unpack_from("<H", data)
                elif can_id == 0x281:
                    self.mode = data[4] - 256 if data[4] > 127 else data[4]
            self._later = self._later or self._event(can_id, data, now)
        self.missing = self.missing + 1 if expected else 0

    def _event(self, can_id: int, data: bytes, now: float) -> str:
        node = can_id & 0x7F
        if can_id - node == 0x080 and node in self._heard and len(data) == 8 and data[:2] != b"\0\0":
            return "an emergency"
        if can_id - node == 0x700 and node in self._heard and len(data) == 1:
            self._heard[node] = now
            return "" if data[0] & 0x7F == 5 else "a node left operational"
        if can_id in (0x000, 0x080, 0x201, 0x77F):
            return "another master"
        return "bus-off" if can_id >> 28 == 2 and can_id & 0x040 else ""

    def forbids(self, now: float) -> str:
        """Return the reason why the torque must be 0, or an empty string."""
        if self.statusword & 0x6F != 0x27 or not self.statusword & FOLLOWING:
            return f"statusword 0x{self.statusword:04X}"
        if self.mode != 10:
            return f"mode {self.mode}"
        if self.missing > TOLERATED:
            return f"{self.missing} cycles without all answers"
        silent = [node for node, heard in self._heard.items() if now - heard > HEARTBEAT and heard < math.inf]
        return self.reason or (f"no heartbeat of {silent}" if silent else "")

    def forgive(self) -> None:
        """Clear the events, because a recovery was requested."""
        self.reason = self._later = ""


class Hostile(Drive):
    """A working drive on a bus that corrupts its frames and adds others.

    The judge checks each command.
    """

    def __init__(self, seed: int, part: Part) -> None:
        super().__init__()
        self.judge = Judge()
        self.machine: Machine | None = None
        self._part = part
        self._seed = seed
        self._draw = random.Random(seed)
        self._from = self._draw.randrange(20, 400)
        self._rate = 10.0 ** self._draw.uniform(-3.5, -0.5)  # probability of a corrupted or an added frame
        self._kinds = self._draw.choice(("spoil", "add", "lie", "all"))
        self._end = CYCLES
        self._recover = self._draw.random() < 0.4

    def __call__(self, frame: Frame) -> Iterable[Frame]:
        can_id, data = frame
        if can_id == 0x201:
            self._show(*struct.unpack("<Hh", data))
        answers = list(super().__call__(frame))
        if can_id != 0x080 or self.machine is None:
            return answers
        if self.beats >= self._end:
            raise OverError
        if self.beats >= self._from:
            answers = self._mistreat(answers)
        self._part.inputs += len(answers)
        self.judge.cycle(answers, self.machine.bus.clock.now)
        self._recover_once()
        return answers

    def _mistreat(self, answers: list[Frame]) -> list[Frame]:
        draw, rate, kinds = self._draw, self._rate, self._kinds
        found: list[Frame] = []
        for frame in answers:
            wrong = kinds in ("spoil", "all") and draw.random() < rate
            found += spoil(frame, draw) if wrong else [frame]
        if kinds in ("add", "all"):
            while draw.random() < rate:
                found.insert(draw.randrange(len(found) + 1), any_frame(draw))
        if kinds in ("lie", "all") and draw.random() < rate:
            self.statusword = draw.choice((*STATUSWORDS, draw.randrange(1 << 16)))
        if kinds == "lie" and draw.random() < rate:
            self.mode = draw.choice((10, 10, 10, 8, 0, -1))
        if kinds in ("lie", "all") and draw.random() < rate:
            self.count += draw.choice((1, 1000, 1 << 19, 1 << 31))
            self.velocity = draw.choice((0, 100_000, -(1 << 31), (1 << 31) - 1))
        return found

    def _recover_once(self) -> None:
        """After the first fault, either end the episode soon or schedule one recovery request."""
        assert self.machine is not None
        if not self.machine.events.faults or self._end < CYCLES:
            return
        self._part.counts["faults"] += 1
        self._end = min(CYCLES - 1, self.beats + AFTERWARDS)
        if self._recover:
            self._end = CYCLES - 1
            self.at_sync[self.beats + AFTERWARDS // 2] = self._ask_for_recovery

    def _ask_for_recovery(self) -> None:
        assert self.machine is not None
        self.machine.mailbox.put(Command(0, RECOVER, 0.0))
        self.judge.forgive()

    def _show(self, controlword: int, target: int) -> None:
        assert self.machine is not None
        reason = self.judge.forbids(self.machine.bus.clock.now)
        if target:
            self._part.counts["cycles with torque"] += 1
        if target and reason:
            self._part.blame(f"seed {self._seed}, cycle {self.beats}: torque {target} per mille, but {reason}")
        if controlword == 0x0F and self.judge.reason:
            self._part.blame(f"seed {self._seed}, cycle {self.beats}: enabled, but {self.judge.reason}")
        if abs(target) > 2000:  # [axis.limits] torque is 2 N*m, the rated torque is 1 N*m
            self._part.blame(f"seed {self._seed}, cycle {self.beats}: torque {target} per mille is above the limit")


def run(frames: int, seed: int) -> Part:
    """Run episodes until this many frames were received."""
    part = Part("loop")
    episode = 0
    with tempfile.TemporaryDirectory() as folder:
        while part.inputs < frames:
            _episode(Path(folder), seed * 1_000_000 + episode, part)
            episode += 1
            if part.inputs < frames // 4 or episode == 1:
                part.before = Holdings.of()
    part.counts["episodes"] = episode
    part.after = Holdings.of()
    return part


def _episode(folder: Path, seed: int, part: Part) -> None:
    drive = Hostile(seed, part)
    machine = Machine(folder, CONSTANT, drive=drive)
    drive.machine = machine
    try:
        with part.surviving(f"seed {seed}"), contextlib.suppress(OverError):
            machine.run()
            part.counts["loops that ended by themselves"] += 1
    finally:
        machine.close()
