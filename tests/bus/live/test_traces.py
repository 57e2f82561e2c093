"""Replay bus traces in candump and ASC format through the cyclic communication, one trace for each defect.

`T` marks the frames of the controller. They are skipped, because the rig under test sends its own frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest

from tests.bus.fake import FakeBus, FakeClock
from tests.bus.nodes import axis_nodes, cycle
from tsa_ctrl.bus.canopen.cia301 import NmtState
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.image import Image
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import Frame

STATE, POSITION = "181#37160A0000000000", "281#000000000A0000"
ENCODER, TORQUE = "1A0#10000000", "1C0#E8030000"
HEALTHY = (STATE, POSITION, ENCODER, TORQUE)
COMMAND = "201#0F000A00"
SYNC = "080#"


def candump(*cycles: tuple[str, ...]) -> str:
    """Return a trace in the format of `candump -L -x` with one cycle per millisecond."""
    lines = []
    for number, frames in enumerate(cycles):
        start = 1.7e9 + 1e-3 * number
        own = [(start, SYNC, "T"), (start + 5e-4, COMMAND, "T")]
        others = [(start + 1e-4 * (k + 1), frame, "R") for k, frame in enumerate(frames)]
        lines += [f"({t:.6f}) can0 {frame} {way}" for t, frame, way in sorted(own + others)]
    return "\n".join(lines) + "\n"


def replayed(path: Path) -> Image:
    """Return the image after a rig of one axis has received the trace."""
    cycles: list[list[Frame]] = []
    for message in can.LogReader(path):
        if message.arbitration_id == 0x080 and not message.is_rx:
            cycles.append([])
        elif message.is_rx:
            cycles[-1].append((message.arbitration_id, bytes(message.data)))
    frames: Iterator[list[Frame]] = iter(cycles)
    clock = FakeClock()
    bus = FakeBus(clock, lambda sent: next(frames) if sent[0] == 0x080 else [])
    rig = Rig(bus, BusSettings(), [axis_nodes()], [DriveProfile()], clock)
    rig.start()
    for _ in cycles:
        cycle(rig, bus)
        rig.wait(clock.now)  # reads the frames after the answers
    return rig.axes[0].image


CASES: dict[str, tuple[tuple[tuple[str, ...], ...], Callable[[Image], bool]]] = {
    "healthy": (
        (HEALTHY,) * 3,
        lambda image: (
            image.fresh
            and not (image.missed or image.repeated or image.malformed or image.events)
            and image.intruder is None
        ),
    ),
    "the drive does not answer": (
        (HEALTHY, HEALTHY, (ENCODER, TORQUE)),
        lambda image: not image.fresh and image.misses == 1 and image.joint_fresh,
    ),
    "a PDO comes twice": ((HEALTHY, (*HEALTHY, STATE)), lambda image: image.repeated == 1),
    "a PDO is too short": ((HEALTHY, ("181#3716", POSITION, ENCODER, TORQUE)), lambda image: image.malformed == 1),
    "the drive faults": (
        (HEALTHY, ("081#1023040000000000", "181#18020A0000000000", POSITION, ENCODER, TORQUE)),
        lambda image: image.emcy is not None and image.emcy.code == 0x2310 and image.statusword == 0x0218,
    ),
    "a node boots anew": ((HEALTHY, (*HEALTHY, "720#00")), lambda image: image.nodes[1].boot_ups == 1),
    "a node leaves operational": (
        (HEALTHY, (*HEALTHY, "701#7F")),
        lambda image: image.nodes[0].nmt_state == NmtState.PRE_OPERATIONAL,
    ),
    "a second master commands": ((HEALTHY, (*HEALTHY, COMMAND)), lambda image: image.intruder == 0x201),
}


@pytest.mark.parametrize("name", CASES)
def test_a_trace_shows_its_defect(tmp_path: Path, name: str) -> None:
    cycles, shown = CASES[name]
    path = tmp_path / "trace.log"
    path.write_text(candump(*cycles))
    assert shown(replayed(path))
    assert (name == "healthy") is CASES["healthy"][1](replayed(path))


def test_the_same_trace_in_asc_gives_the_same_values(tmp_path: Path) -> None:
    (tmp_path / "trace.log").write_text(candump(HEALTHY, HEALTHY))
    with can.LogReader(tmp_path / "trace.log") as reader, can.Logger(tmp_path / "trace.asc") as writer:
        for message in reader:
            message.channel = 1
            writer.on_message_received(message)
    first, second = (replayed(tmp_path / name) for name in ("trace.log", "trace.asc"))
    assert first.tau_j == second.tau_j == pytest.approx(1e-3)
    assert (first.tau_m, first.q_j, first.statusword) == (second.tau_m, second.q_j, 0x1637)
