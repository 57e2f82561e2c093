"""Test the cyclic communication on a bus in memory."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bus.fake import FakeBus, FakeClock
from tests.bus.nodes import Responder, axis_nodes, cycle, one_axis_rig
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import BusFault


def test_cycle_is_sync_and_command_and_nothing_else() -> None:
    rig, bus, _ = one_axis_rig()
    cycle(rig, bus)
    rig.axes[0].command(0x0F, 0.25)
    assert bus.sent == [(0x080, b""), (0x201, b"\x0f\x00\xfa\x00")]


def test_image_is_in_si() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.torque, nodes.velocity, nodes.position = 500, 60_000, -16384  # per mille, mrpm, counts
    nodes.count, nodes.sensor = 1 << 18, 1_500_000  # quarter of a revolution, uN*m
    cycle(rig, bus)
    image = rig.axes[0].image
    assert (image.tau_m, image.tau_j) == (pytest.approx(0.5), pytest.approx(1.5))
    assert image.omega_m == pytest.approx(2.0 * math.pi)
    assert (image.q_m, image.q_j) == (pytest.approx(-math.pi / 2), pytest.approx(math.pi / 2))
    assert (image.statusword, image.mode, image.error_code) == (0x1637, 10, 0)


def test_values_are_nan_before_they_were_received() -> None:
    rig, _, _ = one_axis_rig()
    image = rig.axes[0].image
    values = (image.tau_m, image.q_m, image.omega_m, image.q_j, image.omega_j, image.tau_j)
    assert all(math.isnan(value) for value in values)


def test_gear_and_signs_hold_both_ways() -> None:
    rig, bus, nodes = one_axis_rig(gear_ratio=5.0, torque_sign=-1, position_sign=-1, rated_torque=0.2)
    nodes.torque, nodes.velocity, nodes.position = 100, 60_000, 65536
    cycle(rig, bus)
    axis = rig.axes[0]
    assert axis.image.tau_m == pytest.approx(-0.1 * 0.2 * 5.0)
    assert axis.image.omega_m == pytest.approx(-2.0 * math.pi / 5.0)
    assert axis.image.q_m == pytest.approx(-2.0 * math.pi / 5.0)
    axis.command(0x0F, axis.image.tau_m)
    assert bus.sent[-1] == (0x201, struct.pack("<Hh", 0x0F, 100))


def test_velocity_can_be_differentiated_from_the_position() -> None:
    rig, bus, nodes = one_axis_rig(velocity_source="position")
    nodes.velocity = 12345
    for number in range(200):
        nodes.position = 100 * number
        cycle(rig, bus)
    speed = 100 * 2.0 * math.pi / 65536 / 1e-3
    assert rig.axes[0].image.omega_m == pytest.approx(speed, rel=1e-6)
    nodes.silent = {0x281}
    cycle(rig, bus)
    assert rig.axes[0].image.omega_m == pytest.approx(speed, rel=1e-6)  # and not the velocity that the drive sends


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308])
def test_command_that_is_not_finite_in_device_units_is_zero_and_counted(value: float) -> None:
    rig, bus, _ = one_axis_rig()
    axis = rig.axes[0]
    axis.command(0x0F, value)
    assert (bus.sent[-1], axis.refused, axis.tau_m_sent) == ((0x201, b"\x0f\x00\x00\x00"), 1, 0.0)


@given(torque=st.floats(allow_nan=False, allow_infinity=False, width=32), limit=st.floats(0.01, 30.0))
def test_command_is_the_nearest_digit_up_to_the_drives_limit(torque: float, limit: float) -> None:
    rig, bus, _ = one_axis_rig(max_torque=limit)
    axis = rig.axes[0]
    axis.command(0x0F, torque)
    digits = struct.unpack("<Hh", bus.sent[-1][1])[1]
    most = axis.scale.max_torque_digits
    assert most <= 1000 * limit + 1e-6
    assert digits == pytest.approx(max(-most, min(most, 1000 * torque)), abs=0.5 + 1e-6)
    assert axis.tau_m_sent == pytest.approx(digits / 1000)
    assert axis.refused == 0


def test_command_that_cannot_be_sent_says_so_and_counts() -> None:
    rig, bus, _ = one_axis_rig()
    axis = rig.axes[0]
    bus.full = True
    assert [axis.command(0x0F, 0.1) for _ in range(3)] == [False] * 3
    assert axis.image.drops == 3
    bus.full = False
    assert axis.command(0x0F, 0.1)
    assert axis.image.drops == 0


def test_collect_ends_when_all_have_answered_without_waiting() -> None:
    rig, bus, _ = one_axis_rig()
    before = bus.clock.now
    rig.sync()
    rig.collect(before + 1.0)
    assert bus.clock.now == before
    assert rig.axes[0].image.fresh


def test_missing_answer_is_waited_for_until_the_deadline_and_no_longer() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {0x1A0}
    start = bus.clock.now
    rig.sync(start)
    rig.collect(start + 0.0006)
    assert bus.clock.now == pytest.approx(start + 0.0006)


def test_answers_that_come_one_by_one_until_the_deadline_are_all_taken() -> None:
    rig, bus, nodes = one_axis_rig()
    frames = nodes.frames()

    def due() -> float:
        """Return the arrival time of the next frame. Frames arrive every 140 us."""
        return start + 140e-6 * (5 - len(frames))

    def one_by_one(timeout: float) -> tuple[int, bytes] | None:
        """Return the next frame, or None if the time-out ends before it arrives."""
        if not frames or bus.clock.now + timeout < due():
            bus.clock.now += max(0.0, timeout)
            return None
        bus.clock.now = max(bus.clock.now, due())
        return frames.pop(0)

    def what_came(until: float, most: int) -> list[tuple[int, bytes]]:
        bus.clock.now = max(bus.clock.now, until)
        came = []
        while frames and due() <= bus.clock.now and len(came) < most:
            came.append(frames.pop(0))
        return came

    start = rig.wait(bus.clock.now)
    rig.sync(start)
    bus.recv, bus.gather = one_by_one, what_came  # type: ignore[method-assign]
    rig.collect(start + 0.0006)
    assert rig.axes[0].image.fresh
    assert bus.clock.now == pytest.approx(start + 560e-6)


def test_answer_that_comes_last_is_found_out_and_listened_for() -> None:
    """At first the frame with the lowest priority is expected last.

    If another frame repeatedly comes last, the bus waits for that one.
    """
    rig, bus, nodes = one_axis_rig()
    assert bus.bell == 0x281
    last = nodes.frames()[0]
    bus.answer = lambda frame: [*nodes.frames()[1:], last] if frame[0] == 0x80 else []
    for _ in range(10):
        cycle(rig, bus)
        assert rig.axes[0].image.fresh
    assert bus.bell == last[0]


def test_wakes_early_by_what_waking_costs_and_takes_what_comes_until_the_time() -> None:
    """The rig measures a wake-up latency of 50 us and shortens its waits by it.

    An answer that arrives between the wake-up and the start of the cycle counts as late.
    """
    bus = FakeBus(FakeClock(), Responder())
    rig = Rig(bus, BusSettings(), [axis_nodes()], [DriveProfile()], wake_early=2e-4)
    rig.start()
    start = bus.clock.now
    asked: list[float] = []

    waking = 50e-6

    def late(until: float, most: int) -> list[tuple[int, bytes]]:
        bus.clock.now = max(bus.clock.now + 10e-6, until + waking)
        asked.append(until)
        return [(0x181, bytes(8))] if len(asked) == 2 else []

    bus.gather = late  # type: ignore[method-assign]
    begun = [rig.wait(start + 0.001 * n) - start - 0.001 * n for n in range(1, 200)]
    assert begun[0] == pytest.approx(50e-6)
    assert all(0.0 <= late < 12e-6 for late in begun[100:])
    assert max(asked) == pytest.approx(start + 0.199 - 50e-6, abs=2e-6)
    rig.sync()  # no answer arrives in time
    del asked[:]
    waking = 20e-6
    assert rig.wait(start + 0.2) - start - 0.2 < 12e-6
    assert len(asked) > 1
    assert rig.axes[0].image.nodes[0].late == 1


def test_how_long_answers_are_waited_for_is_said_before_the_sleep() -> None:
    """Before the sleep, the rig sets the time by which it expects the answers of the next cycle.

    The answers are expected to take as long as in the previous cycle. Before the first cycle this is unknown.
    """
    rig, bus, _ = one_axis_rig()
    start = rig.wait(bus.clock.now + 0.001)
    assert bus.expected is None
    rig.sync(start)
    rig.collect(start + 0.0006)
    rig.wait(start + 0.001)
    assert bus.expected == pytest.approx(start + 0.0016, abs=1e-9)


def test_node_that_is_long_silent_is_not_waited_for_until_it_answers_again() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {0x281, 0x1C0}
    for _ in range(20):
        cycle(rig, bus)
    assert bus.bell in {0x181, 0x1A0}
    start = bus.clock.now
    rig.sync()
    rig.collect(start + 0.001)
    assert bus.clock.now == start
    nodes.silent = set()
    for _ in range(3):
        cycle(rig, bus)
    assert [node.misses for node in rig.axes[0].image.nodes] == [0, 0, 0]


def test_answer_that_waited_before_the_sync_is_not_believed() -> None:
    rig, bus, nodes = one_axis_rig()
    cycle(rig, bus)
    nodes.silent = {0x181}
    cycle(rig, bus)
    bus.waiting.append((0x181, struct.pack("<Hhi", 0x1637, 999, 0)))  # late answer to the previous cycle
    cycle(rig, bus)
    image = rig.axes[0].image
    assert (image.fresh, image.tau_m, image.nodes[0].late) == (False, 0.0, 1)


def test_second_answer_in_one_cycle_is_ignored() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.torque = 100
    answers = nodes.frames()
    nodes.torque = 900
    bus.answer = lambda frame: [answers[0], nodes.frames()[0], *answers[1:]] if frame[0] == 0x80 else []
    cycle(rig, bus)
    image = rig.axes[0].image
    assert (image.tau_m, image.nodes[0].repeated, image.fresh) == (pytest.approx(0.1), 1, True)


@pytest.mark.parametrize(("can_id", "data"), [(0x181, bytes(7)), (0x1A0, bytes(8))])
def test_answer_of_a_wrong_length_is_counted_and_ignored(can_id: int, data: bytes) -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {can_id}
    bus.answer = lambda frame: [(can_id, data), *nodes.frames()] if frame[0] == 0x80 else []
    cycle(rig, bus)
    image = rig.axes[0].image
    assert (image.fresh, image.malformed) == (False, 1)


def test_flood_before_the_sync_makes_the_cycle_stale_and_ends() -> None:
    rig, bus, _ = one_axis_rig()
    cycle(rig, bus)
    bus.waiting.extend([(0x181, struct.pack("<Hhi", 0x1637, 0, 0))] * 5000)
    cycle(rig, bus)
    assert (rig.axes[0].image.fresh, rig.flooded) == (False, 1)


def test_flood_after_the_sync_does_not_hold_the_cycle_beyond_its_deadline() -> None:
    rig, bus, _ = one_axis_rig()

    class Flood(FakeBus):
        def recv(self, timeout: float) -> tuple[int, bytes]:
            self.clock.now += 1e-5
            return 0x700 + 1, b"\x05"

        def gather(self, until: float, most: int) -> list[tuple[int, bytes]]:
            self.clock.now = max(self.clock.now, until) + most * 1e-5
            return [(0x700 + 1, b"\x05")] * most

    start = rig.wait(bus.clock.now)
    rig.bus = Flood(bus.clock)
    rig.sync()
    rig.collect(start + 0.0006)
    assert bus.clock.now < start + 2 * 0.0006


@given(
    frames=st.lists(
        st.tuples(
            st.sampled_from([0x181, 0x281, 0x1A0, 0x1C0, 0x701, 0x720, 0x081, 0x0A0, 0x080, 0x000, 0x77F, 0x123])
            | st.integers(0, 0x3FFFFFFF),
            st.binary(max_size=8),
        ),
        max_size=40,
    )
)
def test_any_frames_leave_a_usable_image(frames: list[tuple[int, bytes]]) -> None:
    rig, bus, nodes = one_axis_rig()
    bus.answer = lambda frame: [*frames, *nodes.frames()] if frame[0] == 0x80 else []
    for _ in range(3):
        cycle(rig, bus)
    image = rig.axes[0].image
    assert all(not math.isinf(value) for value in (image.tau_m, image.q_m, image.omega_m, image.q_j, image.omega_j))
    assert image.misses <= 3


def test_overdue_heartbeat_names_the_node() -> None:
    rig, bus, _ = one_axis_rig()
    for _ in range(250):
        bus.waiting.append((0x701, b"\x05"))
        bus.waiting.append((0x740, b"\x05"))
        cycle(rig, bus)
    silent = rig.axes[0].image.silent
    assert silent is not None
    assert str(silent) == "joint encoder node 32"


def test_boot_up_emergency_and_nmt_change_are_events() -> None:
    rig, bus, _ = one_axis_rig()
    image = rig.axes[0].image
    bus.waiting.extend([(0x701, b"\x00"), (0x0A0, b"\x00\x81\x11" + bytes(5)), (0x740, b"\x7f")])
    bus.waiting.append((0x081, bytes(8)))  # an emergency with code 0 reports that the error is gone
    cycle(rig, bus)
    assert image.events == 4  # a boot-up message also counts as a change of the NMT state
    assert [node.boot_ups for node in image.nodes] == [1, 0, 0]
    assert (image.nodes[1].emcys, image.nodes[2].nmt_state) == (1, 0x7F)
    assert str(image.emcy).startswith("EMCY 0x8100 (communication monitoring")


@pytest.mark.parametrize("can_id", [0x601, 0x640])
@pytest.mark.parametrize(
    ("request_", "met"),
    [("2316100100000000", True), ("C221140500000000", True), ("4041600000000000", False), ("", False)],
)
def test_an_sdo_of_somebody_else_is_an_intruder_when_it_writes(can_id: int, request_: str, met: bool) -> None:
    rig, bus, _ = one_axis_rig()
    bus.waiting.append((can_id, bytes.fromhex(request_)))
    cycle(rig, bus)
    assert rig.axes[0].image.intruder == (can_id if met else None)


def test_bus_off_is_latched() -> None:
    rig, bus, _ = one_axis_rig()
    bus.waiting.append((0x20000040, bytes(8)))
    cycle(rig, bus)
    cycle(rig, bus)
    assert (rig.axes[0].image.bus_fault, rig.error_frames, rig.last_error) == (BusFault.BUS_OFF, 1, "bus-off")


@pytest.mark.parametrize("can_id", [0x000, 0x080, 0x201, 0x77F])
def test_frame_that_only_a_master_sends_is_an_intruder(can_id: int) -> None:
    rig, bus, _ = one_axis_rig()
    bus.waiting.append((can_id, b"\x00\x00"))
    cycle(rig, bus)
    assert rig.axes[0].image.intruder == can_id


def test_only_frames_of_its_nodes_are_let_in() -> None:
    _, bus, _ = one_axis_rig()
    tpdos = {0x181, 0x281, 0x1A0, 0x1C0}
    heartbeats_and_emergencies = {0x701, 0x720, 0x740, 0x081, 0x0A0, 0x0C0}
    of_another_master = {0x000, 0x080, 0x201, 0x77F, 0x601, 0x620, 0x640}
    assert bus.accepted == tpdos | heartbeats_and_emergencies | of_another_master


def test_start_forgets_what_was_latched() -> None:
    rig, bus, _ = one_axis_rig()
    bus.waiting.extend([(0x701, b"\x00"), (0x081, b"\x00\x81\x11" + bytes(5)), (0x080, b"")])
    cycle(rig, bus)
    rig.start()
    cycle(rig, bus)
    image = rig.axes[0].image
    assert (image.events, image.nodes[0].boot_ups, image.emcy, image.intruder, image.missed) == (0, 0, None, None, 0)
