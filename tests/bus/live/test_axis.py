"""One axis against hand-made nodes: what it counts, what it keeps, and what a new start forgets."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable

import pytest

from tests.bus.fake import FakeBus, FakeClock
from tests.bus.nodes import Responder, axis_nodes, cycle, one_axis_rig
from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.axis import Axis, Guard, Inbox
from tsa_ctrl.bus.live.image import Image, NodeHealth
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import (
    AxisNodes,
    BusSettings,
    DriveSettings,
    EncoderSettings,
    Role,
    TorqueSensorSettings,
)
from tsa_ctrl.bus.wire.seam import Frame

OVER_CURRENT = struct.pack("<HBxxxxx", 0x2310, 0x02)
ERROR_RESET = bytes(8)


def axis_of(nodes: AxisNodes, profile: DriveProfile | None = None, shared: dict[int, Inbox] | None = None) -> Axis:
    bus = FakeBus(FakeClock(), lambda frame: [])
    return Axis(nodes, profile or DriveProfile(), bus, bus.clock, shared)


def test_before_it_is_known_whose_the_drive_is_nothing_is_sent() -> None:
    bus = FakeBus(FakeClock(), lambda frame: [])
    axis = Axis(axis_nodes(), DriveProfile(), bus, bus.clock)
    axis.tau_m_sent = 0.3
    assert axis.command(0x0F, 0.5) is True
    assert (bus.sent, axis.tau_m_sent, axis.refused) == ([], 0.0, 0)
    axis.stands_off = False
    assert axis.command(0x0F, 0.5) is True
    assert bus.sent == [(0x201, b"\x0f\x00\xf4\x01")]
    assert list(axis.hearing.sent) == [500]


@pytest.mark.parametrize("way", [1, -1])
def test_a_torque_is_sent_up_to_the_drives_limit_and_no_further(way: int) -> None:
    rig, bus, _ = one_axis_rig(max_torque=1.5)
    axis = rig.axes[0]
    sent = []
    for torque in (1.4996, 1.5, 1.5004, 1.6, 100.0):
        axis.command(0x0F, way * torque)
        sent.append(struct.unpack("<Hh", bus.sent[-1][1])[1])
    assert sent == [way * 1500] * 5
    assert axis.tau_m_sent == pytest.approx(way * 1.5)
    assert axis.refused == 0
    assert [axis.command(0x0F, math.nan), axis.command(0x0F, math.inf)] == [True, True]
    assert axis.refused == 2


def test_dropped_commands_are_counted_in_a_row_and_in_all_and_are_not_taken_for_sent() -> None:
    rig, bus, _ = one_axis_rig()
    axis, image = rig.axes[0], rig.axes[0].image
    for full in (True, True, False, True):
        bus.full = full
        assert axis.command(0x0F, 0.1) is not full
    assert (image.drops, image.dropped, list(axis.hearing.sent)) == (1, 3, [100])


def inbox(health: NodeHealth) -> Inbox:
    axis = axis_of(axis_nodes())
    found = axis.inboxes[0]
    found.health = health
    return found


def test_frames_that_are_no_answer_are_counted_by_what_they_are() -> None:
    health = NodeHealth(Role.DRIVE, 1, 0.2)
    box = inbox(health)
    assert (box.armed, box.awaited, box.length) == (False, 1, 8)
    box.refuse(bytes(8))
    assert (health.repeated, health.malformed, health.late) == (1, 0, 0)
    box.refuse(bytes(7))
    assert (health.repeated, health.malformed, health.late) == (1, 1, 0)
    box.refuse_stale(bytes(8))  # of a cycle whose answer was taken
    assert (health.repeated, health.malformed, health.late) == (2, 1, 0)
    box.armed, health.misses = True, 7
    box.refuse_stale(bytes(8))
    assert (health.repeated, health.malformed, health.late, health.misses) == (2, 1, 1, 7)
    box.refuse_stale(bytes(9))
    assert (health.repeated, health.malformed, health.late) == (2, 2, 1)
    box.awaited = 0
    box.refuse_stale(bytes(8))  # of one that was not waited for any longer
    assert (health.late, health.misses) == (2, 0)


def guard(told: frozenset[int] = frozenset()) -> tuple[Guard, NodeHealth, Image, FakeClock]:
    clock, health = FakeClock(), NodeHealth(Role.DRIVE, 1, 0.2)
    health.told = told
    image = Image((health,))
    return Guard(health, image, clock), health, image, clock


def test_heartbeats() -> None:
    watch, health, image, clock = guard()
    for data in (b"", b"\x05\x05"):
        watch.heartbeat(data)
    assert (health.malformed, health.heard, image.events) == (2, 0.0, 0)
    watch.heartbeat(b"\x05")
    assert (health.heard, health.nmt_state, image.events) == (clock.now, 5, 0)
    watch.heartbeat(b"\x7f")
    watch.heartbeat(b"\x7f")
    assert (health.nmt_state, health.boot_ups, image.events) == (0x7F, 0, 1)
    watch.heartbeat(b"\x00")
    assert (health.nmt_state, health.boot_ups, image.events, health.malformed) == (0, 1, 3, 2)


def test_an_answer_to_node_guarding_with_an_unchanged_toggle_bit_did_not_come() -> None:
    _, health, image, clock = guard()
    watch = Guard(health, image, clock, guarded=True)
    for data, counts in (
        (b"\x05", True), (b"\x85", True), (b"\x85", False), (b"\x05", True), (b"\x00", True), (b"\x05", True),
        (b"\x7f", False), (b"\xff", True),
    ):  # fmt: skip
        before, clock.now = health.heard, clock.now + 1.0
        watch.heartbeat(data)
        assert health.heard == (clock.now if counts else before), data
    assert (health.untoggled, health.boot_ups) == (2, 1)
    assert health.nmt_state == 0x7F
    watch.begin()
    watch.heartbeat(b"\xff")
    assert health.untoggled == 2


def test_emergencies() -> None:
    watch, health, image, _ = guard(frozenset({0x3210}))
    watch.emergency(bytes(7))
    assert (health.malformed, health.emcy, image.events) == (1, None, 0)
    watch.emergency(ERROR_RESET)
    assert (health.emcys, health.emcy, image.events) == (0, None, 0)
    watch.emergency(struct.pack("<HBxxxxx", 0x3210, 0x04))
    assert (health.emcys, health.emcy, image.events, health.warnings) == (0, None, 0, 1)
    assert health.warning is not None
    assert health.warning.code == 0x3210
    watch.emergency(OVER_CURRENT)
    watch.emergency(OVER_CURRENT)
    assert (health.emcys, image.events, health.warnings, health.malformed) == (2, 2, 1, 1)
    assert health.emcy is not None
    assert health.emcy.code == 0x2310


def test_a_drive_without_an_error_code_has_that_of_its_last_emergency() -> None:
    axis = axis_of(axis_nodes(), DriveProfile(absent=[objects.ERROR_CODE.name]))
    store, image = axis.inboxes[1].store, axis.image
    store((1000, 10))
    assert (image.mode, image.error_code) == (10, 0)
    axis.guards[0].emergency(OVER_CURRENT)
    store((1000, 9))
    assert (image.mode, image.error_code) == (9, 0x2310)


def test_a_new_start_forgets_what_was_latched() -> None:
    rig, bus, nodes = one_axis_rig()
    axis, image = rig.axes[0], rig.axes[0].image
    nodes.position, nodes.count = 500_000, 200_000
    cycle(rig, bus)
    nodes.silent = {0x181}
    cycle(rig, bus)
    health = image.nodes[0]
    health.boot_ups = health.emcys = health.warnings = 2
    health.nmt_state = 4
    image.silent, image.intruder, image.altered = health, 5, "x"
    image.drops = image.events = 3
    image.joint_fresh = True
    before = image.missed, health.missed
    axis.guards[0].emergency(OVER_CURRENT)
    health.warning = health.emcy
    axis.rearm(123.5)
    for node in image.nodes:
        assert (node.heard, node.nmt_state, node.boot_ups, node.emcys, node.misses, node.warnings) == (
            123.5,
            5,
            0,
            0,
            0,
            0,
        )
        assert (node.emcy, node.warning) == (None, None)
    assert (image.silent, image.intruder, image.altered, image.bus_fault) == (None, None, None, None)
    assert (image.fresh, image.joint_fresh, image.misses, image.drops, image.events) == (False, False, 0, 0, 0)
    assert (image.missed, health.missed) == before  # since the start
    nodes.silent = set()
    nodes.position, nodes.count = 500_000 - (1 << 31), 200_000 - (1 << 19)  # half a range on: which way is not known
    cycle(rig, bus)
    assert image.fresh
    assert image.omega_j == 0.0


def test_a_silent_node_is_found_when_its_time_is_over_and_forgotten_when_it_speaks() -> None:
    rig, _, _ = one_axis_rig()
    axis, image = rig.axes[0], rig.axes[0].image
    axis.rearm(10.0)
    late, later = image.nodes[1], image.nodes[0]
    late.timeout, later.timeout, image.nodes[2].timeout = 0.25, 0.5, 5.0
    for now, silent in ((10.0, None), (10.25, None), (10.251, late), (10.501, later)):
        axis.settle(now, True)
        assert image.silent is silent, now
    late.heard = 10.7
    axis.settle(10.71, True)
    assert image.silent is later
    later.heard = 10.72
    axis.settle(10.73, True)
    assert image.silent is None


def test_each_node_is_charged_with_its_own_gaps_and_a_whole_cycle_ends_them() -> None:
    rig, bus, nodes = one_axis_rig()
    image = rig.axes[0].image
    drive, encoder, sensor = image.nodes
    cycle(rig, bus)
    for silent, misses in (({0x281}, (1, 0, 0)), ({0x181, 0x281, 0x1C0}, (2, 0, 1)), ({0x1A0}, (0, 1, 0))):
        nodes.silent = silent
        cycle(rig, bus)
        assert (drive.misses, encoder.misses, sensor.misses) == misses
    assert (drive.missed, encoder.missed, sensor.missed) == (2, 1, 1)
    assert (image.fresh, image.joint_fresh, image.misses, image.missed) == (False, False, 3, 3)
    assert image.pdo_age == pytest.approx(0.003)
    nodes.silent = set()
    cycle(rig, bus)
    assert (drive.misses, encoder.misses, sensor.misses) == (0, 0, 0)
    assert (image.fresh, image.joint_fresh, image.misses, image.missed, image.pdo_age) == (True, True, 0, 3, 0.0)


def test_what_is_stale_is_kept_as_it_was() -> None:
    rig, bus, nodes = one_axis_rig()
    image = rig.axes[0].image
    nodes.position, nodes.count = 1000, 4096
    cycle(rig, bus)
    before = image.q_m, image.q_j
    nodes.position, nodes.count, nodes.silent = 2000, 8192, {0x1A0}
    cycle(rig, bus)
    assert (image.q_m, image.q_j) == before
    nodes.count, nodes.silent = 12_288, {0x181}
    cycle(rig, bus)
    assert image.q_m == before[0]
    assert image.q_j == pytest.approx(3.0 * before[1])  # the encoder's own answer is fresh


def test_a_sensor_has_a_sign_and_a_zero() -> None:
    nodes = AxisNodes(
        name="knee", drive=DriveSettings(node_id=1), encoder=None,
        torque_sensor=TorqueSensorSettings(node_id=64, sign=-1, resolution=1e-5, offset=0.25),
    )  # fmt: skip
    responder = Responder()
    bus = FakeBus(FakeClock(), responder)
    rig = Rig(bus, BusSettings(), [nodes], [DriveProfile()], bus.clock)
    rig.start()
    responder.sensor = 150_000
    cycle(rig, bus)
    image = rig.axes[0].image
    assert image.tau_j == pytest.approx(-1.5 - 0.25)
    assert math.isnan(image.q_j)
    assert image.fresh
    assert [str(node) for node in image.nodes] == ["drive node 1", "torque sensor node 64"]
    assert rig.axes[0].tpdo_ids == [0x181, 0x281, 0x1C0]


def test_an_encoder_of_two_axes_is_heard_once_and_told_to_both() -> None:
    def answer(frame: Frame) -> Iterable[Frame]:
        if frame[0] != 0x80:
            return []
        frames: list[Frame] = [(0x1A0, struct.pack("<I", 1 << 18))]
        for node in (1, 2):
            frames.append((0x180 + node, struct.pack("<Hhi", 0x1637, 0, 0)))
            frames.append((0x280 + node, struct.pack("<ibH", 0, 10, 0)))
        return frames

    bus = FakeBus(FakeClock(), answer)
    pair = [
        AxisNodes(name=name, drive=DriveSettings(node_id=node), encoder=EncoderSettings(node_id=32))
        for node, name in ((1, "a"), (2, "b"))
    ]
    rig = Rig(bus, BusSettings(), pair, [DriveProfile()] * 2, bus.clock)
    rig.start()
    cycle(rig, bus)
    assert [axis.image.q_j for axis in rig.axes] == [pytest.approx(0.5 * math.pi)] * 2
    assert all(axis.image.fresh for axis in rig.axes)


def test_names_scales_and_where_the_torque_is_shown() -> None:
    axis = axis_of(axis_nodes())
    assert (axis.name, axis.target.name, axis.rpdo_id) == ("knee", objects.TARGET_TORQUE.name, 0x201)
    assert (axis.stands_off, axis.refused, axis.tau_m_sent) == (True, 0, 0.0)
    assert axis.tpdo_ids == [0x181, 0x281, 0x1A0, 0x1C0]
    assert [health.role for health in axis.image.nodes] == [Role.DRIVE, Role.ENCODER, Role.TORQUE_SENSOR]


def test_the_motors_position_goes_on_over_the_end_of_its_counter() -> None:
    rig, bus, nodes = one_axis_rig()
    image = rig.axes[0].image
    nodes.position = (1 << 31) - 10
    cycle(rig, bus)
    before = image.q_m
    nodes.position = -(1 << 31) + 10
    cycle(rig, bus)
    assert image.q_m - before == pytest.approx(20 * math.tau / 65536, rel=1e-6)


def test_before_the_first_answer_a_value_is_older_than_any_and_a_node_may_be_silent() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {0x181, 0x281, 0x1A0, 0x1C0}
    cycle(rig, bus)
    assert rig.axes[0].image.pdo_age == math.inf
    axis = axis_of(axis_nodes())
    axis.settle(1000.0, True)
    assert axis.image.silent is axis.image.nodes[0]


def test_what_an_axis_is_made_of() -> None:
    given = axis_nodes()
    axis = axis_of(given, DriveProfile(warnings=[0x3210]))
    assert axis.nodes is given
    assert axis.image.nodes[0].told == {0x3210}
    for part in (axis.inboxes[0], axis.guards[0]):
        with pytest.raises(AttributeError):
            part.another = 1  # type: ignore[union-attr]


def test_a_position_counts_from_its_zero_in_all_of_its_range_and_after_a_new_start_again() -> None:
    rig, bus, nodes = one_axis_rig()
    image = rig.axes[0].image
    nodes.position = 3 << 29
    cycle(rig, bus)
    assert image.q_m == pytest.approx((3 << 29) * math.tau / 65536)
    for nodes.position in ((1 << 31) - 10, -(1 << 31) + 10):
        cycle(rig, bus)
    assert image.q_m == pytest.approx(((1 << 31) + 10) * math.tau / 65536)
    rig.axes[0].rearm(bus.clock.now)
    cycle(rig, bus)
    assert image.q_m == pytest.approx((-(1 << 31) + 10) * math.tau / 65536)


def test_a_speed_of_the_position_is_never_that_which_the_drive_says() -> None:
    rig, bus, nodes = one_axis_rig(velocity_source="position")
    nodes.velocity = 60_000
    cycle(rig, bus)
    nodes.silent = {0x281}
    cycle(rig, bus)
    assert rig.axes[0].image.omega_m == 0.0


def test_a_joint_that_is_not_heard_keeps_its_speed_whoever_else_is_silent() -> None:
    rig, bus, nodes = one_axis_rig()
    image = rig.axes[0].image
    for nodes.count in range(0, 50_000, 1000):
        cycle(rig, bus)
    before = image.omega_j
    assert before > 0.0
    nodes.silent = {0x1A0, 0x1C0}
    sampled = bus.clock.now
    cycle(rig, bus)
    assert (image.omega_j, image.joint_fresh, image.now) == (before, False, sampled)
