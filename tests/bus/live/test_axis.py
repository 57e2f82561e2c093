"""Test one axis with scripted nodes: counters, kept values, and the reset at a new start."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable

import pytest

from tests.bus.fake import FakeBus, FakeClock
from tests.bus.nodes import Responder, axis_nodes, cycle, one_axis_rig
from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.axis import Axis, Inbox
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, EncoderSettings, TorqueSensorSettings
from tsa_ctrl.bus.wire.bus import Frame

OVER_CURRENT = struct.pack("<HBxxxxx", 0x2310, 0x02)


def axis_of(nodes: AxisNodes, profile: DriveProfile | None = None, shared: dict[int, Inbox] | None = None) -> Axis:
    bus = FakeBus(FakeClock(), lambda frame: [])
    return Axis(nodes, profile or DriveProfile(), bus, shared)


def test_before_it_is_known_whose_the_drive_is_nothing_is_sent() -> None:
    bus = FakeBus(FakeClock(), lambda frame: [])
    axis = Axis(axis_nodes(), DriveProfile(), bus)
    axis.tau_m_sent = 0.3
    assert axis.command(0x0F, 0.5) is True
    assert (bus.sent, axis.tau_m_sent, axis.refused) == ([], 0.0, 0)
    axis.stands_off = False
    assert axis.command(0x0F, 0.5) is True
    assert bus.sent == [(0x201, b"\x0f\x00\xf4\x01")]
    assert list(axis.readback.sent) == [500]


def test_a_drive_without_an_error_code_has_that_of_its_last_emergency() -> None:
    axis = axis_of(axis_nodes(), DriveProfile(absent=[objects.ERROR_CODE.name]))
    store, image = axis.inboxes[1].store, axis.image
    store((1000, 10))
    assert (image.mode, image.error_code) == (10, 0)
    axis.guards[0].emergency(OVER_CURRENT)
    store((1000, 9))
    assert (image.mode, image.error_code) == (9, 0x2310)


def test_each_node_is_charged_with_its_own_gaps_and_a_whole_cycle_ends_them() -> None:
    rig, bus, nodes = one_axis_rig()
    image = rig.axes[0].image
    drive, encoder, sensor = image.nodes
    cycle(rig, bus)
    rows = (  # silent PDOs, consecutive misses of each node, drive and encoder fresh, joint fresh
        ({0x1C0}, (0, 0, 1), True, True),
        ({0x281}, (1, 0, 0), False, True),
        ({0x181, 0x281, 0x1C0}, (2, 0, 1), False, True),
        ({0x1A0}, (0, 1, 0), False, False),
    )
    for silent, misses, fresh, joint_fresh in rows:
        nodes.silent = silent
        cycle(rig, bus)
        assert (drive.misses, encoder.misses, sensor.misses) == misses
        assert (image.fresh, image.joint_fresh) == (fresh, joint_fresh)
    assert (drive.missed, encoder.missed, sensor.missed) == (2, 1, 2)
    assert (image.misses, image.missed) == (3, 3)
    assert image.pdo_age == pytest.approx(0.003)
    nodes.silent = set()
    cycle(rig, bus)
    assert (drive.misses, encoder.misses, sensor.misses) == (0, 0, 0)
    assert (image.fresh, image.joint_fresh, image.misses, image.missed, image.pdo_age) == (True, True, 0, 3, 0.0)


def test_a_sensor_has_a_sign_and_a_zero() -> None:
    nodes = AxisNodes(
        name="knee", drive=DriveSettings(node_id=1), encoder=None,
        torque_sensor=TorqueSensorSettings(node_id=64, sign=-1, resolution=1e-5, offset=0.25),
    )  # fmt: skip
    responder = Responder()
    bus = FakeBus(FakeClock(), responder)
    rig = Rig(bus, BusSettings(), [nodes], [DriveProfile()])
    rig.start()
    responder.sensor = 150_000
    cycle(rig, bus)
    image = rig.axes[0].image
    assert image.tau_j == pytest.approx(-1.5 - 0.25)
    assert math.isnan(image.q_j)
    assert image.fresh
    assert [str(node) for node in image.nodes] == ["drive node 1", "torque sensor node 64"]
    assert rig.axes[0].tpdo_ids == [0x181, 0x281, 0x1C0]


def test_two_axes_share_an_encoder_and_nothing_else() -> None:
    def answer(frame: Frame) -> Iterable[Frame]:
        if frame[0] != 0x80:
            return []
        frames: list[Frame] = [(0x1A0, struct.pack("<I", 1 << 18))]
        for node in (1, 2):
            frames.append((0x180 + node, struct.pack("<Hhi", 0x1637, 100 * node, 0)))
            frames.append((0x280 + node, struct.pack("<ibH", 0, 10, 0)))
        return frames

    bus = FakeBus(FakeClock(), answer)
    pair = [
        AxisNodes(name=name, drive=DriveSettings(node_id=node), encoder=EncoderSettings(node_id=32))
        for node, name in ((1, "a"), (2, "b"))
    ]
    rig = Rig(bus, BusSettings(), pair, [DriveProfile()] * 2)
    rig.start()
    cycle(rig, bus)
    assert [axis.image.q_j for axis in rig.axes] == [pytest.approx(0.5 * math.pi)] * 2
    assert all(axis.image.fresh for axis in rig.axes)
    assert [axis.image.tau_m for axis in rig.axes] == [pytest.approx(0.1), pytest.approx(0.2)]
    rig.axes[1].command(0x06, 0.0)
    assert bus.sent[-1] == (0x202, b"\x06\x00\x00\x00")


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
