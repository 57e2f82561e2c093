"""Test lean drives: PDOs at every 50th SYNC, and repeated, late or missing PDOs. Frames are literal bytes."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable

import pytest
from msgspec.structs import replace

from tests.bus.fake import FakeBus, FakeClock
from tests.bus.nodes import axis_nodes, cycle
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.rig import Rig, check_startup
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import Frame
from tsa_ctrl.errors import BusError

STATE = 0x281


class Nodes:
    """Lean drive 1, encoder 32, and torque sensor 64 that sends on every second SYNC.

    `edit` changes the answers to a SYNC.
    """

    def __init__(self, phase: int = 0) -> None:
        self.syncs, self.position, self.mode, self.speed = phase, 0, 10, 0
        self.edit: Callable[[int, list[Frame]], list[Frame]] = lambda number, frames: frames

    def __call__(self, frame: Frame) -> Iterable[Frame]:
        if frame[0] != 0x080:
            return []
        self.syncs += 1
        self.position += self.speed
        frames = [(0x181, struct.pack("<Hhi", 0x1637, 100, self.position)), (0x1A0, bytes(4))]
        if self.syncs % 2 == 0:
            frames.append((0x1C0, struct.pack("<i", self.syncs)))
        if self.syncs % 50 == 0:
            frames.append((STATE, struct.pack("<bH", self.mode, 0x7500)))
        return self.edit(self.syncs, frames)


def lean_rig(phase: int = 0) -> tuple[Rig, FakeBus, Nodes]:
    nodes = Nodes(phase)
    bus = FakeBus(FakeClock(), nodes)
    axis = axis_nodes(pdo="lean")
    assert axis.torque_sensor is not None
    axis = replace(axis, torque_sensor=replace(axis.torque_sensor, every=2))
    rig = Rig(bus, BusSettings(), [axis], [DriveProfile()])
    rig.start()
    return rig, bus, nodes


@pytest.mark.parametrize("phase", [0, 1, 17, 49])
def test_every_cycle_is_fresh_and_no_mode_is_believed_before_it_came(phase: int) -> None:
    rig, bus, nodes = lean_rig(phase)
    image = rig.axes[0].image
    nodes.speed = 10  # counts per ms
    for _ in range(500):
        cycle(rig, bus)
        assert image.fresh
        assert image.mode == (10 if nodes.syncs > 50 else 0)  # received at SYNC 50, used from the next SYNC on
    assert image.error_code == 0x7500
    assert image.tau_m == pytest.approx(0.1)
    assert image.omega_m == pytest.approx(10 / 65536 * 2.0 * math.pi / 0.001, rel=1e-3)
    assert [(node.repeated, node.missed, node.late) for node in image.nodes] == [(0, 0, 0)] * 3


def test_a_new_start_forgets_the_mode() -> None:
    rig, bus, _ = lean_rig()
    for _ in range(60):
        cycle(rig, bus)
    rig.start()
    assert rig.axes[0].image.mode == 0


def test_a_mode_that_no_longer_comes_is_stale() -> None:
    rig, bus, nodes = lean_rig()
    for _ in range(100):
        cycle(rig, bus)
    nodes.edit = lambda number, frames: [frame for frame in frames if frame[0] != STATE]
    fresh = []
    for _ in range(60):
        cycle(rig, bus)
        fresh.append(rig.axes[0].image.fresh)
    assert fresh == [True] * 51 + [False] * 9
    nodes.edit = lambda number, frames: frames
    for _ in range(50):
        cycle(rig, bus)
    assert rig.axes[0].image.fresh


def test_one_that_comes_an_sync_late_is_no_repetition() -> None:
    rig, bus, nodes = lean_rig()
    late: list[Frame] = []

    def delay(number: int, frames: list[Frame]) -> list[Frame]:
        waiting, late[:] = list(late), [frame for frame in frames if frame[0] == STATE and number == 100]
        return [frame for frame in frames if frame not in late] + waiting

    nodes.edit = delay
    for _ in range(300):
        cycle(rig, bus)
        assert rig.axes[0].image.fresh
    assert rig.axes[0].image.repeated == 0


@pytest.mark.parametrize(("can_id", "number"), [(0x181, 70), (STATE, 100), (0x1C0, 101)])
def test_each_forged_frame_counts_as_repeated(can_id: int, number: int) -> None:
    """The frame is an additional one in its cycle, or comes in a cycle in which none is due. Its data are ignored."""
    rig, bus, nodes = lean_rig()
    forged = {0x181: bytes(8), STATE: struct.pack("<bH", 3, 0), 0x1C0: bytes(4)}[can_id]
    nodes.edit = lambda count, frames: [*frames, (can_id, forged)] if count == number else frames
    for _ in range(120):
        cycle(rig, bus)
    image = rig.axes[0].image
    assert (image.repeated, image.mode, image.statusword) == (1, 10, 0x1637)


def test_what_waits_before_the_next_sync_is_taken_if_it_is_seldom() -> None:
    """The loop does not wait for this frame, so on a busy bus it arrives after the end of the cycle.

    The first such frame is used. A second one counts as repeated.
    """
    rig, bus, nodes = lean_rig()
    nodes.edit = lambda number, frames: [frame for frame in frames if frame[0] != 0x1C0]
    cycle(rig, bus)
    bus.waiting.append((0x1C0, struct.pack("<i", 250_000)))
    rig.wait(bus.clock.now)
    assert rig.axes[0].image.tau_j == pytest.approx(0.25)
    bus.waiting.append((0x1C0, struct.pack("<i", 500_000)))
    rig.wait(bus.clock.now)
    assert rig.axes[0].image.tau_j == pytest.approx(0.25)
    assert rig.axes[0].image.repeated == 1


def test_a_fault_has_the_code_of_its_emergency_before_the_error_code_comes() -> None:
    rig, bus, nodes = lean_rig()
    nodes.edit = lambda number, frames: [
        (0x081, bytes.fromhex("1023010000000000")),
        (0x181, struct.pack("<Hhi", 0x1218, 0, 0)),
        *frames[1:],
    ]
    cycle(rig, bus)
    assert rig.axes[0].image.error_code == 0x2310


def test_startup_waits_for_the_mode_and_refuses_a_drive_that_never_sends_it() -> None:
    rig, _, nodes = lean_rig()
    check_startup(rig, 0.001, 50)
    assert rig.axes[0].image.mode == 10
    rig, _, nodes = lean_rig()
    nodes.edit = lambda number, frames: [frame for frame in frames if frame[0] != STATE]
    with pytest.raises(BusError, match="drive node 1"):
        check_startup(rig, 0.001, 60)
