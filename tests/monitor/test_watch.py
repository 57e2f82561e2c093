"""The monitor without a process or a bus: literal frames in, a cause out."""

from __future__ import annotations

import struct

import pytest

from tests.monitor.healthy import (
    HEARTBEAT,
    JOINT,
    MOTION,
    PERIOD,
    POSITION,
    READY,
    RPDO,
    SYNC,
    Edit,
    Sound,
    added,
    changed,
    held,
    play,
    watched,
    without,
)
from tsa_ctrl.monitor.watch import Monitor
from tsa_ctrl.monitor.watched import FINDINGS, Frame

AT = 1.0  # s, start of the fault
ONCE = {"last": AT}
SOUND: Edit = lambda t, frames: frames  # noqa: E731


def motion(torque: int | None = None, velocity: float = 1.0) -> Edit:
    def edit(data: bytes) -> bytes:
        word, reported, speed = struct.unpack("<Hhi", data)
        return struct.pack("<Hhi", word, reported if torque is None else torque, round(velocity * speed))

    return changed(MOTION, edit, AT)


def lost_counts(data: bytes) -> bytes:
    """Halve the counts of the joint encoder."""
    return struct.pack("<i", struct.unpack("<i", data)[0] // 2)


TRIALS: dict[str, tuple[str, Edit, float]] = {  # finding, fault, longest time to detection (s)
    "command above the limit": ("command_torque", changed(RPDO, lambda data: b"\x0f\x00\x99\x08", AT), 0.001),
    "command jumps": ("command_step", changed(RPDO, lambda data: b"\x0f\x00\x20\x03", AT), 0.001),
    "torque above the limit": ("torque", motion(torque=2600), 0.02),
    "another torque": ("torque_error", motion(torque=-700), 0.16),
    "forged command": ("command_step", added(AT, (RPDO, b"\x0f\x00\xe8\x03")), 0.001),
    "velocity of the wrong sign": ("velocity", motion(velocity=-1.0), 0.05),
    "velocity of half the size": ("velocity", motion(velocity=0.5), 0.2),
    "motor position stuck": ("apart", held((POSITION,), AT, 4), 0.1),
    "both positions stuck": ("velocity", held((POSITION, JOINT), AT, 4), 0.1),
    "drive stuck": ("apart", held((POSITION, MOTION), AT), 0.1),
    "joint encoder stuck": ("apart", held((JOINT,), AT), 0.1),
    "joint encoder counts half": ("apart", changed(JOINT, lost_counts, AT), 0.2),
    "command twice": ("surplus", lambda t, frames: [*frames, frames[4]] if t >= AT else frames, 0.01),
    "encoder forged": ("surplus", lambda t, frames: [*frames, frames[3]] if t >= AT else frames, 0.01),
    "answers replayed": ("surplus", lambda t, frames: [*frames, *10 * [frames[1]]] if t == AT else frames, 0.001),
    "loop killed": ("silent", lambda t, frames: [] if t >= AT else frames, 0.022),
    "no command": ("silent", without(RPDO, AT), 0.022),
    "no answer of the drive": ("silent", without(MOTION, AT), 0.022),
    "no answer of the encoder": ("silent", without(JOINT, AT), 0.022),
    "no heartbeat of the host": ("silent", without(HEARTBEAT, AT), 0.102),
    "answer of a wrong length": ("silent", changed(JOINT, lambda data: data[:3], AT), 0.022),
    "two SYNCs": ("sync_rate", added(AT, (SYNC, b"")), 0.17),
    "NMT pre-operational": ("nmt", added(AT, (0x000, b"\x80\x01"), **ONCE), 0.001),
    "NMT reset of all": ("nmt", added(AT, (0x000, b"\x81\x00"), **ONCE), 0.001),
    "NMT stop of the encoder": ("nmt", added(AT, (0x000, b"\x02\x20"), **ONCE), 0.001),
    "LSS switch state global": ("lss", added(AT, (0x7E5, b"\x04\x01" + bytes(6)), **ONCE), 0.001),
    "LSS activate bit timing": ("lss", added(AT, (0x7E5, b"\x15\x64\x00" + bytes(5)), **ONCE), 0.001),
    "SDO write": ("sdo_write", added(AT, (0x601, bytes.fromhex("2316100100000000")), **ONCE), 0.001),
}


@pytest.mark.parametrize("trial", TRIALS)
def test_what_is_wrong_is_found(trial: str) -> None:
    finding, edit, within = TRIALS[trial]
    stop = play(Monitor(watched()), Sound(), 2.0, edit)
    assert stop is not None
    assert stop.id == finding, str(stop)
    assert AT <= stop.time <= AT + within
    assert stop.title == FINDINGS[finding][0]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_sound_axis_is_left_alone(sign: int) -> None:
    digits = {
        "torque_digit": sign * 1e-3,
        "velocity_digit": sign * 1e-3,
        "position_digit": sign * 9.587379924285257e-05,
    }
    assert play(Monitor(watched(**digits)), Sound(sign=sign), 5.0) is None


@pytest.mark.parametrize(
    ("settings", "sound", "edit", "finding"),
    [
        ({"over_speed": 2.5}, {}, SOUND, "joint_speed"),
        ({"motor_over_speed": 2.5}, {}, SOUND, "motor_speed"),
        ({"encoder_id": None, "over_speed": 2.5, "velocity_digit": 0.0}, {}, SOUND, "joint_speed"),
        ({"travel": (-1.5, 0.4)}, {}, SOUND, "travel"),
        ({"velocity_digit": 0.0}, {"torque": 1.9}, held((POSITION, JOINT), AT, 4), "stuck"),
        ({}, {"amplitude": 0.0}, held((POSITION, MOTION), AT), "frozen"),
    ],
    ids=["joint", "motor", "joint by the motor", "travel", "position stuck without 0x606C", "feedback frozen at rest"],
)
def test_what_is_wrong_with_these_limits_is_found(
    settings: dict[str, object], sound: dict[str, float], edit: Edit, finding: str
) -> None:
    stop = play(Monitor(watched(**settings)), Sound(**sound), 2.0, edit)
    assert stop is not None
    assert stop.id == finding
    if finding == "travel":
        assert stop.detail == "axis 'knee': 0.40 rad, the limits are -1.5 and 0.4 rad"


@pytest.mark.parametrize("trial", [name for name in TRIALS if name != "two SYNCs"])
def test_nothing_is_acted_on_while_torque_is_off(trial: str) -> None:
    sound = Sound()
    sound.controlword, sound.statusword = 0x06, READY

    def edit(t: float, frames: list[Frame]) -> list[Frame]:
        return [(i, b"\x06" + data[1:] if i == RPDO else data) for i, data in TRIALS[trial][1](t, frames)]

    assert play(Monitor(watched()), sound, 1.5, edit) is None


@pytest.mark.parametrize(
    ("frame", "notices"),
    [
        ((0x100, bytes(6)), ["time"]),
        ((0x7E5, b"\x5e" + bytes(7)), ["lss_question"]),
        ((0x601, bytes.fromhex("4016100100000000")), []),
        ((0x000, b"\x02\x05"), []),
        ((0x123, bytes(8)), []),
        ((SYNC | 0x20000000, bytes(8)), []),
    ],
)
def test_what_moves_no_node_is_noticed_at_most(frame: Frame, notices: list[str]) -> None:
    monitor = Monitor(watched())
    assert play(monitor, Sound(), 1.5, added(AT, frame, last=AT)) is None
    assert list(monitor.notices) == notices


def test_answers_that_are_late_by_one_sync_are_no_surplus() -> None:
    late: list[Frame] = []

    def edit(t: float, frames: list[Frame]) -> list[Frame]:
        answers = [frame for frame in frames if frame[0] == MOTION]
        others = [frame for frame in frames if frame[0] != MOTION]
        before, late[:] = list(late), answers if round(t / PERIOD) % 7 == 0 else []
        return [others[0], *before, *([] if late else answers), *others[1:]]

    assert play(Monitor(watched()), Sound(), 2.0, edit) is None


def test_frames_that_a_bus_error_repeats_now_and_then_are_forgiven() -> None:
    def edit(t: float, frames: list[Frame]) -> list[Frame]:
        return [*frames, frames[1]] if round(t / PERIOD) % 50 == 0 else frames

    assert play(Monitor(watched()), Sound(), 3.0, edit) is None


def test_the_first_cause_is_kept() -> None:
    monitor = Monitor(watched())
    play(monitor, Sound(), 1.2, added(AT, (0x000, b"\x80\x01"), (0x7E5, b"\x04\x01" + bytes(6))))
    assert monitor.stop is not None
    assert monitor.stop.id == "nmt"


def test_the_stop_is_nmt_first_and_a_drive_that_ignores_it_is_disabled_by_sdo() -> None:
    monitor = Monitor(watched())
    assert monitor.action(0) == [(0x000, b"\x02\x01")]
    assert monitor.action(1) == [
        (0x000, b"\x80\x01"),
        (0x601, bytes.fromhex("2b40600000000000")),
        (0x601, bytes.fromhex("4041600000000000")),
    ]


def test_the_second_axis_of_a_device_has_objects_and_identifiers_of_its_own() -> None:
    monitor = Monitor(watched(slot=2, encoder_id=None))
    assert monitor.action(1)[1:] == [
        (0x601, bytes.fromhex("2b40680000000000")),
        (0x601, bytes.fromhex("4041680000000000")),
    ]
    monitor.step((0x301, b"\x0f\x00\x00\x0f"), 1.0)
    assert monitor.stop is not None
    assert monitor.stop.id == "command_torque"


@pytest.mark.parametrize(
    ("answer", "confirmed"),
    [
        ((0x581, bytes.fromhex("4b41600037120000")), False),
        ((0x581, bytes.fromhex("4b41600031120000")), True),
        ((0x581, bytes.fromhex("4b41680031120000")), False),
        ((0x581, bytes.fromhex("8041600000000008")), False),
        ((MOTION, struct.pack("<Hhi", 0x1218, 0, 0)), True),
        ((MOTION, struct.pack("<Hhi", 0x121F, 0, 0)), False),
        ((0x701, b"\x04"), False),
    ],
)
def test_only_a_state_without_torque_confirms_the_stop(answer: Frame, confirmed: bool) -> None:
    monitor = Monitor(watched())
    play(monitor, Sound(), 1.1, added(AT, (0x000, b"\x80\x01")))
    assert not monitor.confirmed
    monitor.step(answer, 1.2)
    assert monitor.confirmed is confirmed


def test_counters_that_wrap_are_followed() -> None:
    def edit(t: float, frames: list[Frame]) -> list[Frame]:
        shift = (1 << 31) - 200
        return [
            (i, struct.pack("<I", (struct.unpack_from("<I", data)[0] + shift) & 0xFFFFFFFF) + data[4:])
            if i in (POSITION, JOINT)
            else (i, data)
            for i, data in frames
        ]

    zero = {"joint_zero": (1 << 31) - 200}
    assert play(Monitor(watched(**zero)), Sound(), 2.0, edit) is None
