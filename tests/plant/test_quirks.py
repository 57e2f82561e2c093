"""What drives do otherwise than the standard, one key each: literal frames."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.plant.bench import Bench

NO_OBJECT, NO_SUBINDEX, READ_ONLY = 0x06020000, 0x06090011, 0x06010002
INCOMPATIBLE, DEVICE_STATE, INVALID_VALUE = 0x06040043, 0x08000022, 0x06090030


def bench(folder: Path, *quirks: str) -> Bench:
    """A still joint without sensors, its drive with these keys."""
    lines = ["name = 'joint'", "motion.kind = 'still'", "encoder.present = false", "torque_sensor.present = false"]
    keys = [f"drive.{quirk}" for quirk in ("torque_noise = 0.0", *quirks)]
    return Bench(folder, "\n".join(["[[axis]]", *lines, *keys, ""]))


def watched(made: Bench) -> None:
    """Heartbeat consumer of 50 ms for node 127, and one heartbeat."""
    made.download(1, 0x1016, 1, "I", 127 << 16 | 50)
    made.send(0x77F, b"\x05")


def test_an_object_can_be_made_read_only(tmp_path: Path) -> None:
    made = bench(tmp_path, "read_only = ['0x6007', '0x60C2:1']")
    assert made.download(1, 0x6007, 0, "h", 1) == READ_ONLY
    assert made.download(1, 0x60C2, 1, "B", 2) == READ_ONLY
    assert made.download(1, 0x60C2, 2, "b", -3) == 0


def test_a_fixed_mapping_is_the_one_that_is_wanted(tmp_path: Path) -> None:
    made = bench(tmp_path, "fixed_mapping = true")
    assert made.download(1, 0x1A00, 0, "B", 0) == READ_ONLY
    assert [made.upload(1, 0x1A00, place, "I") for place in (1, 2, 3)] == [0x60410010, 0x60770010, 0x606C0020]
    assert [made.upload(1, 0x1600, place, "I") for place in (1, 2)] == [0x60400010, 0x60710010]


def test_there_may_be_one_heartbeat_consumer(tmp_path: Path) -> None:
    made = bench(tmp_path, "heartbeat_consumers = 1")
    assert made.upload(1, 0x1016, 0, "B") == 1
    assert made.download(1, 0x1016, 2, "I", 0) == NO_SUBINDEX


def test_one_node_has_one_entry_of_the_heartbeat_consumer(tmp_path: Path) -> None:
    made = bench(tmp_path, "objects = { '0x1016:2' = 0x7F0064 }")
    assert made.download(1, 0x1016, 1, "I", 127 << 16 | 50) == INCOMPATIBLE
    assert made.download(1, 0x1016, 2, "I", 127 << 16 | 50) == 0


def test_the_modes_are_those_that_0x6502_says(tmp_path: Path) -> None:
    made = bench(tmp_path, "modes = ['csp', 'csv']")
    assert made.upload(1, 0x6502, 0, "I") == 0b1_1000_0000
    assert made.download(1, 0x6060, 0, "b", 10) == INVALID_VALUE
    assert made.download(1, 0x6060, 0, "b", 9) == 0


def test_a_slow_start_answers_nothing_before_its_boot_up(tmp_path: Path) -> None:
    made = bench(tmp_path, "boot_time = 3.5")
    assert made.send(0x601, bytes.fromhex("4000100000000000")) == []
    assert made.wait(3.4) == []
    assert made.wait(0.2) == [(0x701, b"\x00")]


def test_a_node_may_start_itself(tmp_path: Path) -> None:
    made = bench(tmp_path, "starts_itself = true", "emcy_at_boot = 0x8100")
    assert made.bus.sent == [(0x701, b"\x00"), (0x081, bytes.fromhex("0081110000000000"))]
    assert (0x181, b"\xd0\x02") in made.wait(0.005)


def test_an_answer_takes_its_time(tmp_path: Path) -> None:
    made = bench(tmp_path, "answer_time = 0.4")
    assert made.send(0x601, bytes.fromhex("4000100000000000")) == []
    assert made.wait(0.39) == []
    assert made.wait(0.02) == [(0x581, bytes.fromhex("4300100092010200"))]


def test_a_sync_producer_sends_until_it_is_told_not_to(tmp_path: Path) -> None:
    made = bench(tmp_path, "sync_producer = true")
    assert len([1 for can_id, _ in made.wait(0.1) if can_id == 0x080]) in (9, 10, 11)
    assert made.download(1, 0x1005, 0, "I", 0x80) == 0
    assert made.wait(0.1) == []


def test_a_disabled_drive_may_fault_when_the_heartbeat_is_lost(tmp_path: Path) -> None:
    for quirks, state in (([], 0x40), (["watches_always = true"], 0x08)):
        made = bench(tmp_path, *quirks)
        watched(made)
        made.wait(0.06)
        assert made.upload(1, 0x6041, 0, "H") & 0x4F == state


def test_an_rpdo_timer_may_act_only_on_sync(tmp_path: Path) -> None:
    made = bench(tmp_path, "rpdo_timer_on_sync = true")
    made.set_up()
    made.download(1, 0x1400, 5, "H", 20)
    made.enable(500)
    made.wait(0.1)
    assert made.unit.drive.machine.state.name == "OPERATION_ENABLED"
    made.sync(1)
    assert made.unit.drive.machine.state.name == "FAULT_REACTION_ACTIVE"


def test_node_guarding_answers_remote_frames_with_a_toggle_bit(tmp_path: Path) -> None:
    made = bench(tmp_path, "node_guarding = true")
    assert made.download(1, 0x1017, 0, "H", 50) == NO_OBJECT
    assert made.download(1, 0x1016, 1, "I", 0) == NO_OBJECT
    remote = 0x40000701
    assert [made.send(remote) for _ in range(3)] == [[(0x701, b"\x7f")], [(0x701, b"\xff")], [(0x701, b"\x7f")]]


def test_the_inhibit_time_keeps_emergencies_apart(tmp_path: Path) -> None:
    made = bench(tmp_path, "objects = {'0x1015:0' = 500}")
    made.wait(0.1)
    node = made.unit.by_kind["drive"]
    for code in (0x2310, 0x3210, 0x0000):
        node.emergency(code, 0)
    frames = [made.wait(0.01) for _ in range(20)]
    times = [n for n, heard in enumerate(frames) for can_id, _ in heard if can_id == 0x081]
    assert times == [4, 9]  # 50 ms each; the first came at once


def test_life_guarding_takes_the_torque_when_nobody_asks(tmp_path: Path) -> None:
    made = bench(tmp_path, "node_guarding = true")
    made.set_up()
    made.download(1, 0x100C, 0, "H", 20)
    made.download(1, 0x100D, 0, "B", 3)
    made.send(0x40000701)
    made.enable(500)
    made.sync(40, made.command(0x0F, 500))
    assert made.unit.drive.machine.state.name == "OPERATION_ENABLED"
    made.sync(30, made.command(0x0F, 500))
    assert made.unit.drive.machine.state.name in ("FAULT", "FAULT_REACTION_ACTIVE")


def test_the_mode_may_show_late(tmp_path: Path) -> None:
    for when, shown in (("written", [10, 10, 10]), ("operational", [0, 10, 10]), ("enabled", [0, 0, 10])):
        made = bench(tmp_path, f"mode_shows = '{when}'")
        made.download(1, 0x6060, 0, "b", 10)
        seen = [made.upload(1, 0x6061, 0, "b")]
        made.set_up()
        seen.append(made.upload(1, 0x6061, 0, "b"))
        made.enable()
        seen.append(made.upload(1, 0x6061, 0, "b"))
        assert seen == shown


def test_slow_steps_are_taken_one_after_the_other(tmp_path: Path) -> None:
    made = bench(tmp_path, "step_time = 0.4")
    made.set_up()
    made.sync(2, made.command(0x06))
    made.sync(2, made.command(0x07))
    assert made.statusword() & 0x6F == 0x21
    made.sync(400, made.command(0x07))
    assert made.statusword() & 0x6F == 0x23
    made.sync(2, made.command(0x00))
    assert made.statusword() & 0x4F == 0x40  # off at once


def test_bits_of_the_maker_stand_in_the_statusword(tmp_path: Path) -> None:
    made = bench(tmp_path, "statusword_bits = 0xC100", "reports_following = false")
    made.set_up()
    made.enable()
    assert made.statusword() == 0xC337


def test_safe_torque_off_keeps_the_drive_disabled(tmp_path: Path) -> None:
    made = bench(tmp_path, "safe_torque_off = true")
    made.set_up()
    made.enable(500)
    assert made.statusword() == 0x0240  # bit 4: no voltage
    assert made.unit.axis.command.torque == 0.0


def test_a_warning_is_no_fault(tmp_path: Path) -> None:
    made = bench(tmp_path, "warns_when_enabled = 0x2310")
    made.set_up()
    made.enable()
    assert (0x081, bytes.fromhex("1023210000000000")) in made.bus.sent
    assert made.unit.drive.machine.state.name == "OPERATION_ENABLED"


def test_a_sync_counter_that_another_tool_left(tmp_path: Path) -> None:
    made = bench(tmp_path, "objects = { '0x1019:0' = 10, '0x1006:0' = 1000 }")
    made.set_up()
    assert (0x081, bytes.fromhex("4082110000000000")) in made.send(0x80)
    assert not any(can_id == 0x181 for can_id, _ in made.sync())
    assert made.download(1, 0x1019, 0, "B", 0) == DEVICE_STATE  # first the period
    assert made.download(1, 0x1006, 0, "I", 0) == 0
    assert made.download(1, 0x1019, 0, "B", 0) == 0
    assert any(can_id == 0x181 for can_id, _ in made.sync())


def test_a_sync_window_drops_late_commands(tmp_path: Path) -> None:
    made = bench(tmp_path, "objects = { '0x1007:0' = 500 }")
    made.set_up()
    made.sync(1)
    made.wait(1e-3)
    made.send(0x201, made.command(0x06))
    made.sync(1)
    assert made.upload(1, 0x6040, 0, "H") == 0


def test_emcys_go_where_0x1014_says(tmp_path: Path) -> None:
    made = bench(tmp_path, "objects = { '0x1014:0' = 0x80000081 }")
    before = len(made.bus.sent)
    made.unit.drive.node.emergency(0x4310, 0x08)
    assert made.bus.sent[before:] == []
    assert made.download(1, 0x1014, 0, "I", 0x91) == 0
    made.unit.drive.node.emergency(0x4310, 0x08)
    assert made.bus.sent[-1][0] == 0x91


@pytest.mark.parametrize("value", [0, 0x64616F6C])
def test_parameters_are_stored_only_with_the_right_word(tmp_path: Path, value: int) -> None:
    made = bench(tmp_path)
    assert made.download(1, 0x1010, 1, "I", value) == 0x08000020
    assert made.unit.drive.node.storage.saves == 0


def test_stored_parameters_survive_a_reset_until_the_defaults_are_loaded(tmp_path: Path) -> None:
    made = bench(tmp_path)
    made.download(1, 0x6072, 0, "H", 123)
    made.download(1, 0x1017, 0, "H", 40)
    assert made.download(1, 0x1010, 1, "I", 0x65766173) == 0
    made.send(0x000, b"\x81\x01")
    assert (made.upload(1, 0x6072, 0, "H"), made.upload(1, 0x1017, 0, "H")) == (123, 40)
    assert made.download(1, 0x1011, 1, "I", 0x64616F6C) == 0
    assert made.upload(1, 0x6072, 0, "H") == 123
    made.send(0x000, b"\x81\x01")
    assert (made.upload(1, 0x6072, 0, "H"), made.upload(1, 0x1017, 0, "H")) == (1000, 0)


def test_a_drive_without_an_id_is_given_one_by_lss(tmp_path: Path) -> None:
    made = bench(tmp_path, "node_id_unset = true", "serial_number = 77")
    assert made.bus.sent == []
    assert made.wait(0.1) == []
    made.send(0x7E5, bytes.fromhex("0401000000000000"))
    assert made.send(0x7E5, bytes.fromhex("5d00000000000000")) == [(0x7E4, bytes.fromhex("5d4d000000000000"))]
    assert made.send(0x7E5, bytes.fromhex("1105000000000000")) == [(0x7E4, bytes.fromhex("1100000000000000"))]
    assert made.send(0x7E5, bytes.fromhex("1700000000000000")) == [(0x7E4, bytes.fromhex("1700000000000000"))]
    assert made.send(0x7E5, bytes.fromhex("0400000000000000")) == [(0x705, b"\x00")]
    assert made.upload(5, 0x1800, 1, "I") == 0x40000185


def test_lss_selects_by_the_whole_identity(tmp_path: Path) -> None:
    made = bench(tmp_path, "node_id_unset = true", "serial_number = 77")
    for command, value in ((0x40, 0x0F0F), (0x41, 0x0402), (0x42, 0x10000), (0x43, 78)):
        assert made.send(0x7E5, bytes((command,)) + value.to_bytes(4, "little") + bytes(3)) == []
    for command, value in ((0x40, 0x0F0F), (0x41, 0x0402), (0x42, 0x10000)):
        made.send(0x7E5, bytes((command,)) + value.to_bytes(4, "little") + bytes(3))
    assert made.send(0x7E5, bytes((0x43, 77)) + bytes(6)) == [(0x7E4, bytes((0x44,)) + bytes(7))]


def test_two_axes_share_a_device(tmp_path: Path) -> None:
    first, second = (f"[[axis]]\nname = '{name}'\nmotion.kind = 'still'\ndrive.node_id = 1\n" for name in "ab")
    text = f"{first}{second}drive.slot = 2\n"
    made = Bench(tmp_path, text)
    assert [frame for frame in made.bus.sent if frame[0] == 0x701] == [(0x701, b"\x00")]
    assert made.upload(1, 0x1000, 0, "I") == 0xFFFF0192
    assert made.upload(1, 0x6FFF, 0, "I") & 0xFFFF == 0x0192
    made.map_pdo(1, 0x1440, 0x301, 1, 0x68400010, 0x68710010)
    assert made.download(1, 0x6860, 0, "b", 10) == 0
    made.send(0x000, b"\x01\x01")
    for controlword in (0x06, 0x07, 0x0F):
        made.sync(1)
        made.send(0x301, made.command(controlword, 200))
    made.sync(2)
    states = [unit.drive.machine.state.name for unit in made.machine.axes]
    assert states == ["SWITCH_ON_DISABLED", "OPERATION_ENABLED"]
    assert made.machine.axes[1].axis.command.torque == pytest.approx(0.2)
