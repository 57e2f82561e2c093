"""Test the bring-up with nodes that have an SDO server."""

from __future__ import annotations

import pytest

from tests.bus.local_nodes import U8, U32, Bench, Dictionary, bench, drive
from tests.bus.nodes import axis_nodes
from tsa_ctrl.bus.drive import checks
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.checks import Report
from tsa_ctrl.bus.drive.profile import DriveProfile, Units
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings
from tsa_ctrl.bus.wire.bus import BusFault
from tsa_ctrl.errors import BusError, UsageError


def start(nodes: Bench, axis: AxisNodes | None = None, profile: DriveProfile | None = None, **bus: object) -> Report:
    settings = BusSettings(interface="virtual", **bus)  # type: ignore[arg-type]
    return bring_up(nodes.bus, settings, [axis or axis_nodes()], [profile or DriveProfile()], 0.001)


HELD = {  # after a bring-up with max_torque 0.5 N*m and max_speed 20 rad/s
    (0x6060, 0): 10, (0x6072, 0): 500, (0x6080, 0): 190, (0x60A9, 0): 0xFDB44700,  # 0x6080 in rpm
    (0x60C2, 1): 1, (0x60C2, 2): 0xFD,  # 10^-3
    (0x6007, 0): 1, (0x1016, 1): 0x007F0064, (0x1017, 0): 50, (0x1400, 5): 20,  # node 127, 100 ms
    (0x1600, 0): 2, (0x1600, 1): 0x60400010, (0x1600, 2): 0x60710010,
    (0x1A00, 0): 3, (0x1A00, 1): 0x60410010, (0x1A00, 2): 0x60770010, (0x1A00, 3): 0x606C0020,
    (0x1A01, 0): 3, (0x1A01, 1): 0x60640020, (0x1A01, 2): 0x60610008, (0x1A01, 3): 0x603F0010,
    (0x1400, 1): 0x201, (0x1800, 1): 0x40000181, (0x1801, 1): 0x40000281,
    (0x1400, 2): 1, (0x1800, 2): 1, (0x1801, 2): 1,
    (0x1401, 1): 0x80000301, (0x1802, 1): 0xC0000381,  # spare PDOs are switched off
}  # fmt: skip


def test_drive_holds_the_whole_configuration_afterwards() -> None:
    """No enable and no torque is ever written, and a second bring-up changes nothing."""
    with bench() as nodes:
        axis = axis_nodes(max_torque=0.5, max_speed=20.0)
        start(nodes, axis)
        assert {key: nodes.get(1, *key) for key in HELD} == HELD
        assert (nodes.get(32, 0x1A00, 1), nodes.get(64, 0x1A00, 1)) == (0x60040020, 0x91300120)
        assert [data for _, index, _, data in nodes.written if index in (0x6040, 0x6071) and any(data)] == []
        assert set(nodes.commands[:3]) == {b"\x82\x01", b"\x82\x20", b"\x82\x40"}  # reset, then start
        assert set(nodes.commands[3:]) == {b"\x01\x01", b"\x01\x20", b"\x01\x40"}
        report = start(nodes, axis)
    assert [str(row) for node in report.nodes for row in node.rows if row.changed] == []


def test_pdo_is_disabled_and_empty_while_it_is_mapped() -> None:
    with bench() as nodes:
        start(nodes)
        steps = [(i, s, d) for n, i, s, d in nodes.written if n == 1 and i in (0x1400, 0x1600)]
        assert steps[0] == (0x1400, 1, b"\x01\x02\x00\x80")
        assert steps[-1] == (0x1400, 1, b"\x01\x02\x00\x00")
        entries = [index for index, step in enumerate(steps) if step[0] == 0x1600 and step[1] > 0]
        assert steps[entries[-1] + 1] == (0x1600, 0, b"\x02")


def test_rpdo_on_arrival_is_transmission_type_255() -> None:
    with bench() as nodes:
        start(nodes, rpdo="arrival")
        assert nodes.get(1, 0x1400, 2) == 255


def test_report_shows_what_was_changed_and_what_is_missing() -> None:
    with bench() as nodes:
        text = "\n".join(start(nodes).lines())
    assert "0x6072:0 max torque: 0xbb8 -> 0x3e8" in text
    assert "axis 'knee' drive node 1: device type 0x20192, vendor 0xf0f, product code 0x402" in text
    assert "absent: " in text
    assert "RPDO3 COB-ID, RPDO4 COB-ID" in text


def test_missing_node_is_named_with_those_that_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "BOOT_TIMEOUT", 0.3)
    monkeypatch.setattr(checks, "ANSWER_TIMEOUT", 0.05)
    nodes = Bench({1: drive()})
    try:
        with pytest.raises(BusError, match=r"no answer from axis 'knee' joint encoder node 32, .* \(heard: 1\)"):
            start(nodes)
    finally:
        nodes.close()


def test_rated_torque_unit_of_the_profile_is_used() -> None:
    profile = DriveProfile(units=Units(rated_torque=1e-6))
    with bench(drive={(0x6076, 0): (U32, 1_000_000)}) as nodes:
        start(nodes, profile=profile)


def test_value_that_does_not_stick_is_refused() -> None:
    with bench() as nodes:
        store = nodes.nodes[1]
        store.add_read_callback(lambda index, subindex, od: 900 if index == 0x6072 else None)
        with pytest.raises(BusError, match=r"0x6072:0 max torque: wrote 0x3e8, read back 0x384"):
            start(nodes)


def test_remembered_errors_are_shown() -> None:
    with bench(drive={(0x1003, 0): (5, 1), (0x1003, 1): (U32, 0x00003210)}) as nodes:
        assert "newest error in its history 0x3210 (DC link over-voltage)" in start(nodes).nodes[0].notes


def ratio(index: int, numerator: int, denominator: int = 1) -> Dictionary:
    return {(index, 1): (U32, numerator), (index, 2): (U32, denominator)}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"encoder": {(0x6001, 0): (U32, 4096)}}, r"is 4096, but .* has 1048576; correct counts_per_revolution"),
        ({"drive": {(0x6076, 0): (U32, 1414)}}, "a factor of the root of 2: one is the peak"),
        ({"drive": {(0x607E, 0): (U8, 0xE0)}}, r"the sign of position and velocity and torque; write polarity = 0xE0"),
        ({"drive": {(0x607E, 0): (U8, 0x20)}}, r"polarity \(0x607E\) is 0x20, the drive reverses the sign of torque"),
        ({"drive": ratio(0x608F, 4096)}, r"has 4096 counts per motor rev.* has 65536; correct"),
        ({"drive": ratio(0x6091, 7)}, r"gear ratio \(0x6091\) is 7, .* write absent = "),
        ({"drive": ratio(0x6091, 7, 2) | ratio(0x6092, 65536)}, r"gear ratio \(0x6091\) is 7/2"),
    ],
)
def test_sign_or_scale_that_the_node_has_otherwise_is_refused(changes: dict[str, Dictionary], said: str) -> None:
    with bench(**changes) as nodes:
        with pytest.raises(UsageError, match=said):
            start(nodes)
        assert all(command[0] != 0x01 for command in nodes.commands)  # no node is set to operational


@pytest.mark.parametrize(
    "changes",
    [
        {(0x607E, 0): (U8, 0)} | ratio(0x608F, 1 << 17, 2),
        ratio(0x608F, 0, 0) | ratio(0x6091, 3, 3),
        ratio(0x608F, 4096) | ratio(0x6092, 65536),
        ratio(0x6091, 2) | ratio(0x6092, 1 << 17),
    ],
)
def test_sign_and_count_as_configured_in_whatever_terms_pass(changes: Dictionary) -> None:
    with bench(drive=changes) as nodes:
        start(nodes)


def test_polarity_that_is_given_is_written() -> None:
    with bench(drive={(0x607E, 0): (U8, 0xE0)}) as nodes:
        start(nodes, axis_nodes(polarity=0))
        assert nodes.get(1, 0x607E) == 0


def test_what_the_profile_says_it_lacks_is_not_compared() -> None:
    with bench(drive=ratio(0x6091, 7) | ratio(0x608F, 4096)) as nodes:
        start(nodes, profile=DriveProfile(absent=["motor shaft revolutions", "encoder increments"]))


def test_bus_that_fails_meanwhile_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with bench() as nodes:
        send, sent = nodes.bus.send, []

        def fail_after_a_while(can_id: int, data: bytes) -> bool:
            sent.append(can_id)
            if len(sent) < 30:
                return send(can_id, data)
            nodes.bus.fault = BusFault.INTERFACE_DOWN
            return False

        monkeypatch.setattr(nodes.bus, "send", fail_after_a_while)
        with pytest.raises(BusError, match="the interface is down; check adapter, cable and interface"):
            start(nodes)


def test_dropped_frame_is_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    with bench() as nodes:
        send, requests = nodes.bus.send, []

        def drop_every_tenth_request(can_id: int, data: bytes) -> bool:
            if can_id == 0x601:
                requests.append(data)
                if len(requests) % 10 == 0:
                    return False
            return send(can_id, data)

        monkeypatch.setattr(nodes.bus, "send", drop_every_tenth_request)
        start(nodes)
        assert nodes.get(1, 0x6072) == 1000


def test_rate_that_the_bit_rate_cannot_carry_is_refused_before_anything_is_sent() -> None:
    with bench() as nodes:
        with pytest.raises(UsageError, match="bitrate 500000: 1000 Hz"):
            start(nodes, bitrate=500_000)
        assert nodes.bus.counters.sent == 0


def test_two_nodes_with_one_id_are_refused() -> None:
    axis = AxisNodes(name="knee", drive=DriveSettings(node_id=127))
    with bench() as nodes, pytest.raises(UsageError, match=r"node_id 127 is also used by \[bus\] host_node_id"):
        start(nodes, axis)


def test_rpdo_timeout_below_two_periods_is_refused() -> None:
    with bench() as nodes, pytest.raises(UsageError, match="shorter than two periods"):
        start(nodes, axis_nodes(rpdo_timeout=0.001))


def test_fault_found_at_the_start_is_reset_only_on_request() -> None:
    """On request, the bring-up writes a rising edge of controlword bit 7. Otherwise it writes no controlword."""
    with bench(drive={(0x6041, 0): (6, 0x0218), (0x603F, 0): (6, 0x2310)}) as nodes:
        node = nodes.nodes[1]

        def leave(index: int, subindex: int, od: object, data: bytes) -> None:
            if index == 0x6040 and data[0] & 0x80:
                node.data_store.setdefault(0x6041, {})[0] = b"\x40\x02"

        node.add_write_callback(leave)
        assert any("--reset-faults" in note for note in start(nodes).nodes[0].notes)
        assert not [entry for entry in nodes.written if entry[1] == 0x6040]
        settings = BusSettings(interface="virtual")
        report = bring_up(nodes.bus, settings, [axis_nodes()], [DriveProfile()], 0.001, reset_faults=True)
        assert [entry[3][0] for entry in nodes.written if entry[1] == 0x6040] == [0x00, 0x80, 0x00]
        assert any("was in fault: error 0x2310" in note for note in report.nodes[0].notes)
