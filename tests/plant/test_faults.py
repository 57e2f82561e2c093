"""Test the faults of the simulated machine: their effect on the bus and on the truth."""

from __future__ import annotations

import dataclasses
import itertools
import re
import struct
from pathlib import Path

import pytest

from tests.plant.bench import Bench, plant_file, tpdo1
from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.faults import CHANGES, FAULTS, parse_fault
from tsa_ctrl.plant.process import Console, ControlSocket, ask, check

STILL = "[[axis]]\nname = 'joint'\ndrive.torque_noise = 0.0\nmotion.kind = 'still'\n"


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    bench = Bench(tmp_path, STILL)
    bench.set_up()
    bench.enable(300)
    bench.sync(20)
    return bench


def begin(bench: Bench, text: str) -> None:
    axis, fault = parse_fault(text)
    bench.machine.begin_fault(axis, fault, bench.clock.now)


def test_power_cycle_boots_again_without_torque(bench: Bench) -> None:
    begin(bench, "power_cycle duration=0.05")
    assert bench.sync() == []
    assert bench.unit.axis.command.enabled is False
    assert [can_id for can_id, data in bench.wait(0.06) if data == b"\x00"] == [0x701, 0x720, 0x740]


def test_fault_is_announced_and_stays_for_its_duration(bench: Bench) -> None:
    begin(bench, "fault value=12816 duration=0.1")
    assert bench.bus.sent[-1] == (0x081, bytes.fromhex("1032210000000000"))
    bench.wait(0.02)
    bench.sync(3, bench.command(0x80))
    assert bench.statusword() == 0x0218
    bench.wait(0.1)
    bench.sync(2, bench.command(0x00))
    bench.sync(2, bench.command(0x80))
    assert bench.statusword() == 0x0250


def test_a_torque_offset_of_another_tool_turns_the_motor_for_its_duration(bench: Bench) -> None:
    begin(bench, "torque_offset value=120 duration=0.05")
    bench.sync(10, bench.command(0x0F, 0))
    assert bench.unit.axis.command.torque == pytest.approx(0.12)
    bench.sync(60, bench.command(0x0F, 0))
    assert bench.unit.axis.command.torque == 0.0


def test_stuck_tpdos_repeat_their_data(bench: Bench) -> None:
    before = dict(bench.sync())[0x181]
    begin(bench, "stuck_tpdo")
    bench.sync(10, bench.command(0x0F, -200))
    assert dict(bench.sync())[0x181] == before


def test_repeated_missing_short_and_late_tpdos(bench: Bench) -> None:
    begin(bench, "repeated_tpdo duration=0.001")
    assert [can_id for can_id, _ in bench.sync()].count(0x181) == 2
    bench.wait(0.002)
    begin(bench, "missing_tpdo duration=0.001")
    assert 0x181 not in dict(bench.sync())
    bench.wait(0.002)
    begin(bench, "wrong_length duration=0.001")
    assert len(dict(bench.sync())[0x181]) == 3
    bench.wait(0.002)
    begin(bench, "late_tpdo value=0.003")
    assert 0x181 not in dict(bench.sync())
    assert 0x181 in dict(bench.wait(0.004))


def test_wrong_mode_and_ignored_command(bench: Bench) -> None:
    begin(bench, "wrong_mode")
    assert struct.unpack_from("<b", dict(bench.sync())[0x281], 4)[0] == 8
    begin(bench, "ignored_command")
    bench.sync(20, bench.command(0x0F, 300))
    assert tpdo1(bench.sync())[:2] == (0x0237, 0)


def test_heartbeat_lost(bench: Bench) -> None:
    bench.download(1, 0x1017, 0, "H", 10)
    assert 0x701 in dict(bench.wait(0.02))
    begin(bench, "heartbeat_lost")
    assert 0x701 not in dict(bench.wait(0.05))


def test_error_frame_flood_and_replay(bench: Bench) -> None:
    begin(bench, "error_frame")
    assert bench.bus.sent[-1] == (0x20000040, bytes(8))
    begin(bench, "flood value=2000 duration=0.02")
    assert 30 <= [can_id for can_id, _ in bench.wait(0.02)].count(0x5F0) <= 45
    bench.sync(5)
    before = len(bench.bus.sent)
    begin(bench, "replay value=0.0045")
    assert [can_id for can_id, _ in bench.bus.sent[before:]].count(0x181) == 5


def test_sensor_faults(bench: Bench) -> None:
    position = struct.unpack_from("<I", dict(bench.sync())[0x1A0])[0]
    begin(bench, "encoder_jump value=0.5")
    jumped = struct.unpack_from("<I", dict(bench.sync())[0x1A0])[0]
    assert jumped - position == pytest.approx(0.5 / 6.283185307 * 2**20, abs=2)
    begin(bench, "torque_sensor_stuck")
    assert len({dict(bench.sync())[0x1C0] for _ in range(10)}) == 1


def test_the_noise_of_an_encoder_follows_from_the_plants_seed(tmp_path: Path) -> None:
    def positions(seed: int) -> list[bytes]:
        bench = Bench(tmp_path, f"[physics]\nseed = {seed}\n{STILL}")
        bench.set_up()
        begin(bench, "encoder_noise")
        return [dict(bench.sync())[0x1A0] for _ in range(5)]

    assert positions(1) == positions(1) != positions(2)


def test_reversed_sign_is_not_seen_by_the_drive(bench: Bench) -> None:
    begin(bench, "reversed_sign")
    bench.sync(20, bench.command(0x0F, 300))
    assert tpdo1(bench.sync())[1] == 300
    assert bench.unit.axis.values()["tau_m"] == pytest.approx(-0.3, abs=1e-6)


def test_torn_tendon_and_slack_end_when_cleared(bench: Bench) -> None:
    begin(bench, "slack value=0.2")
    bench.wait(0.02)
    assert bench.unit.axis.values()["pretension"] == pytest.approx(9.0)
    begin(bench, "torn_tendon value=1")
    bench.wait(0.02)
    assert bench.unit.axis.values()["t3"] == 0.0
    assert bench.machine.faults.clear(bench.clock.now) == 2
    bench.wait(0.05)
    assert bench.unit.axis.values()["pretension"] == pytest.approx(45.0)


def test_a_drifting_clock_repeats_a_sample_now_and_then(tmp_path: Path) -> None:
    bench = Bench(tmp_path, "[[axis]]\nname='joint'\ndrive.torque_noise=0.0\nmotion.kind='sine'\nmotion.ramp=0.0\n")
    bench.set_up()
    begin(bench, "clock_drift value=-0.05")
    samples = [dict(bench.sync())[0x281][:4] for _ in range(200)]
    repeats = sum(a == b for a, b in itertools.pairwise(samples))
    assert 5 <= repeats <= 15


def test_a_fault_of_the_configuration_comes_at_its_time(tmp_path: Path) -> None:
    bench = Bench(tmp_path, STILL + "[[axis.fault]]\nname = 'slack'\nvalue = 0.5\nat = 0.05\n")
    bench.wait(0.04)
    assert bench.machine.faults.active == 0
    bench.wait(0.02)
    assert bench.machine.faults.active == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("torn_tendn", "did you mean 'torn_tendon'?"),
        ("torn_tendon value=7", "allowed is 0 to 1"),
        ("stuck_tpdo value=1", "takes no value"),
        ("slack strength=1", "keys are axis, node, value, duration, at"),
        ("slack value", "write key=value"),
        ("slack name=torn_tendon", "each key once"),
        ("slack at=inf", "at=inf; allowed is a finite number"),
        ("slack at=-1", "at: expected a number of at least 0 s, found -1 s; raise it"),
        ("late_tpdo node=motor", "allowed are drive, encoder, torque_sensor"),
        ("emcy value=1.5", "allowed are whole numbers from 0 to 65535"),
    ],
)
def test_a_wrong_fault_is_one_clear_line(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=re.escape(said)) as raised:
        parse_fault(text)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("encoder_jump", "axis 'joint': fault encoder_jump: the axis has no encoder; choose another fault"),
        ("late_tpdo node=encoder", "the axis has no encoder"),
        ("torque_offset", "the drive has no 0x60B2; choose another fault"),
    ],
)
def test_a_fault_of_a_missing_part_is_rejected_at_the_request(tmp_path: Path, text: str, said: str) -> None:
    plant = STILL + "encoder.present = false\ntorque_sensor.present = false\ndrive.absent = [0x60B2]\n"
    with pytest.raises(UsageError, match=said):
        begin(Bench(tmp_path, plant), f"{text} at=1")
    name, *node = text.split(" node=")
    lines = [f"name = '{name}'", "at = 1", *(f"node = '{each}'" for each in node)]
    path = plant_file(tmp_path, plant + "[[axis.fault]]\n" + "\n".join(lines))
    with pytest.raises(UsageError, match=f"^{path}: .*{said}"):
        check(path)


def faulted(bench: Bench) -> list[object]:
    """Return everything that a fault changes, except the positions of the joint and the state of the nodes."""
    unit = bench.unit
    assert unit.encoder is not None
    assert unit.torque_sensor is not None
    parts = [unit.drive.faults, unit.encoder.faults, unit.torque_sensor.faults]
    senders = [unit.transmit["drive"], unit.by_kind["drive"]]
    names = ("stuck", "copies", "delay", "loss", "lost_in_a_row", "length", "mute", "deaf", "unhearing")
    objects = {key: unit.drive.values.get(key) for key in ((0x1400, 5), (0x1016, 1), (0x60B2, 0))}
    return [
        *(dataclasses.asdict(part) for part in parts),
        [getattr(sender, name, None) for sender in senders for name in names],
        unit.axis.parameters[0].item(),
        bench.machine.flood_rate,
        objects,
    ]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        *((name, name) for name in {**FAULTS, **CHANGES} if name not in ("power_cycle", "fault")),  # they disable
        ("slack", "fraying"),
        ("fraying", "pretension"),
        ("dead_stage", "flapping_stage"),
        ("polarity", "reversed_sign"),
        ("encoder_bit", "encoder_stuck"),
        ("reported_gain", "reported_offset"),
    ],
)
def test_nothing_remains_of_two_faults_that_overlap(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, one: str, other: str
) -> None:
    monkeypatch.setattr(bench.machine, "_switch", lambda channel, up: None)
    bench.download(1, 0x1400, 5, "H", 100)
    bench.sync(2, bench.command(0x0F, 100))
    before = faulted(bench)
    begin(bench, f"{one} duration=0.003")
    bench.sync(1)
    begin(bench, f"{other} duration=0.006")
    bench.sync(20, bench.command(0x0F, 100))
    assert bench.machine.faults.active == 0
    assert faulted(bench) == before


def test_a_distorted_value_saturates_as_in_a_drive(bench: Bench) -> None:
    begin(bench, "reported_offset value=40")
    assert tpdo1(bench.sync())[1] == 0x7FFF
    begin(bench, "reported_offset value=-100")
    assert tpdo1(bench.sync())[1] == -0x7FFF
    begin(bench, "velocity_gain value=10")
    for _ in range(9):
        begin(bench, "velocity_gain value=10")
    bench.unit.axis.readings.motor_speed = 1.0
    bench.unit.drive.sample()
    assert bench.unit.drive.values[0x606C, 0] == 0x7FFFFFFF


def test_a_fault_that_ends_leaves_the_others_in_force(bench: Bench) -> None:
    begin(bench, "encoder_jump value=0.5 duration=0.01")
    begin(bench, "encoder_jump value=0.2")
    begin(bench, "digital_input value=3 duration=0.01")
    begin(bench, "digital_input value=4")
    begin(bench, "fault duration=0.01")
    begin(bench, "fault duration=1")
    bench.sync(20)
    assert bench.unit.drive.error_cause
    assert bench.unit.encoder is not None
    assert bench.unit.encoder.faults.offset == pytest.approx(0.2)
    assert bench.upload(1, 0x60FD, 0, "I") == 1 << 4


def test_the_control_socket_answers(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "plant.sock"
    console = Console(bench.machine, ControlSocket(path))
    assert path.stat().st_mode & 0o777 == 0o600
    assert console.answer("slack value=0.5").startswith("ok ")
    assert console.answer("nonsense").startswith("error: ")
    assert '"power": "operation_enabled"' in console.answer("state")
    assert console.answer("clear").endswith("1 ended")
    console.close()
    with pytest.raises(Exception, match="no simulated machine answers"):
        ask(path, "state", timeout=0.1)


def test_an_interface_that_may_not_be_switched_rejects_the_fault_at_the_request(bench: Bench) -> None:
    with pytest.raises(UsageError, match=r"interface_down: .* cannot be switched"):
        begin(bench, "interface_down at=1")
    bench.wait(1.1)  # nothing was scheduled


@pytest.mark.parametrize("key", ["absent", "read_only"])
def test_an_object_that_the_drive_does_not_have_is_rejected(tmp_path: Path, key: str) -> None:
    for name in ("0x5555", "0x1018:9"):
        with pytest.raises(UsageError, match=rf"\[axis\.drive\] {key}: this drive has no {name}; correct"):
            check(plant_file(tmp_path, STILL + f"drive.{key} = ['{name}']\n"))
