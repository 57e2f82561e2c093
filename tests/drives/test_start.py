"""Startup of drives that deviate from the standard.

The startup succeeds, or its error contains the remedy.
"""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tests.drives.rig import PERIOD, Foreign, refused
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.profile import DriveProfile, ExtraWrite
from tsa_ctrl.plant.dictionary import Entry, Type
from tsa_ctrl.safety.causes import Cause
from tsa_ctrl.safety.supervisor import Phase, Request

RPDO, NMT, SYNC, HEARTBEAT = 0x201, 0x000, 0x080, 0x77F


def busy(foreign: Foreign, *frames: tuple[int, bytes]) -> None:
    """Send these frames of another master every 20 ms."""

    def again(now: float) -> None:
        for frame in frames:
            foreign.wire.host.arrived(*frame)
        foreign.wire.at(now + 0.02, again)

    foreign.wire.at(foreign.wire.now + 0.01, again)


@pytest.mark.parametrize("frame", [(0x77F, b"\x05"), (0x000, b"\x01\x00"), (0x201, bytes(4)), (0x605, bytes(8))])
def test_a_start_beside_another_master_sends_nothing(tmp_path: Path, frame: tuple[int, bytes]) -> None:
    foreign = Foreign(tmp_path)
    busy(foreign, frame)
    with refused(f"another master is active (heard 0x{frame[0]:03X}); nothing was sent"):
        foreign.start()
    assert foreign.sent() == []


def test_a_failure_in_the_middle_is_answered_by_nmt_and_never_by_an_rpdo(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "read_only = ['0x6080']")
    with refused('write absent = ["max motor speed"]'):
        foreign.start()
    assert foreign.sent(RPDO, SYNC) == []
    assert foreign.sent(NMT)[-1] == (NMT, b"\x80\x01")
    assert foreign.node.values[0x1016, 1] & 0xFFFF == 0
    assert foreign.node.state.name == "PRE_OPERATIONAL"
    foreign.wait(1.0)
    assert foreign.drive.machine.state.name == "SWITCH_ON_DISABLED"


def test_a_drive_found_enabled_is_switched_off_before_its_watchdogs_are_reset(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "watchdogs = false")
    foreign.start()
    foreign.enable(0.3)
    foreign.wire.sent.clear()
    foreign.bring_up()
    writes = [(can_id, data) for can_id, data in foreign.commands() if can_id in (NMT, 0x601)]
    assert writes[0] == (0x601, struct.pack("<BHBI", 0x2B, 0x6040, 0, 0))
    assert (NMT, b"\x82\x01") in writes[1:]


def test_a_drive_that_is_not_off_goes_on_watching(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "absent = ['0x1400:5']")
    foreign.start()
    foreign.enable(0.2)
    foreign.node.deaf = True
    (line,) = foreign.stop()
    assert "did not confirm" in line
    foreign.wait(0.2)
    assert foreign.node.values[0x1016, 1] & 0xFFFF == 100
    assert foreign.drive.machine.state.name == "FAULT"


def test_torque_stays_zero_until_the_mode_shows(tmp_path: Path) -> None:
    """The drive is enabled but still reports mode 0. No RPDO commands a torque."""
    foreign = Foreign(tmp_path, "mode_shows = 'enabled'")
    foreign.start(DriveProfile(mode_shows="enabled"))
    foreign.drive.faults.wrong_mode = 0
    with pytest.raises(AssertionError, match="operation_enabled after 2 s, in mode 0 instead of 10"):
        foreign.enable(0.3)
    assert {data[2:] for _, data in foreign.sent(RPDO)} == {bytes(2)}


def test_a_power_cycle_latches_and_only_a_bring_up_with_a_reset_leads_back(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path)
    foreign.start()
    foreign.enable(0.1)
    foreign.node.power_off()
    foreign.run(Request.ENABLE, Phase.FAULT, 0.1)
    foreign.node.boot(foreign.wire.now)
    foreign.cycle(Request.ENABLE, 0.1, cycles=100)
    assert foreign.supervisor.needs_bring_up
    assert {fault.cause for fault in foreign.supervisor.faults} & {Cause.HEARTBEAT_LOST, Cause.BOOT_UP}
    foreign.cycle(Request.RESET, 0.1, cycles=20)
    assert foreign.supervisor.phase is Phase.FAULT
    foreign.bring_up()
    assert foreign.rig is not None
    foreign.rig.start()
    foreign.supervisor.configured(foreign.rig.axes[0].image)
    foreign.cycle(Request.DISABLE)
    foreign.run(Request.RESET, Phase.STANDBY)
    foreign.enable(0.1)
    assert foreign.drive.command.torque == pytest.approx(0.1)


def test_a_drive_may_need_the_sync_period(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "objects = { '0x1019:0' = 10 }")
    foreign.start(DriveProfile(needs_sync_period=True))
    assert (foreign.node.values[0x1006, 0], foreign.node.values[0x1019, 0]) == (2000, 0)


def test_what_the_drive_said_ends_every_message(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "emcy_at_boot = 0x3220", "read_only = ['0x6080']")
    with refused("; meanwhile axis 'knee' drive node 1 sent EMCY 0x3220 (DC link under-voltage"):
        foreign.start()


def test_what_the_drive_said_is_in_the_message_of_the_proof(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "objects = { '0x1019:0' = 10 }", "read_only = ['0x1019']")
    with refused("0x1019:0 SYNC counter", 'write absent = ["SYNC counter"]'):
        foreign.start()
    with refused("answered 0 of 50 SYNCs in time", "; it sent EMCY 0x8240 (unexpected SYNC data length"):
        foreign.start(DriveProfile(absent=["SYNC counter"]))


@pytest.mark.parametrize(("entry", "left", "ours"), [(1, 0x7F0400, 1), (4, 0x7F0400, 4), (1, 0x0503E8, 2)])
def test_the_consumer_entry_of_our_id_is_used_and_that_of_another_node_is_left_alone(
    tmp_path: Path, entry: int, left: int, ours: int
) -> None:
    foreign = Foreign(tmp_path, f"objects = {{ '0x1016:{entry}' = {left} }}")
    foreign.start()
    values = {number: foreign.node.values[0x1016, number] for number in range(1, 5)}
    assert values == dict.fromkeys(range(1, 5), 0) | {entry: left} | {ours: 0x7F0064}


def test_read_only_objects_whose_value_does_as_well_are_forgiven(tmp_path: Path) -> None:
    quirks = ("read_only = ['0x605A', '0x605E', '0x6007', '0x1029:1', '0x1015']", "objects = {'0x1015:0' = 5000}")
    assert [note for node in Foreign(tmp_path, *quirks).start().nodes for note in node.notes] == [
        f"{name} cannot be written; its value {value} is also sufficient"
        for name, value in (
            ("0x1015:0 inhibit time EMCY", "0x1388"),
            ("0x605A:0 quick stop reaction", "0x2"),
            ("0x605E:0 fault reaction", "0x2"),
        )
    ]


def test_a_toggle_bit_that_stays_is_a_lost_drive(tmp_path: Path) -> None:
    """A drive that repeats the same answer to node guarding may have stopped working.

    The supervisor reports a lost heartbeat.
    """
    foreign = Foreign(tmp_path, "node_guarding = true")
    foreign.start(DriveProfile(supervision="guarding"))
    foreign.enable(0.3)
    assert foreign.node.guarding is not None
    foreign.node.guarding.toggles = False
    with pytest.raises(
        AssertionError, match=r"heartbeat lost: drive node 1: none for 20\d ms; \d+ answers to node gua"
    ):
        foreign.run(Request.ENABLE, Phase.STANDBY, 0.3)


VALUES = (  # type, value in the profile, bytes in the drive
    ("bool", True, "01"), ("i24", -2, "feffff"), ("u64", (1 << 64) - 1, "ffffffffffffffff"),
    ("f32", 0.1, "cdcccc3d"), ("f64", -0.1, "9a9999999999b9bf"),
)  # fmt: skip


@pytest.mark.parametrize(("name", "value", "held"), VALUES)
def test_an_extra_object_of_every_basic_type_is_written_and_read_back(
    tmp_path: Path, name: str, value: float, held: str
) -> None:
    foreign = Foreign(tmp_path)
    foreign.node.dictionary.add(Entry(0x2100, 3, Type[name.upper()]))
    extra = ExtraWrite(index=0x2100, subindex=3, type=name, value=value, name="mine")  # type: ignore[arg-type]
    report = foreign.start(DriveProfile(extra=[extra]))
    assert foreign.node.dictionary.read((0x2100, 3)).hex() == held
    (row,) = [row for node in report.nodes for row in node.rows if row.entry.index == 0x2100]
    shown = f"{value:g}" if name[0] == "f" else f"{int(value):#x}"
    assert str(row) == f"0x2100:3 mine: {'0' if name[0] == 'f' else '0x0'} -> {shown}"


def test_a_fault_found_at_the_start_says_what_becomes_of_it(tmp_path: Path) -> None:
    for resets, words in (
        (False, "must be reset before it can be enabled: --reset-faults"),
        (True, "it will now be reset"),
    ):
        foreign = Foreign(tmp_path)
        foreign.drive.fault(0x2310)
        foreign.wait(0.1)
        report = bring_up(
            foreign.wire.host, foreign.settings, [foreign.axis], [foreign.profile], PERIOD, resets_later=resets
        )
        assert [note for note in report.nodes[0].notes if note.startswith("in fault: error 0x2310") and words in note]


def test_a_drive_whose_consumer_entries_are_all_taken_is_rejected(tmp_path: Path) -> None:
    """An entry for a node id above 127 is unused."""
    foreign = Foreign(tmp_path, "heartbeat_consumers = 1", "objects = { '0x1016:1' = 0x0503E8 }")
    with refused("0x1016:1 heartbeat consumer supervises node 5", 'absent = ["heartbeat consumer"]'):
        foreign.start()
    assert foreign.node.values[0x1016, 1] == 0x0503E8
    Foreign(tmp_path, "heartbeat_consumers = 1", "objects = { '0x1016:1' = 0x8003E8 }").start()
