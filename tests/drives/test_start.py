"""The start on drives that do otherwise: it works, or is refused with the line that mends it."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tests.drives.rig import PERIOD, Foreign, refused
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.profile import DriveProfile, ExtraWrite, Identity
from tsa_ctrl.plant.dictionary import Entry, Type
from tsa_ctrl.safety.supervisor import Phase, Request

RPDO, NMT, SYNC, HEARTBEAT = 0x201, 0x000, 0x080, 0x77F


def busy(foreign: Foreign, *frames: tuple[int, bytes]) -> None:
    """Another master's frames, every 20 ms."""

    def again(now: float) -> None:
        for frame in frames:
            foreign.wire.host.arrived(*frame)
        foreign.wire.at(now + 0.02, again)

    foreign.wire.at(foreign.wire.now + 0.01, again)


@pytest.mark.parametrize("frame", [(0x77F, b"\x05"), (0x000, b"\x01\x00"), (0x201, bytes(4)), (0x605, bytes(8))])
def test_a_start_beside_another_master_sends_nothing(tmp_path: Path, frame: tuple[int, bytes]) -> None:
    foreign = Foreign(tmp_path)
    busy(foreign, frame)
    with refused(f"another master is active (heard its frames 0x{frame[0]:03X}); nothing was sent"):
        foreign.start()
    assert foreign.sent() == []


def test_a_wrong_device_gets_nothing_but_questions(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path)
    with refused("vendor is 0x00000F0F, wanted is 0x000000FB"):
        foreign.start(DriveProfile(identity=Identity(vendor_id=0xFB)))
    assert foreign.commands() == []


def test_a_wrong_serial_number_is_another_drive(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "serial_number = 78")
    with refused("serial number is 0x0000004E, wanted is 0x0000004D", "correct node_id, serial_number"):
        foreign.start(serial_number=77)
    assert foreign.commands() == []
    foreign.start(serial_number=78)


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


def test_after_an_orderly_stop_nobody_is_watched_any_more(tmp_path: Path) -> None:
    """A drive that takes 0x6007 = 1 literally is not in fault at the next start."""
    foreign = Foreign(tmp_path, "watches_always = true")
    for _ in range(2):
        report = foreign.start()
        assert not [note for node in report.nodes for note in node.notes if "fault" in note or "EMCY" in note]
        foreign.enable(0.2)
        assert foreign.stop() == []
        assert foreign.node.values[0x1016, 1] == 0
        foreign.wait(2.0)
        assert foreign.drive.machine.state.name == "SWITCH_ON_DISABLED"


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


@pytest.mark.parametrize(("shows", "first"), [("operational", "written"), ("enabled", "operational")])
def test_a_mode_that_shows_late_needs_a_line_of_the_profile(tmp_path: Path, shows: str, first: str) -> None:
    foreign = Foreign(tmp_path, f"mode_shows = '{shows}'")
    with refused("0x6061) is 0, wanted is 10", 'mode_shows = "operational" or "enabled" in'):
        foreign.start()
    foreign.start(DriveProfile(mode_shows=shows))  # type: ignore[arg-type]
    foreign.enable(0.3)
    assert foreign.drive.command.torque == pytest.approx(0.3)


def test_torque_stays_zero_until_the_mode_shows(tmp_path: Path) -> None:
    """Enabled at the drive, but not yet for the supervisor: not one command has torque."""
    foreign = Foreign(tmp_path, "mode_shows = 'enabled'")
    foreign.start(DriveProfile(mode_shows="enabled"))
    foreign.drive.faults.wrong_mode = 0
    with pytest.raises(AssertionError, match="operation_enabled after 2 s, in mode 0, wanted is 10"):
        foreign.enable(0.3)
    assert {data[2:] for _, data in foreign.sent(RPDO)} == {bytes(2)}


def test_a_sync_counter_of_another_tool_is_cleared(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "objects = { '0x1019:0' = 10, '0x1006:0' = 5000, '0x1007:0' = 100 }")
    foreign.start()
    assert [foreign.node.values[index, 0] for index in (0x1006, 0x1007, 0x1019)] == [0, 0, 0]


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


def test_an_emcy_at_boot_is_told_and_tolerated(tmp_path: Path) -> None:
    report = Foreign(tmp_path, "emcy_at_boot = 0x8100").start()
    assert [note for note in report.nodes[0].notes if "said during the bring-up: EMCY 0x8100" in note]


def test_a_slow_boot_is_told_apart_from_a_dead_wire(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "boot_time = 3.5")
    with refused("no answer from", "within 3 s (heard: no node); check power,", "more boot_timeout"):
        foreign.start()
    foreign.wait(5.0)
    with refused("answered before it was reset, and did not boot up within 3 s; it is slow:", "boot_timeout"):
        foreign.start()
    foreign.wait(5.0)
    foreign.start(boot_timeout=4.0)


@pytest.mark.slow
def test_slow_answers_need_patience(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "answer_time = 0.7")
    with refused("within 0.5 s;", "a slow one needs more answer_timeout"):
        foreign.start()
    foreign.wait(5.0)
    foreign.bring_up(answer_timeout=1.0)


@pytest.mark.slow
def test_answers_after_two_fifths_of_a_second_are_tolerated(tmp_path: Path) -> None:
    Foreign(tmp_path, "answer_time = 0.4").start()


def test_a_mapping_that_cannot_be_written_is_left_alone_when_it_is_right(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "fixed_mapping = true")
    foreign.start()
    foreign.enable(0.3)
    assert foreign.drive.command.torque == pytest.approx(0.3)


def test_a_mapping_that_cannot_be_written_and_is_wrong_is_refused_with_the_cure(tmp_path: Path) -> None:
    with refused("refuses 0x1600:0", "map this PDO so with the maker's tool"):
        Foreign(tmp_path, "read_only = ['0x1600']").start()


@pytest.mark.parametrize("entry", [1, 2, 4])
def test_the_consumer_entry_that_has_our_id_is_used(tmp_path: Path, entry: int) -> None:
    foreign = Foreign(tmp_path, f"objects = {{ '0x1016:{entry}' = 0x7F0400 }}")
    foreign.start()
    values = [foreign.node.values[0x1016, number] for number in range(1, 5)]
    assert values == [0x7F0064 if number == entry else 0 for number in range(1, 5)]


def test_a_consumer_entry_of_another_node_is_left_alone(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "objects = { '0x1016:1' = 0x0503E8 }")
    foreign.start()
    assert [foreign.node.values[0x1016, number] for number in (1, 2)] == [0x0503E8, 0x7F0064]


def test_read_only_objects_whose_value_does_as_well_are_forgiven(tmp_path: Path) -> None:
    report = Foreign(tmp_path, "read_only = ['0x605A', '0x605E', '0x6007', '0x1029:1']").start()
    forgiven = [note for note in report.nodes[0].notes if "cannot be written" in note]
    assert forgiven == [
        "0x605A:0 quick stop reaction cannot be written; its 0x2 does as well",
        "0x605E:0 fault reaction cannot be written; its 0x2 does as well",
    ]


@pytest.mark.parametrize(
    ("quirk", "line"),
    [
        ("absent = [0x6072]", 'absent = ["max torque"] and [torque_clamp]'),
        ("absent = [0x60A9]", 'absent = ["SI unit velocity"]'),
        ("absent = [0x6080]", 'absent = ["max motor speed"]'),
        ("absent = [0x1017]", 'supervision = "guarding"'),
        ("read_only = ['0x6007']\ndrive.objects = { '0x6007:0' = 0 }", 'absent = ["reaction to a lost connection"]'),
        ("read_only = ['0x1016']", 'absent = ["heartbeat consumer"]'),
        ("read_only = ['0x1400:5']", 'absent = ["RPDO event timer"]'),
        ("read_only = ['0x60C2:2']\ndrive.objects = { '0x60C2:2' = -4 }", "a rate in [controller]"),
        ("read_only = ['0x1014']\ndrive.objects = { '0x1014:0' = 0x91 }", 'absent = ["EMCY COB-ID"]'),
        ("read_only = ['0x1401:1']\ndrive.objects = { '0x1401:1' = 0x301 }", "rpdo_count = 1"),
        ("modes = ['csp', 'csv']", "cyclic position and cyclic velocity, but this controller commands torque"),
    ],
)
def test_every_refusal_names_the_line_that_mends_it(tmp_path: Path, quirk: str, line: str) -> None:
    foreign = Foreign(tmp_path, quirk)
    with refused(line):
        foreign.start()
    assert foreign.sent(RPDO) == []


def test_emcys_come_where_they_are_looked_for(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "objects = { '0x1014:0' = 0x80000091 }")
    foreign.start()
    assert foreign.node.values[0x1014, 0] == 0x81


def test_a_drive_that_makes_sync_is_told_apart_and_told_to_stop(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "sync_producer = true")
    foreign.wait(0.1)
    with refused("somebody sends SYNC (0x080),", "produces_sync = true into that drive's profile"):
        foreign.start()
    assert foreign.sent() == []
    foreign.start(DriveProfile(produces_sync=True))
    foreign.enable(0.2)


@pytest.mark.parametrize("device_type", [0x0000FFFF, 0xFFFF0192])
def test_a_device_of_several_axes_is_taken(tmp_path: Path, device_type: int) -> None:
    Foreign(tmp_path, f"objects = {{ '0x1000:0' = {device_type} }}").start()


def test_node_guarding_in_place_of_heartbeats(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "node_guarding = true")
    foreign.start(DriveProfile(supervision="guarding"))
    foreign.enable(0.3)
    assert foreign.rig is not None
    image = foreign.rig.axes[0].image
    assert image.now - image.nodes[0].heard < 0.1
    foreign.wait(0.2)
    assert foreign.drive.machine.state.name == "FAULT"  # nobody asked for 100 ms


def test_a_toggle_bit_that_stays_is_a_lost_drive(tmp_path: Path) -> None:
    """A drive that repeats one answer to node guarding may have stopped working behind it."""
    foreign = Foreign(tmp_path, "node_guarding = true")
    foreign.start(DriveProfile(supervision="guarding"))
    foreign.enable(0.3)
    assert foreign.node.guarding is not None
    foreign.node.guarding.toggles = False
    with pytest.raises(
        AssertionError, match=r"heartbeat lost: drive node 1: none for 20\d ms; \d+ answers to node gua"
    ):
        foreign.run(Request.ENABLE, Phase.STANDBY, 0.3)


def test_an_inhibit_time_of_emergencies_is_cleared(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "objects = {'0x1015:0' = 5000}")
    foreign.start()
    assert foreign.node.values[0x1015, 0] == 0


def test_an_inhibit_time_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "objects = {'0x1015:0' = 5000}", "read_only = ['0x1015']")
    (note,) = [note for node in foreign.start().nodes for note in node.notes]
    assert note == "0x1015:0 inhibit time EMCY cannot be written; its 0x1388 does as well"


VALUES = (  # type, value as a person writes it, bytes in the drive
    ("bool", True, "01"), ("i24", -2, "feffff"), ("u24", 0xABCDEF, "efcdab"), ("i40", -1, "ffffffffff"),
    ("u48", 1 << 47, "000000000080"), ("u56", 5, "05000000000000"), ("i64", -(1 << 63), "0000000000000080"),
    ("u64", (1 << 64) - 1, "ffffffffffffffff"), ("f32", 0.1, "cdcccc3d"), ("f32", 2, "00000040"),
    ("f64", -0.1, "9a9999999999b9bf"),
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


def test_after_an_orderly_stop_nobody_is_guarded_any_more(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "node_guarding = true", "watches_always = true")
    foreign.start(DriveProfile(supervision="guarding"))
    assert foreign.stop() == []
    foreign.wait(1.0)
    assert foreign.drive.machine.state.name == "SWITCH_ON_DISABLED"


def test_nothing_is_ever_stored_in_the_drive(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path)
    foreign.start()
    foreign.enable(0.1)
    foreign.stop()
    assert foreign.node.storage.saves == 0
    assert not [data for can_id, data in foreign.sent(0x601) if data[1:3] in (b"\x10\x10", b"\x11\x10")]


def test_what_the_start_waits_for_is_told(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path)
    stages: list[str] = []
    bring_up(foreign.wire.host, foreign.settings, [foreign.axis], [foreign.profile], PERIOD, tell=stages.append)
    assert stages == [
        "listening for another master on the bus",
        "asking axis 'knee' drive node 1 who it is",
        "waiting for the boot-up of axis 'knee' drive node 1, 3 s at most",
        "configuring axis 'knee' drive node 1",
        "waiting for axis 'knee' drive node 1 to become operational",
    ]


def test_a_fault_found_at_the_start_says_what_becomes_of_it(tmp_path: Path) -> None:
    for resets, words in ((False, "must be reset before it can enable: --reset-faults"), (True, "it is reset now")):
        foreign = Foreign(tmp_path)
        foreign.drive.fault(0x2310)
        foreign.wait(0.1)
        report = bring_up(
            foreign.wire.host, foreign.settings, [foreign.axis], [foreign.profile], PERIOD, resets_later=resets
        )
        assert [note for note in report.nodes[0].notes if note.startswith("in fault: error 0x2310") and words in note]
