"""Test the bring-up of a simulated drive and its sensors in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bus.nodes import axis_nodes
from tests.drives.rig import Foreign
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.checks import Report
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings
from tsa_ctrl.bus.wire.bus import BusFault
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.plant.dictionary import Entry, Type

SENSORS = "[[axis]]\nname = 'joint'\nmotion.kind = 'still'\n"  # a plant's axis with drive 1, encoder 32 and sensor 64


def start(
    foreign: Foreign, axis: AxisNodes | None = None, profile: DriveProfile | None = None, **bus: object
) -> Report:
    settings = BusSettings(interface="virtual", **bus)  # type: ignore[arg-type]
    axis = axis or AxisNodes(name="knee", drive=DriveSettings(node_id=1))
    return bring_up(foreign.wire.host, settings, [axis], [profile or DriveProfile()], 0.001)


def objects(**values: int) -> str:
    """Return a line of [axis.drive] that changes power-on values: `objects(x608F_1=4096)` changes 0x608F:1."""
    pairs = (f"'0x{key[1:5]}:{key[6:]}' = {value}" for key, value in values.items())
    return f"objects = {{{', '.join(pairs)}}}"


HELD = {  # after a bring-up with max_torque 0.5 N*m and max_speed 20 rad/s
    (0x6060, 0): 10, (0x6072, 0): 500, (0x6080, 0): 190, (0x60A9, 0): 0xFDB44700,  # 0x6080 in rpm
    (0x60C2, 1): 1, (0x60C2, 2): -3,
    (0x6007, 0): 1, (0x1016, 1): 0x007F0064, (0x1017, 0): 50, (0x1400, 5): 20,  # node 127, 100 ms
    (0x1600, 0): 2, (0x1600, 1): 0x60400010, (0x1600, 2): 0x60710010,
    (0x1A00, 0): 3, (0x1A00, 1): 0x60410010, (0x1A00, 2): 0x60770010, (0x1A00, 3): 0x606C0020,
    (0x1A01, 0): 3, (0x1A01, 1): 0x60640020, (0x1A01, 2): 0x60610008, (0x1A01, 3): 0x603F0010,
    (0x1400, 1): 0x201, (0x1800, 1): 0x40000181, (0x1801, 1): 0x40000281,
    (0x1400, 2): 1, (0x1800, 2): 1, (0x1801, 2): 1,
    (0x1401, 1): 0x80000000, (0x1802, 1): 0xC0000381,  # spare PDOs are off
}  # fmt: skip


def test_drive_holds_the_whole_configuration_afterwards(tmp_path: Path) -> None:
    """No enable and no torque is ever written, and a second bring-up changes no object of the drive profile."""
    foreign = Foreign(tmp_path, text=SENSORS)
    axis = axis_nodes(max_torque=0.5, max_speed=20.0)
    start(foreign, axis)
    assert {key: foreign.node.values[key] for key in HELD} == HELD
    assert [data for _, data in foreign.sent(0x601) if data[1:3] in (b"\x40\x60", b"\x71\x60") and any(data[4:])] == []
    commands = [data for _, data in foreign.sent(0x000)]
    assert set(commands[:3]) == {b"\x82\x01", b"\x82\x20", b"\x82\x40"}  # reset, then start
    assert set(commands[3:]) == {b"\x01\x01", b"\x01\x20", b"\x01\x40"}
    rows = [row for node in start(foreign, axis).nodes for row in node.rows]
    assert [str(row) for row in rows if row.changed and row.entry.index >= 0x6000] == []  # a reset restores the others


def test_rpdo_on_arrival_is_transmission_type_255(tmp_path: Path) -> None:
    """Its communication parameters are as required already, but it must be disabled while it is mapped."""
    foreign = Foreign(tmp_path, objects(x1400_5=20))
    start(foreign, rpdo="arrival")
    assert (foreign.node.values[0x1400, 2], foreign.node.values[0x1600, 2]) == (255, 0x60710010)


def test_report_shows_what_was_changed_and_what_is_missing(tmp_path: Path) -> None:
    text = "\n".join(start(Foreign(tmp_path, objects(x6072_0=3000), "absent = [0x1403]")).lines())
    assert "0x6072:0 max torque: 0xbb8 -> 0x3e8" in text
    assert "axis 'knee' drive node 1: device type 0x20192, vendor 0xf0f, product code 0x402" in text
    assert "absent: RPDO4 COB-ID" in text


def test_missing_node_is_named_with_those_that_answered(tmp_path: Path) -> None:
    with pytest.raises(BusError, match=r"no answer from axis 'knee' joint encoder node 32, .* \(heard: 1\)"):
        start(Foreign(tmp_path), axis_nodes())


def test_remembered_errors_are_shown(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path)
    foreign.node.emergency(0x3210, 0x04)
    assert "newest error in its history 0x3210 (DC link over-voltage)" in start(foreign).nodes[0].notes


def with_feed(foreign: Foreign, feed: int) -> Foreign:
    """Add the feed constant 0x6092, which the simulated drive lacks."""
    for entry in (Entry(0x6092, 1, Type.U32, default=feed), Entry(0x6092, 2, Type.U32, default=1)):
        foreign.node.dictionary.add(entry)
    return foreign


@pytest.mark.parametrize(
    ("quirk", "feed", "said"),
    [
        (objects(x6076_0=1414), 0, "a factor of the root of 2: one is the peak"),
        (objects(x607E_0=0xE0), 0, r"the sign of position and velocity and torque; write polarity = 0xE0"),
        (objects(x607E_0=0x20), 0, r"polarity \(0x607E\) is 0x20, the drive reverses the sign of torque"),
        (objects(x608F_1=4096), 0, r"has 4096 counts per motor rev.* has 65536; correct"),
        (objects(x6091_1=7), 0, r"gear ratio \(0x6091\) is 7, .* write absent = "),
        (objects(x6091_1=7, x6091_2=2), 65536, r"gear ratio \(0x6091\) is 7/2"),
    ],
)
def test_sign_or_scale_that_the_drive_has_otherwise_is_refused(
    tmp_path: Path, quirk: str, feed: int, said: str
) -> None:
    foreign = with_feed(Foreign(tmp_path, quirk), feed)
    with pytest.raises(UsageError, match=said):
        start(foreign)
    assert all(data[0] != 0x01 for _, data in foreign.sent(0x000))  # no node is set to operational


def test_an_encoder_of_another_resolution_is_refused(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, text=f"{SENSORS}encoder.counts_per_revolution = 4096\n")
    with pytest.raises(UsageError, match=r"is 4096, but .* has 1048576; correct counts_per_revolution"):
        start(foreign, axis_nodes())


@pytest.mark.parametrize(
    ("quirk", "feed"),
    [
        (objects(x608F_1=1 << 17, x608F_2=2), 0),
        (objects(x608F_1=0, x608F_2=0, x6091_1=3, x6091_2=3), 0),
        (objects(x608F_1=4096), 65536),
        (objects(x6091_1=2), 1 << 17),
    ],
)
def test_sign_and_count_as_configured_in_whatever_terms_pass(tmp_path: Path, quirk: str, feed: int) -> None:
    start(with_feed(Foreign(tmp_path, quirk), feed))


def test_polarity_that_is_given_is_written(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, objects(x607E_0=0xE0))
    start(foreign, AxisNodes(name="knee", drive=DriveSettings(node_id=1, polarity=0)))
    assert foreign.node.values[0x607E, 0] == 0


def test_what_the_profile_says_it_lacks_is_not_compared(tmp_path: Path) -> None:
    profile = DriveProfile(absent=["motor shaft revolutions", "encoder increments"])
    start(Foreign(tmp_path, objects(x6091_1=7, x608F_1=4096)), profile=profile)


def test_bus_that_fails_meanwhile_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    foreign = Foreign(tmp_path)
    host, sent = foreign.wire.host, list[int]()
    send = host.send

    def fail_after_a_while(can_id: int, data: bytes) -> bool:
        sent.append(can_id)
        if len(sent) < 30:
            return send(can_id, data)
        host.fault = BusFault.INTERFACE_DOWN
        return False

    monkeypatch.setattr(host, "send", fail_after_a_while)
    with pytest.raises(BusError, match="the interface is down; check adapter, cable and interface"):
        start(foreign)


def test_dropped_frame_is_sent_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    foreign = Foreign(tmp_path, objects(x6072_0=3000))
    send, requests = foreign.wire.host.send, list[bytes]()

    def drop_every_tenth_request(can_id: int, data: bytes) -> bool:
        if can_id == 0x601:
            requests.append(data)
            if len(requests) % 10 == 0:
                return False
        return send(can_id, data)

    monkeypatch.setattr(foreign.wire.host, "send", drop_every_tenth_request)
    start(foreign)
    assert foreign.node.values[0x6072, 0] == 1000


@pytest.mark.parametrize(
    ("drive", "bus", "said"),
    [
        ({"node_id": 1}, {"bitrate": 125_000}, "bitrate 125000: 1000 Hz"),
        ({"node_id": 127}, {}, r"node_id 127 is also used by \[bus\] host_node_id"),
        ({"node_id": 1, "rpdo_timeout": 0.001}, {}, "shorter than two periods"),
    ],
)
def test_a_contradiction_is_refused_before_anything_is_sent(
    tmp_path: Path, drive: dict[str, int], bus: dict[str, int], said: str
) -> None:
    foreign = Foreign(tmp_path)
    with pytest.raises(UsageError, match=said):
        start(foreign, AxisNodes(name="knee", drive=DriveSettings(**drive)), **bus)
    assert foreign.sent() == []


def test_fault_found_at_the_start_is_reset_only_on_request(tmp_path: Path) -> None:
    """On request, the bring-up writes a rising edge of controlword bit 7. Otherwise it writes no controlword."""
    foreign = Foreign(tmp_path)
    foreign.drive.fault(0x2310)
    foreign.wait(0.1)

    def controlwords() -> list[int]:
        return [data[4] for _, data in foreign.commands() if data[:3] == b"\x2b\x40\x60"]

    assert any("--reset-faults" in note for note in start(foreign).nodes[0].notes)
    assert controlwords() == []
    report = foreign.bring_up(reset_faults=True)
    assert controlwords() == [0x00, 0x80, 0x00]
    assert any("was in fault: error 0x2310" in note for note in report.nodes[0].notes)
