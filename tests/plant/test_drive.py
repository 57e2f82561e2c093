"""Test units, limits and reactions of the simulated CiA 402 drive by its frames."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tests.plant.bench import Bench, tpdo1

STILL = "[[axis]]\nname = 'joint'\ndrive.torque_noise = 0.0\nmotion.kind = 'still'\n"


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    bench = Bench(tmp_path, STILL)
    bench.set_up()
    return bench


def settled(bench: Bench, per_mille: int, controlword: int = 0x0F) -> tuple[int, int, int]:
    """Return the TPDO1 values after 50 ms with one command."""
    bench.sync(50, bench.command(controlword, per_mille))
    return tpdo1(bench.sync())


@pytest.mark.parametrize(("transmission", "unchanged"), [(1, [0]), (255, [])])
def test_the_current_loop_lags_from_the_sync_or_from_the_arrival_of_the_command(
    tmp_path: Path, transmission: int, unchanged: list[int]
) -> None:
    bench = Bench(tmp_path, STILL)
    bench.set_up(rpdo_transmission=transmission)
    bench.enable()
    bench.send(0x201, bench.command(0x0F, 1000))
    assert [tpdo1(bench.sync())[1] for _ in unchanged] == unchanged  # the command is applied at this SYNC
    assert tpdo1(bench.sync())[1] == pytest.approx(1000 * (1 - 2.718281828 ** (-1 / 0.5)), abs=1)


def test_no_torque_unless_enabled(bench: Bench) -> None:
    for controlword in (0x06, 0x07):
        assert settled(bench, 500, controlword)[1] == 0


def test_no_torque_without_the_mode(bench: Bench) -> None:
    bench.download(1, 0x6060, 0, "b", 0)
    bench.enable()
    status, torque, _ = settled(bench, 500)
    assert (status, torque) == (0x0237, 0)  # bit 12 low


def test_max_torque_clamps_and_sets_the_internal_limit(bench: Bench) -> None:
    bench.download(1, 0x6072, 0, "H", 200)
    bench.enable()
    assert settled(bench, 900)[:2] == (0x1A37, 200)
    assert settled(bench, -900)[:2] == (0x1A37, -200)


@pytest.mark.parametrize(
    ("index", "delivered"), [(0x60E0, (100, -500)), (0x60E1, (500, -100)), (0x6073, (100, -100)), (0x60B2, (600, -400))]
)
def test_each_torque_limit_acts_on_its_side_and_the_offset_adds(
    bench: Bench, index: int, delivered: tuple[int, int]
) -> None:
    bench.enable()
    bench.download(1, index, 0, "H", 100)
    assert [settled(bench, torque)[1] for torque in (500, -500)] == pytest.approx(delivered, abs=1)


@pytest.mark.parametrize(("mode", "reached"), [(10, 500), (4, 50)])
def test_the_torque_slope_acts_in_profile_torque_only(tmp_path: Path, mode: int, reached: int) -> None:
    """The slope is 1000 per mille/s for 0.05 s."""
    bench = Bench(tmp_path, "[[axis]]\nname = 'j'\nmotion.kind = 'still'\ndrive.modes = ['cst', 'tq']\n")
    bench.set_up()
    bench.download(1, 0x6060, 0, "b", mode)
    bench.download(1, 0x6087, 0, "I", 1000)
    bench.enable()
    bench.sync(50, bench.command(0x0F, 500))
    assert bench.upload(1, 0x6074, 0, "h") == pytest.approx(reached, abs=3)


def test_no_torque_beyond_the_maximum_speed(tmp_path: Path) -> None:
    bench = Bench(tmp_path, STILL + "joint.load = 'free'\njoint.damping = 0.0\n")
    bench.set_up()
    bench.download(1, 0x6080, 0, "I", 30)  # rpm
    bench.enable()
    bench.sync(1500, bench.command(0x0F, 900))
    status, _, velocity = tpdo1(bench.sync())
    assert velocity < 40_000  # mrpm; without the limit some hundred rpm
    assert status & 1 << 11 or velocity < 30_000


def test_position_and_velocity_are_those_of_the_motor(tmp_path: Path) -> None:
    bench = Bench(tmp_path, "[[axis]]\nname='joint'\ndrive.torque_noise=0.0\nmotion.kind='sine'\nmotion.ramp=0.0\n")
    bench.set_up()
    bench.sync(300)
    frames = dict(bench.sync())
    position, mode, error = struct.unpack("<ibH", frames[0x281])
    truth = bench.unit.axis.values()
    assert position == pytest.approx(truth["q_m"] / 6.283185307 * 65536, abs=1)
    assert struct.unpack("<Hhi", frames[0x181])[2] == pytest.approx(truth["omega_m"] * 60 / 6.283185307 * 1e3, abs=1)
    assert (mode, error) == (10, 0)


def test_a_fault_takes_the_torque_and_stays(bench: Bench) -> None:
    bench.enable(500)
    before = len(bench.bus.sent)
    bench.unit.drive.fault(0x2310)
    assert bench.bus.sent[before:] == [(0x081, bytes.fromhex("1023210000000000"))]
    status, torque, _ = settled(bench, 500)
    assert (status, torque) == (0x0218, 0)
    assert struct.unpack_from("<H", dict(bench.sync())[0x281], 5)[0] == 0x2310
    before = len(bench.bus.sent)
    bench.sync(2, bench.command(0x80))
    assert (0x081, bytes(8)) in bench.bus.sent[before:]
    assert bench.statusword() == 0x0250


def test_quick_stop_ends_disabled_when_the_torque_is_gone(bench: Bench) -> None:
    bench.enable(500)
    bench.sync(1, bench.command(0x02))
    assert bench.statusword() == 0x0217
    assert settled(bench, 500, 0x02)[:2] == (0x0250, 0)


def test_an_rpdo_that_stops_coming_is_a_fault(bench: Bench) -> None:
    bench.download(1, 0x1400, 5, "H", 20)
    bench.enable(500)
    before = len(bench.bus.sent)
    bench.sync(30)
    emcy = [data for can_id, data in bench.bus.sent[before:] if can_id == 0x081]
    assert emcy == [bytes.fromhex("5082210000000000")]
    assert tpdo1(bench.sync())[:2] == (0x0218, 0)


@pytest.mark.parametrize(
    ("reaction", "behaviour", "state"), [(1, 0, 0x0218), (2, 0, 0x02D0), (3, 0, 0x02D0), (0, 1, 0x12B7), (1, 1, 0x0218)]
)
def test_a_lost_heartbeat(bench: Bench, reaction: int, behaviour: int, state: int) -> None:
    bench.download(1, 0x1016, 1, "I", 127 << 16 | 50)
    bench.download(1, 0x6007, 0, "h", reaction)
    bench.download(1, 0x1029, 1, "B", behaviour)
    bench.enable(500)
    bench.send(0x77F, b"\x05")
    bench.sync(60, bench.command(0x0F, 500))
    bench.wait(0.02)
    assert bench.upload(1, 0x6041, 0, "H") == state
    assert bench.unit.axis.values()["torque_loop"] == pytest.approx(0.5 if reaction == 0 else 0.0, abs=1e-6)


def test_leaving_operational_while_enabled_takes_the_torque(bench: Bench) -> None:
    bench.enable(500)
    bench.send(0x000, b"\x80\x01")
    bench.wait(0.02)
    assert bench.upload(1, 0x6041, 0, "H") & 0x4F == 0x08
    assert bench.unit.axis.values()["torque_loop"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "absent", "torque"),
    [
        ("generic", "0x6060", 0.0),
        ("generic", "0x1400, 0x6040", 0.0),
        ("epos4", "0x3001", 0.3),
    ],
)
def test_a_drive_may_lack_an_object(tmp_path: Path, kind: str, absent: str, torque: float) -> None:
    """The drive answers SDO requests without the object, and has no torque without a mode, a target or an RPDO."""
    text = f"[[axis]]\nname='joint'\n[axis.drive]\nkind='{kind}'\nabsent=[{absent}]\n"
    bench = Bench(tmp_path, text)
    bench.set_up()
    bench.enable(300)
    bench.wait(0.01)
    assert bench.upload(1, 0x6041, 0, "H") & 0x10
    assert bench.unit.axis.command.torque == pytest.approx(torque)


def test_gear_and_signs(tmp_path: Path) -> None:
    bench = Bench(
        tmp_path,
        STILL + "drive.gear_ratio = 5.0\ndrive.rated_torque = 0.1\ndrive.torque_sign = -1\ndrive.peak_torque=1.0\n",
    )
    bench.set_up()
    bench.enable()
    assert settled(bench, 400)[1] == 400
    assert bench.unit.axis.values()["tau_m"] == pytest.approx(-0.2)


def test_only_one_mode_is_supported(bench: Bench) -> None:
    assert bench.upload(1, 0x6502, 0, "I") == 1 << 9
    assert bench.download(1, 0x6060, 0, "b", 8) == 0x06090030


def test_quick_stop_that_stays_can_be_left(bench: Bench) -> None:
    assert bench.download(1, 0x605A, 0, "h", 6) == 0
    bench.enable(500)
    assert settled(bench, 500, 0x02)[:2] == (0x0217, 0)
    assert settled(bench, 500)[:2] == (0x1237, 500)
