"""Test NMT, heartbeat, EMCY and PDO mapping of a simulated node with literal frames."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.plant.bench import Bench

DEVICE_STATE, NOT_MAPPABLE, PDO_LENGTH = 0x08000022, 0x06040041, 0x06040042
INVALID_VALUE = 0x06090030


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_every_node_boots(bench: Bench) -> None:
    assert bench.bus.sent == [(0x701, b"\x00"), (0x720, b"\x00"), (0x740, b"\x00")]


def test_heartbeat_says_the_state(bench: Bench) -> None:
    bench.download(1, 0x1017, 0, "H", 10)
    assert (0x701, b"\x7f") in bench.wait(0.02)
    bench.send(0x000, b"\x01\x01")
    assert (0x701, b"\x05") in bench.wait(0.02)
    bench.send(0x000, b"\x02\x00")
    assert (0x701, b"\x04") in bench.wait(0.02)
    assert len([frame for frame in bench.wait(0.5) if frame[0] == 0x701]) in (49, 50, 51)


def test_a_node_addressed_alone_starts_alone(bench: Bench) -> None:
    assert bench.sync(5) == []
    bench.send(0x000, b"\x01\x20")
    assert [can_id for can_id, _ in bench.sync()] == [0x1A0]


@pytest.mark.parametrize(("command", "max_torque"), [(0x82, 123), (0x81, 1000)])
def test_a_reset_of_communication_or_node_restores_its_objects(bench: Bench, command: int, max_torque: int) -> None:
    bench.download(1, 0x1017, 0, "H", 10)
    bench.download(1, 0x6072, 0, "H", 123)
    bench.unit.drive.node.emergency(0x8130, 0x10)
    assert bench.upload(1, 0x1001, 0, "B") == 0x11
    assert bench.send(0x000, bytes((command, 1))) == [(0x701, b"\x00")]
    assert bench.upload(1, 0x1001, 0, "B") == 0  # the communication error is over
    assert bench.upload(1, 0x1017, 0, "H") == 0
    assert bench.upload(1, 0x6072, 0, "H") == max_torque


def test_no_sdo_while_stopped(bench: Bench) -> None:
    bench.send(0x000, b"\x02\x01")
    assert bench.send(0x601, bytes.fromhex("4000100000000000")) == []


def test_heartbeat_consumer_begins_with_the_first_heartbeat(bench: Bench) -> None:
    bench.download(1, 0x1016, 1, "I", 127 << 16 | 50)
    assert bench.wait(0.2) == []
    bench.send(0x77F, b"\x05")
    assert bench.wait(0.04) == []
    assert bench.wait(0.04) == [(0x081, bytes.fromhex("3081110000000000"))]
    assert bench.wait(0.5) == []


def test_emcy_is_kept_in_the_history(bench: Bench) -> None:
    bench.unit.drive.node.emergency(0x4310, 0x08, b"\x01\x02\x03\x04\x05")
    bench.unit.drive.node.emergency(0x8130, 0x10)
    assert bench.bus.sent[-2:] == [
        (0x081, bytes.fromhex("1043090102030405")),
        (0x081, bytes.fromhex("3081190000000000")),
    ]
    history = [bench.upload(1, 0x1003, place, code) for place, code in ((0, "B"), (1, "I"), (2, "I"))]
    assert history == [2, 0x8130, 0x4310]
    assert bench.download(1, 0x1003, 0, "B", 0) == 0
    assert bench.upload(1, 0x1003, 0, "B") == 0


def test_the_mapping_procedure_maps(bench: Bench) -> None:
    assert set(bench.map_pdo(1, 0x1800, 0x181, 1, 0x60410010, 0x606C0020)) == {0}
    bench.send(0x000, b"\x01\x01")
    assert dict(bench.sync())[0x181] == b"\x50\x02" + bytes(4)


def test_a_mapping_cannot_change_while_the_pdo_is_on_or_its_count_stands(bench: Bench) -> None:
    assert bench.download(1, 0x1A00, 0, "B", 0) == DEVICE_STATE
    assert bench.download(1, 0x1800, 1, "I", 0x182) == DEVICE_STATE
    assert bench.download(1, 0x1800, 1, "I", 0x80000181) == 0
    assert bench.download(1, 0x1A00, 1, "I", 0x60640020) == DEVICE_STATE


@pytest.mark.parametrize(
    ("parameter", "entries", "abort"),
    [
        (0x1801, [0x60760020], NOT_MAPPABLE),  # not a process value
        (0x1801, [0x60410008], NOT_MAPPABLE),  # a wrong length
        (0x1401, [0x60410010], NOT_MAPPABLE),  # a read-only object in an RPDO
        (0x1801, [0x60640020, 0x606C0020, 0x60410010], PDO_LENGTH),  # more than eight bytes
    ],
)
def test_what_cannot_be_mapped_is_refused(bench: Bench, parameter: int, entries: list[int], abort: int) -> None:
    aborts = bench.map_pdo(1, parameter, 0x281 if parameter == 0x1801 else 0x301, 1, *entries)
    assert next(each for each in aborts if each) == abort


def test_a_dummy_fills_a_gap_of_an_rpdo(bench: Bench) -> None:
    assert set(bench.map_pdo(1, 0x1401, 0x301, 255, 0x00060010, 0x60710010)) == {0}
    bench.send(0x000, b"\x01\x01")
    bench.send(0x301, bytes.fromhex("ffff2c01"))
    assert bench.upload(1, 0x6071, 0, "h") == 300


@pytest.mark.parametrize("transmission", [1, 3])
def test_a_synchronous_tpdo_comes_on_every_nth_sync(bench: Bench, transmission: int) -> None:
    bench.map_pdo(1, 0x1800, 0x181, transmission, 0x60410010)
    bench.send(0x000, b"\x01\x01")
    came = [any(can_id == 0x181 for can_id, _ in bench.sync()) for _ in range(2 * transmission)]
    assert came == ([False] * (transmission - 1) + [True]) * 2


def test_transmission_types_that_do_not_exist_are_refused(bench: Bench) -> None:
    assert [bench.download(1, 0x1800, 2, "B", kind) for kind in (241, 252, 253)] == [INVALID_VALUE] * 3


def test_an_event_driven_tpdo_comes_on_change(bench: Bench) -> None:
    bench.send(0x000, b"\x01\x01")
    assert bench.wait(0.005) == [(0x181, b"\x50\x02")]
    assert bench.wait(0.1) == []
    bench.download(1, 0x6040, 0, "H", 0x06)
    assert bench.wait(0.005) == [(0x181, b"\x31\x02")]


@pytest.mark.parametrize(("data", "emergency", "controlword"), [("0600", "1082", 0), ("060000000000", "2082", 6)])
def test_an_rpdo_of_another_length_is_reported_and_used_only_if_longer(
    bench: Bench, data: str, emergency: str, controlword: int
) -> None:
    bench.set_up()
    assert bench.send(0x201, bytes.fromhex(data)) == [(0x081, bytes.fromhex(f"{emergency}110000000000"))]
    bench.sync(2)
    assert bench.upload(1, 0x6040, 0, "H") == controlword


def test_an_unknown_identifier_is_of_no_concern(bench: Bench) -> None:
    assert bench.send(0x333, bytes(8)) == []
    assert bench.send(0x20000004, bytes(8)) == []


def test_an_event_timer_repeats_a_tpdo(bench: Bench) -> None:
    bench.download(1, 0x1800, 5, "H", 20)
    bench.send(0x000, b"\x01\x01")
    assert len(bench.wait(0.2)) in (9, 10, 11)
