"""Test faulty signals on a running rig, in virtual time, with the real loop, supervision and plant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.virtual.joints import GAIT, play, sine
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.safety.causes import Cause
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change

NOISY = {"torque_sensor": {"noise": 5e-3}}
CONSTANT = {"kind": "constant", "offset": 0.5}


SINE = sine(0.8, 1.0)
CHANGED = "a node's configuration changed: drive node 1: 0x"
WRONG = [  # fault with its time, load, set-point, latest time of detection (s), start of the event's text
    # three answers in a row are never lost, so that the limit for consecutive losses is not reached
    ("sparse_tpdo value=2 node=encoder@0.8", "held", CONSTANT, 1.11, "stale PDO: 200 cycles within a second"),
    ("repeated_tpdo@0.8", "held", CONSTANT, 0.86, "repeated PDOs: drive node 1: "),
    # the SDO disables the drive's monitoring of the heartbeat; the torque ends before it is needed
    ("foreign_sdo node=encoder@0.8", "held", CONSTANT, 0.805, "second master: another node sent a master's frame 0x6"),
    # no frame shows it; the values that were written at startup are read back in spare bus time
    ("watchdogs_lost@0.8", "held", CONSTANT, 2.8, f"{CHANGED}1"),
    # the offset is read back every 0.1 s, and a change is confirmed once
    ("torque_offset value=30@0.8", "held", CONSTANT, 1.0, f"{CHANGED}60B2:0 torque offset is "),
    # each command that arrives restarts the drive's RPDO timer of 20 ms, so that it never expires
    ("sparse_rpdo value=19@0.8", "held", SINE, 1.9, "the drive misses commands: drive node 1 held an older command "),
    # the motor begins to turn the wrong way; if the polarity was shown before, the contradiction must last 0.4 s,
    # because oscillating tendons look reversed for up to 0.3 s
    ("reversed_sign@1.1", "imposed", GAIT, 2.3, ""),
    ("reversed_sign@1.1", "held", SINE, 2.3, ""),
]


def fault_of(result: Simulation) -> Event:
    return next(event for event in result.summary.events if event.fault)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "load", "setpoint", "until", "words"), WRONG, ids=[row[0] for row in WRONG])
def test_a_faulty_signal_stops_the_axis(
    tmp_path: Path, fault: str, load: str, setpoint: dict[str, Any], until: float, words: str
) -> None:
    found = fault_of(play(tmp_path, load, setpoint, until + 0.1, faults=[fault]))
    assert found.text.startswith(words)
    assert found.t < until


def spread(line: str, first: float, step: float, count: int) -> list[str]:
    return [f"{line}@{first + step * n}" for n in range(count)]


SHORT_LOSSES = [  # losses, set-point, seconds, and the text of the only event, which does not stop the axis
    # a twelfth of the answers is lost
    (spread("missing_tpdo node=encoder duration=0.001", 0.8, 0.0125, 120), CONSTANT, 2.6, "joint encoder node 32"),
    # five commands in a row are lost every 33 ms; a tenth of the values is three cycles old
    (spread("rpdo_lost duration=0.005", 0.81, 0.0333, 75), SINE, 3.6, "drive node 1 held an older command "),
    (spread("repeated_tpdo duration=0.001", 0.8, 0.05, 8), CONSTANT, 1.2, ""),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("losses", "setpoint", "seconds", "words"), SHORT_LOSSES, ids=["answers", "commands", "repeated"]
)
def test_short_losses_are_told_once_and_the_axis_goes_on(
    tmp_path: Path, losses: list[str], setpoint: dict[str, Any], seconds: float, words: str
) -> None:
    result = play(tmp_path, "held", setpoint, seconds, faults=losses)
    told = ("cycles were without all answers", "times that 0x6071 was read back")
    said = [event.text for event in result.summary.events if any(text in event.text for text in told)]
    assert not result.axes[0].faults
    assert len(said) == bool(words)
    assert words in "".join(said)


def test_a_motor_that_gives_twice_what_it_reports_is_found(tmp_path: Path) -> None:
    """It is detected on a locked joint. On a moving joint, reversing friction may follow the torque as much."""
    found = fault_of(play(tmp_path, "held", sine(0.8, 0.5), 0.6, known=False, faults=["torque_gain@0.001"]))
    assert "the motor gives more than it reports" in found.text
    assert found.t < 0.5


def test_a_torque_sensor_that_sticks_is_found(tmp_path: Path) -> None:
    """Friction may hold the joint torque constant, so the missing noise shows the fault."""
    faults = ["stuck_tpdo node=torque_sensor@1.3"]
    found = fault_of(play(tmp_path, "held", sine(0.5, 0.5), 1.5, faults=faults, plant=NOISY))
    assert found.text.startswith("joint torque sensor is stuck: ")
    assert found.t < 1.4


@pytest.mark.slow
def test_a_lie_is_found_though_the_truth_is_told_now_and_then(tmp_path: Path) -> None:
    """The motor turns the wrong way for 0.05 s in each 0.1 s, and so never for a full 0.1 s."""
    strict = {"plausibility": {"joint_torque": 0.5}}
    flaps = spread("reversed_sign duration=0.05", 0.8, 0.1, 8)
    found = fault_of(play(tmp_path, "held", CONSTANT, 1.6, axis=strict, faults=flaps))
    contradictions = (
        Cause.POLARITY,
        Cause.TORQUE_ERROR,
        Cause.FROZEN,
        Cause.VELOCITY,
        Cause.ENCODER_STUCK,
        Cause.JOINT_TORQUE,
        Cause.TORQUE_GAIN,
        Cause.SOFT_TENDONS,
    )
    assert found.cause_id in {cause.id for cause in contradictions}


@pytest.mark.slow
def test_a_second_drive_of_the_same_id_is_found_before_a_recovery_enables_anything(tmp_path: Path) -> None:
    faults = ["heartbeat_lost duration=0.3@0.7", "repeated_tpdo@1.1"]
    result = play(tmp_path, "held", CONSTANT, 2.5, faults=faults, changes=(Change("recover", 1.0, 1.3),))
    said = [event.text for event in result.summary.events]
    assert any(text.startswith("recovery failed: axis 'joint' drive node 1: sent ") for text in said), said
    assert not result.truth["enabled"][result.truth["clock"] > result.axes[0].start + 1.0].any()


LOADS = ["imposed", "held", "spring", "weight", "free", "limb", "wearer"]
BETWEEN = ("spring", "weight", "limb")  # joints between a locked and a free one


@pytest.mark.parametrize(
    ("load", "sensor"),
    [
        *((load, True) for load in LOADS),
        *(pytest.param(load, False, marks=pytest.mark.slow) for load in LOADS if load not in BETWEEN),
    ],
)
def test_a_motor_that_turns_the_wrong_way_is_found_at_the_enable(tmp_path: Path, load: str, sensor: bool) -> None:
    """It is detected at 15 % of the torque limit, before the joint has moved. A joint torque sensor is not needed."""
    setpoint = GAIT if load == "imposed" else {"kind": "constant", "offset": 0.8}
    changes = {"law": {"fade_in": 0.01}, "plausibility": {"joint_torque": 0.2 if sensor else 100.0}}
    result = play(tmp_path, load, setpoint, 0.8, axis=changes, faults=["reversed_sign@0"])
    fault = fault_of(result)
    assert "the wrong way round" in fault.text or "another torque than it reports" in fault.text
    assert np.abs(result.truth["tau_m"]).max() <= 0.15 * 2.5 + 0.02
    if load != "imposed":
        assert np.abs(result.truth["omega_j"]).max() < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["", "reversed_sign@0"])
def test_a_wearer_who_begins_to_move_as_the_torque_begins_is_no_reversed_motor(tmp_path: Path, fault: str) -> None:
    """A sheath with bends at the motor holds any motor, and the wearer's motion elongates the tendons."""
    hand = [[0.0, 15.0, 1.0, 0.0], [0.1, 15.0, 1.0, 0.0], [1.6, 15.0, 1.0, -0.4]]
    wearer = {"joint": {"hand": hand, "hand_repeat": False}}
    faults = [fault] if fault else []
    result = play(tmp_path, "wearer", sine(-0.8, 0.5), 1.5, curvature="motor_end", plant=wearer, faults=faults)
    found = [event.text for event in result.summary.events if event.fault]
    assert bool(found) is bool(fault), found
    assert all("the wrong way round" in text for text in found)
    if fault:  # a healthy motor slides once the wearer has moved a little, and its torque may then grow
        assert np.abs(result.truth["tau_m"]).max() <= 0.15 * 2.5 + 0.02


@pytest.mark.slow
def test_a_torn_tendon_is_found_before_it_throws_the_joint(tmp_path: Path) -> None:
    """Either tendon is torn. Until detection the joint exceeds the speed of a healthy one by less than 2 rad/s."""
    sound = play(tmp_path, "free", sine(0.8, 0.5), 2.6)
    assert not sound.axes[0].faults
    same_t, same = sound.truth["clock"] - sound.axes[0].start, np.abs(sound.truth["omega_j"])
    for tendon in (0, 1):
        result = play(tmp_path, "free", sine(0.8, 0.5), 2.6, faults=[f"torn_tendon value={tendon}@1.2"])
        fault = fault_of(result)
        t, speed = result.truth["clock"] - result.axes[0].start, np.abs(result.truth["omega_j"])
        until = speed[(t > 1.2) & (t < fault.t)].max()
        assert until < same[(same_t > 1.1) & (same_t < fault.t)].max() + 2.0, tendon


@pytest.mark.slow
def test_a_joint_encoder_that_sticks_is_found_before_the_joint_is_thrown(tmp_path: Path) -> None:
    """It repeats its last value. The motor moves farther than the torque can elongate the tendons."""
    result = play(tmp_path, "limb", sine(0.8, 1.0), 1.8, faults=["stuck_tpdo node=encoder@1.1"])
    fault = fault_of(result)
    assert "stuck" in fault.text
    t, angle = result.truth["clock"] - result.axes[0].start, result.truth["q_m"]
    until = (t > 1.1) & (t < fault.t)
    assert np.ptp(angle[until]) < 0.15  # the torque elongates the tendons by 0.02 rad; earlier versions allowed 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "motor", "joint"),
    [
        ("held", 12, 20),
        ("spring", 16, 12),
    ],
)
def test_a_motor_that_turns_the_wrong_way_is_found_by_coarse_encoders_and_a_healthy_one_is_not(
    tmp_path: Path, load: str, motor: int, joint: int
) -> None:
    """A count is coarser than the elongation by a small torque, and a single count is no evidence."""
    ours = {"drive": {"counts_per_revolution": 1 << motor}, "encoder": {"counts_per_revolution": 1 << joint}}
    for fault in ("", "reversed_sign"):
        faults = [f"{fault}@0"] if fault else []
        result = play(tmp_path, load, sine(0.5, 0.25), 1.6, axis=ours, plant=ours, compensation=0.95, faults=faults)
        (axis,) = result.axes
        assert bool(axis.faults) is bool(fault)
        assert all("the wrong way round" in text for text in axis.faults)
        if fault:
            assert np.abs(result.truth["omega_j"]).max() < 0.05  # rad/s
