"""Simulated nodes under random frames and SDO requests.

Their answers are valid, a disabled drive delivers no torque, and a reset restores every node.
"""

from __future__ import annotations

import random
import struct
import tempfile
from pathlib import Path

from tests.fuzz.frames import NODES, any_frame, sdo_request
from tests.fuzz.part import Holdings, Part
from tests.plant.bench import Bench
from tsa_ctrl.bus.wire.bus import Frame

BATCH = 2000  # frames between two resets
DEVICE_TYPES = {1: 0x0192, 32: 0x0196, 64: 0x0194}  # low words of 0x1000
NMT = (0x01, 0x02, 0x80, 0x81, 0x82, 0x00, 0xFF)


def run(frames: int, seed: int) -> Part:
    """Send this many frames in batches. A reset must restore the nodes after each batch."""
    part = Part("plant")
    draw = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        bench.wait(1e-3)
        objects = {node.node_id: tuple(node.dictionary.entries) for node in bench.unit.nodes}
        while part.inputs < frames:
            _batch(bench, draw, objects, part)
            _come_back(bench, part)
            if part.inputs <= max(BATCH, frames // 4):
                part.before = Holdings.of()
    part.after = Holdings.of()
    return part


def _batch(bench: Bench, draw: random.Random, objects: dict[int, tuple[tuple[int, int], ...]], part: Part) -> None:
    if draw.random() < 0.5:
        bench.set_up(draw.choice((1, 255)))
        bench.enable(draw.randrange(-1000, 1000))
    for _ in range(BATCH):
        part.inputs += 1
        frame = _frame(draw, objects)
        with part.surviving(f"frame 0x{frame[0]:X} {frame[1].hex()}"):
            answers = bench.send(*frame)
            _check(bench, answers, part)
        if draw.random() < 0.02:
            bench.clock.now += draw.choice((1e-4, 1e-3, 1e-3, 0.02))
            with part.surviving("tick"):
                bench.machine.tick(bench.clock.now)
        if len(bench.bus.sent) > 10_000:
            bench.bus.sent.clear()


def _frame(draw: random.Random, objects: dict[int, tuple[tuple[int, int], ...]]) -> Frame:
    kind = draw.random()
    if kind < 0.5:
        node = draw.choice(NODES)
        return 0x600 + node, sdo_request(draw, objects[node])
    if kind < 0.6:
        return 0x201, struct.pack(
            "<Hh", draw.choice((0x00, 0x06, 0x07, 0x0F, 0x80)), draw.randrange(-(1 << 15), 1 << 15)
        )
    if kind < 0.65:
        return 0x080, b""
    if kind < 0.67:
        return 0x000, bytes((draw.choice(NMT), draw.choice((0, *NODES, 5))))
    return any_frame(draw)


def _check(bench: Bench, answers: list[Frame], part: Part) -> None:
    """Check that answers are valid frames, and that there is torque only in OPERATION_ENABLED."""
    for can_id, data in answers:
        if not (0 <= can_id < 0x800 and len(data) <= 8):
            part.blame(f"sent 0x{can_id:X} with {len(data)} bytes")
        if 0x580 < can_id < 0x600 and len(data) != 8:
            part.blame(f"SDO answer of {len(data)} bytes")
    part.counts["answers"] += len(answers)
    drive = bench.unit.drive
    if drive.command.torque:
        part.counts["frames with torque"] += 1
        if drive.machine.state.name != "OPERATION_ENABLED":
            part.blame(f"torque {drive.command.torque} N*m in {drive.machine.state.name}")


def _come_back(bench: Bench, part: Part) -> None:
    """Reset the nodes. Each must report its device type again, and the drive must be disabled."""
    with part.surviving("reset"):
        bench.send(0x000, b"\x81\x00")
        for node, low_word in DEVICE_TYPES.items():
            found = bench.upload(node, 0x1000, 0, "I")
            if found & 0xFFFF != low_word:
                part.blame(f"node {node}: device type 0x{found:08X} after a reset")
        if bench.unit.drive.command.enabled:
            part.blame("the drive is enabled after a reset")
        part.counts["resets"] += 1
