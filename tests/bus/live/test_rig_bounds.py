"""Where the rig's counts end, what a start keeps and forgets, and what it tells nodes that others share."""

from __future__ import annotations

import struct

import pytest

from tests.bus.fake import FakeBus, FakeClock
from tests.bus.nodes import Responder, axis_nodes, cycle, one_axis_rig
from tsa_ctrl.bus.canopen.cia301 import NmtCommand
from tsa_ctrl.bus.canopen.objects import Object, Type
from tsa_ctrl.bus.drive.checks import NodeReport, Report, Row
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, EncoderSettings, SupervisionSettings
from tsa_ctrl.bus.wire.seam import BusFault, Frame

HEARTBEAT = (0x701, b"\x05")
OVER_CURRENT = struct.pack("<HBxxxxx", 0x2310, 0x02)
TIMER = Object(0x1400, 5, Type.U16, "RPDO event timer")
PRODUCER = Object(0x1017, 0, Type.U16, "heartbeat producer")


def two_axes(
    first: DriveProfile | None = None, second: DriveProfile | None = None, settings: BusSettings | None = None
) -> tuple[Rig, FakeBus]:
    """Axes "hip" (drive 1) and "knee" (drive 2), which share encoder 32; nobody answers; not started."""
    bus = FakeBus(FakeClock())
    nodes = [AxisNodes(name=name, drive=DriveSettings(node_id=number), encoder=EncoderSettings(node_id=32))
             for name, number in (("hip", 1), ("knee", 2))]  # fmt: skip
    return Rig(bus, settings or BusSettings(), nodes, [first or DriveProfile(), second or DriveProfile()]), bus


def written(*rows: tuple[int, Row]) -> Report:
    """What a bring-up wrote, by node."""
    return Report(tuple(NodeReport("node", node_id, rows=[row]) for node_id, row in rows))


def answer(entry: Object, value: int) -> bytes:
    """A node's to the question for an object of two bytes."""
    return struct.pack("<BHBHxx", 0x4B, *entry.key, value)


@pytest.mark.parametrize(("waiting", "flooded"), [(511, 0), (512, 1)])
def test_512_frames_that_wait_before_a_sync_are_a_flood(waiting: int, flooded: int) -> None:
    rig, bus, _ = one_axis_rig()
    cycle(rig, bus)
    bus.waiting.extend([HEARTBEAT] * waiting)
    cycle(rig, bus)
    assert (rig.flooded, rig.axes[0].image.fresh) == (flooded, not flooded)
    cycle(rig, bus)
    assert (rig.flooded, rig.axes[0].image.fresh) == (flooded, True)


@pytest.mark.parametrize(("between", "missed"), [(16, 0), (17, 1)])
def test_sixteen_messages_may_stand_between_answers_that_came_in_time(between: int, missed: int) -> None:
    rig, bus, nodes = one_axis_rig()
    start = bus.clock.now
    rig.sync()
    bus.waiting.clear()
    bus.waiting.extend([HEARTBEAT] * between + nodes.frames())
    bus.answers = lambda timeout, most: []  # type: ignore[method-assign]
    bus.recv = lambda timeout: None  # type: ignore[method-assign]
    rig.collect(start + 0.0006)
    assert rig.axes[0].image.nodes[2].missed == missed  # the torque sensor, whose answer is the last


def test_no_more_than_512_frames_are_taken_after_a_sync() -> None:
    """One at a time, as a bus gives them that wakes for each."""
    rig, bus, _ = one_axis_rig()
    taken = []

    def one(timeout: float) -> Frame:
        taken.append(timeout)
        assert len(taken) < 600
        return HEARTBEAT

    rig.sync()
    bus.recv = one  # type: ignore[method-assign]
    bus.gather = lambda until, most: []  # type: ignore[method-assign]
    rig.collect(bus.clock.now + 1.0)
    assert len(taken) == 512


def test_a_flooded_cycle_waits_for_nothing() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {0x181, 0x281, 0x1A0, 0x1C0}
    bus.waiting.extend([HEARTBEAT] * 512)
    start = bus.clock.now
    rig.sync()
    rig.collect(start + 0.0006)
    assert bus.clock.now == start


def test_what_comes_at_any_time_is_taken_between_answers_too() -> None:
    rig, bus, nodes = one_axis_rig()
    bus._answer = lambda frame: [(0x081, OVER_CURRENT), *nodes.frames()] if frame[0] == 0x80 else []
    cycle(rig, bus)
    image = rig.axes[0].image
    assert (image.fresh, image.nodes[0].emcys) == (True, 1)


def test_a_node_that_is_not_waited_for_ends_no_cycle_and_is_missed_in_each() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {0x1C0}
    for _ in range(20):
        cycle(rig, bus)
    image = rig.axes[0].image
    assert (image.nodes[2].missed, image.missed) == (20, 0)
    nodes.silent = set()
    first = nodes.frames()
    bus._answer = lambda frame: [first[3], *first[:3]] if frame[0] == 0x80 else []
    cycle(rig, bus)
    assert (image.nodes[2].missed, image.nodes[0].missed, image.missed) == (20, 0, 0)


def test_answers_that_come_at_once_and_a_cycle_without_all_of_them_teach_nothing() -> None:
    rig, bus, nodes = one_axis_rig()
    usual = sorted(nodes.frames())
    bus._answer = None
    bus.answers = lambda timeout, most: [usual[-1], *usual[:-1]]  # type: ignore[method-assign]
    for _ in range(20):
        cycle(rig, bus)
    assert (bus.bell, rig.axes[0].image.missed) == (0x281, 0)
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {0x281}
    for _ in range(10):
        cycle(rig, bus)
    assert bus.bell == 0x281


def test_a_cycle_without_all_answers_forgets_nothing_of_which_comes_last() -> None:
    rig, bus, nodes = one_axis_rig()
    answers = sorted(nodes.frames())
    answers = [answers[-1], *answers[:-1]]
    bus._answer = lambda frame: answers if frame[0] == 0x80 else []
    for _ in range(8):
        cycle(rig, bus)
    assert bus.bell == 0x1C0
    del answers[1]
    cycle(rig, bus)
    assert (bus.bell, rig.axes[0].image.missed) == (0x1C0, 1)


def test_a_fault_of_the_bus_is_latched_until_a_start() -> None:
    rig, bus, _ = one_axis_rig()
    bus.fault = BusFault.ADAPTER
    cycle(rig, bus)
    bus.clear_fault()
    cycle(rig, bus)
    assert rig.axes[0].image.bus_fault is BusFault.ADAPTER
    rig.start()
    cycle(rig, bus)
    assert rig.axes[0].image.bus_fault is None


def test_a_heartbeat_goes_out_in_the_cycle_in_which_it_is_due() -> None:
    rig, bus, _ = one_axis_rig()
    period = rig.settings.host_heartbeat_period
    for now in (100.0, 100.0 + period):
        rig.heartbeat(now)
    assert bus.sent == [(0x77F, b"\x05")] * 2


def test_the_last_answer_is_another_when_it_came_last_eight_times_in_a_row() -> None:
    rig, bus, nodes = one_axis_rig()
    usual = nodes.frames()
    usual.sort(key=lambda frame: frame[0])  # 0x281 comes last, as it is thought to
    other = [usual[-1], *usual[:-1]]
    order = usual
    bus._answer = lambda frame: order if frame[0] == 0x80 else []

    def cycles(count: int, frames: list[Frame]) -> None:
        nonlocal order
        order = frames
        for _ in range(count):
            cycle(rig, bus)

    cycles(6, other)
    assert bus.bell == 0x281
    cycles(1, usual)
    cycles(7, other)
    assert bus.bell == 0x281
    cycles(1, other)
    assert bus.bell == 0x1C0
    cycles(7, usual)
    assert bus.bell == 0x1C0
    cycles(1, usual)
    assert bus.bell == 0x281


def test_a_silent_node_is_waited_for_in_eleven_cycles_and_again_after_a_start() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {0x1C0}

    def waits() -> bool:
        start = bus.clock.now
        rig.sync()
        rig.collect(start + 0.0006)
        waited = bus.clock.now > start
        bus.clock.now = start + 0.001
        return waited

    assert [waits() for _ in range(13)] == [True] * 11 + [False] * 2
    rig.start()
    assert waits()


def test_a_start_waits_for_nothing_and_a_cycle_for_its_answers_only() -> None:
    bus = FakeBus(FakeClock(), Responder())
    bus.clock.now = 0.0
    rig = Rig(bus, BusSettings(), [axis_nodes()], [DriveProfile()])
    rig.start()
    rig.sync()
    rig.collect(1.0)
    rig.wait(0.0)
    rig.sync()
    rig.collect(1.0)
    assert bus.clock.now == 0.0


def test_once_awake_it_sleeps_no_more_before_its_time() -> None:
    bus = FakeBus(FakeClock(), Responder())
    bus.clock.now = 0.0
    rig = Rig(bus, BusSettings(), [axis_nodes()], [DriveProfile()])
    rig.start()
    slept = []

    def early(until: float, most: int) -> list[Frame]:
        slept.append(until > bus.clock.now)
        bus.clock.now += 1e-4
        return []

    bus.gather = early  # type: ignore[method-assign]
    rig.wait(0.00035)
    assert slept == [True, False, False, False]


@pytest.mark.parametrize("node_id", [1, 127])
def test_a_start_keeps_emergencies_that_came_since_the_bring_up_and_nothing_else(node_id: int) -> None:
    bus = FakeBus(FakeClock())
    rig = Rig(bus, BusSettings(), [AxisNodes(name="hip", drive=DriveSettings(node_id=node_id))], [DriveProfile()])
    bus.waiting.extend(
        [
            (0x080 + node_id, OVER_CURRENT),
            (0x080, b""),
            (0x100, bytes(8)),
            (0x700 + node_id, b"\x00"),
            (0x000, b"\x80\x00"),
        ]
    )
    rig.start()
    image = rig.axes[0].image
    assert (image.nodes[0].emcys, image.events, image.nodes[0].boot_ups, image.intruder) == (1, 1, 0, None)


def test_no_answer_from_before_a_start_is_believed_after_it() -> None:
    """Nor one that came between the start and the first SYNC, nor more of them than a start looks at."""
    for before, after in ((600, 0), (0, 1)):
        rig, bus, nodes = one_axis_rig()
        stale = (0x181, struct.pack("<Hhi", 0x1637, 999, 0))
        bus.waiting.extend([stale] * before)
        rig.start()
        assert len(bus.waiting) == 0
        bus.waiting.extend([stale] * after)
        nodes.silent = {0x181}
        cycle(rig, bus)
        image = rig.axes[0].image
        assert (image.fresh, image.nodes[0].repeated) == (False, after)


def test_nothing_was_commanded_before_the_first_start_and_nothing_is_while_it_stands_off() -> None:
    rig, bus = two_axes()
    assert (rig.has_commanded, rig.commands, rig.last_error) == (False, False, "")
    rig.start()
    assert (rig.has_commanded, rig.commands) == (True, True)
    rig.axes[1].stands_off = True
    assert rig.commands is True
    rig.stand_off()
    for axis in rig.axes:
        axis.command(0x0F, 0.1)
    assert (rig.has_commanded, rig.commands, bus.sent) == (True, False, [])


def test_axes_and_profiles_belong_together_one_by_one() -> None:
    with pytest.raises(ValueError, match="zip"):
        Rig(FakeBus(FakeClock()), BusSettings(), [axis_nodes()], [DriveProfile()] * 2)


def test_settings_are_what_it_was_given() -> None:
    settings = BusSettings()
    rig, _ = two_axes(settings=settings)
    assert rig.settings is settings


def test_its_clock_is_the_one_it_was_given_or_the_bus_own() -> None:
    other = FakeClock()
    other.now = 7.0
    for clock, now in ((None, 100.0), (other, 7.0)):
        bus = FakeBus(FakeClock())
        rig = Rig(bus, BusSettings(), [axis_nodes()], [DriveProfile()], clock)
        rig.start()
        assert rig.axes[0].image.nodes[0].heard == now
        rig.sync()
        assert rig.collect(now) == now


def test_the_sync_has_the_time_that_it_is_given() -> None:
    rig, bus, _ = one_axis_rig()
    rig.sync(bus.clock.now - 0.0002)
    assert rig.collect(bus.clock.now + 0.001) == pytest.approx(99.9998)
    assert rig.axes[0].image.now == pytest.approx(99.9998)


def test_unless_told_it_does_not_wake_early() -> None:
    rig, bus, _ = one_axis_rig()
    asked = []

    def late(until: float, most: int) -> list[Frame]:
        asked.append(until)
        bus.clock.now = max(bus.clock.now, until) + 1e-5
        return []

    bus.gather = late  # type: ignore[method-assign]
    times = [100.001 + 0.001 * n for n in range(20)]
    for until in times:
        rig.wait(until)
    assert asked == times


def test_a_node_of_two_axes_is_heard_by_both() -> None:
    rig, bus = two_axes()
    rig.start()
    bus.waiting.extend([(0x720, b"\x00"), (0x0A0, OVER_CURRENT)])
    cycle(rig, bus)
    assert [(axis.image.nodes[1].boot_ups, axis.image.nodes[1].emcys) for axis in rig.axes] == [(1, 1)] * 2


def test_guarded_drives_are_asked_by_remote_frames_with_each_heartbeat_and_not_while_it_is_withheld() -> None:
    rig, bus = two_axes(second=DriveProfile(supervision="guarding"))
    rig.start()
    rig.heartbeat(100.0)
    assert bus.sent == [(0x77F, b"\x05"), (0x40000702, b"")]
    rig.withholds_heartbeat = True
    rig.heartbeat(101.0)
    rig.withholds_heartbeat = False
    rig.heartbeat(101.001)
    assert len(bus.sent) == 2
    rig.heartbeat(102.0)
    assert len(bus.sent) == 4


def test_an_nmt_command_goes_to_all_nodes_unless_one_is_named() -> None:
    rig, bus, _ = one_axis_rig()
    assert rig.nmt(NmtCommand.START)
    assert bus.sent == [(0x000, b"\x01\x00")]
    bus.full = True
    assert not rig.nmt(NmtCommand.START)
    assert rig.sync() is False


def test_a_frame_that_only_a_master_sends_is_met_by_every_axis() -> None:
    rig, bus = two_axes()
    rig.start()
    bus.waiting.append((0x201, bytes(4)))
    cycle(rig, bus)
    assert [axis.image.intruder for axis in rig.axes] == [0x201, 0x201]


def test_an_error_frame_is_counted_and_only_bus_off_is_a_fault_which_replaces_no_other() -> None:
    rig, bus, _ = one_axis_rig()
    bus.waiting.extend([(0x20000004, bytes(8)), (0x123, bytes(8)), (0x7C0, b"")])
    cycle(rig, bus)
    assert (rig.error_frames, bus.counters.error_frames, bus.fault, rig.axes[0].image.bus_fault) == (1, 1, None, None)
    bus.fault = BusFault.ADAPTER
    bus.waiting.append((0x20000040, bytes(8)))
    cycle(rig, bus)
    assert (rig.error_frames, bus.fault, rig.axes[0].image.bus_fault) == (2, BusFault.ADAPTER, BusFault.ADAPTER)


def test_what_a_node_no_longer_holds_is_said_at_each_of_its_axes_and_no_other() -> None:
    rig, bus = two_axes()
    rig.look_after(written((2, Row(TIMER, 0, 20)), (32, Row(PRODUCER, 0, 50))))
    rig.start()
    assert bus.accepted is not None
    assert {0x581, 0x582, 0x5A0} <= bus.accepted
    nodes = {0x602: (TIMER, 20), 0x620: (PRODUCER, 50)}

    def run(first: int) -> None:
        for number in range(first, first + 400):
            del bus.sent[:]
            rig.read_back(100.0 + 1e-3 * number)
            for can_id, data in bus.sent:
                entry, value = nodes.get(can_id, (None, 0))
                if entry is not None and data[1:4] == struct.pack("<HB", *entry.key):
                    bus.waiting.append((can_id - 0x80, answer(entry, value)))
                else:  # the drives are asked for the command that they heard, too
                    assert data[1:4] == b"\x71\x60\x00"
                    bus.waiting.append((can_id - 0x80, struct.pack("<BHBHxx", 0x4B, 0x6071, 0, 0)))
            cycle(rig, bus)

    run(0)
    assert [axis.image.altered for axis in rig.axes] == [None, None]
    assert min(axis.hearing.asked for axis in rig.axes) > 5
    nodes[0x602] = (TIMER, 0)
    run(400)
    assert rig.axes[0].image.altered is None
    assert rig.axes[1].image.altered == "drive node 2: 0x1400:5 RPDO event timer is 0x0, at the start it was 0x14"
    nodes[0x620] = (PRODUCER, 0)
    run(800)
    assert (
        rig.axes[0].image.altered
        == "joint encoder node 32: 0x1017:0 heartbeat producer is 0x0, at the start it was 0x32"
    )


def test_how_many_commands_may_be_lost_is_the_settings_at_the_bus_own_rate() -> None:
    rig, _ = two_axes(settings=BusSettings(bitrate=500_000, supervision=SupervisionSettings(lost_share=0.5)))
    rig.look_after(written((1, Row(TIMER, 0, 20))))
    assert [axis.hearing.too_many for axis in rig.axes] == [7, 7]


def test_where_nothing_was_written_or_it_stands_off_nothing_is_read_back() -> None:
    rig, bus = two_axes()
    rig.look_after(written())
    rig.start()
    assert bus.accepted is not None
    assert not bus.accepted & {0x581, 0x582}
    rig.read_back(100.0)
    assert bus.sent == []
    rig.look_after(written((1, Row(TIMER, 0, 20))))
    rig.start()
    rig.read_back(100.0)
    assert [can_id for can_id, _ in bus.sent] == [0x601]
    rig.stand_off()
    rig.read_back(101.0)
    bus.waiting.append((0x581, answer(TIMER, 0)))
    cycle(rig, bus)
    assert len(bus.sent) == 2  # the SYNC
    assert rig.axes[0].image.altered is None
