"""Test wrong signals on a running rig: the time to detection, and the band of the joint torque."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.virtual.joints import play, sine
from tests.virtual.test_runaway import added
from tsa_ctrl.virtual.result import Simulation

AT = 1.8  # s of the log, begin of the fault, while a sine of 0.5 Hz moves the joint
CONFIRMED = AT + 2.0  # s, the same phase after three strokes have proven the friction by the elongation
SOON = 0.1  # s
CONSTANT: dict[str, Any] = {"kind": "constant", "offset": 0.8}
BLIND: dict[str, Any] = {"torque_sensor": None}


def first(result: Simulation, at: float = AT) -> tuple[float, str]:
    """Return the time from the fault to the first latched fault, s, and its text."""
    fault = next(event for event in result.summary.events if event.fault)
    return fault.t - at, fault.text


@pytest.mark.slow
@pytest.mark.parametrize("axis", [{}, BLIND], ids=["sensor", "blind"])
@pytest.mark.parametrize("offset", [0.8, -0.6])
def test_a_motor_that_turns_the_wrong_way_while_its_torque_rests_is_found(
    tmp_path: Path, axis: dict[str, Any], offset: float
) -> None:
    """It is detected within 0.1 s and 20 mJ. Earlier versions needed 0.5 s and 738 mJ."""
    constant = {"kind": "constant", "offset": offset}
    result = play(tmp_path, "weight", constant, AT + 0.3, axis=axis, faults=[f"reversed_sign@{AT}"], compensation=0.95)
    after, _ = first(result)
    assert after < SOON
    assert added(result, AT) < 20e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("velocity_gain value=-1", "a velocity of"),
        ("velocity_gain value=2", "a velocity of"),
        ("position_stuck", "stuck"),
        ("motor_encoder_stuck", "stuck"),
        ("encoder_stuck", "encoder"),
        ("forged_tpdo node=encoder", "repeated PDOs: "),
    ],
)
def test_a_signal_that_contradicts_the_others_is_named(tmp_path: Path, fault: str, words: str) -> None:
    """The joint has a weight and moves at about 1 rad/s."""
    faults = [f"{fault}@{CONFIRMED}"]
    result = play(tmp_path, "weight", sine(0.5, 0.5), CONFIRMED + 0.4, axis=BLIND, faults=faults)
    after, said = first(result, CONFIRMED)
    assert after < SOON
    assert words in said


SLOW_JOINT = pytest.mark.xfail(
    reason="the wearer moves at 0.35 rad/s; below 0.5 rad/s the check does not separate a stuck encoder from a light "
    "joint that friction stops within 10 ms. No fault within 0.4 s (0.5 mJ), an event after 19 ms; a rule for a "
    "resting motor stopped a healthy limb"
)


@pytest.mark.slow
@pytest.mark.parametrize("load", ["weight", "limb", pytest.param("wearer", marks=SLOW_JOINT)])
def test_both_encoders_that_stick_while_the_joint_moves_are_found(tmp_path: Path, load: str) -> None:
    """The joint's encoder shows it after 10 ms, at 1.5 rad/s with a weight and 0.8 rad/s with a limb."""
    faults = [f"encoder_stuck@{CONFIRMED}", f"motor_encoder_stuck@{CONFIRMED}"]
    result = play(tmp_path, load, sine(0.5, 0.5), CONFIRMED + 0.4, axis=BLIND, faults=faults)
    after, said = first(result, CONFIRMED)
    assert after < SOON
    assert "encoder is stuck" in said


def beyond_band(result: Simulation, after: float) -> NDArray[np.bool_]:
    """Return True where the joint torque is outside its band, for the samples after this time (s) that have a band."""
    axis = result.axes[0]
    log, truth = axis.log, result.truth
    rows = np.searchsorted(truth["clock"], axis.start + log["t"] + log["lateness"]).clip(0, truth["clock"].size - 1)
    low, high, true = log["tau_j_stretch_low"], log["tau_j_stretch_high"], truth["tau_j"][rows]
    seen = np.isfinite(low) & (log["t"] > after) & (log["t"] < axis.until)
    return np.asarray((true[seen] < low[seen]) | (high[seen] < true[seen]))


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.8, -0.8])
@pytest.mark.parametrize("stiffness", [0.95, 1.05])
def test_the_band_contains_the_joint_torque_after_a_single_stroke(
    tmp_path: Path, stiffness: float, offset: float
) -> None:
    """The file's stiffness is wrong within its [uncertainty]. Earlier versions missed the torque by 50 mN*m."""
    constant = {"kind": "constant", "offset": offset}
    plant = {"perturbation": {"axial_stiffness": stiffness}}
    result = play(tmp_path, "weight", constant, 3.0, axis=BLIND, plant=plant, compensation=0.95)
    outside = beyond_band(result, 0.5)
    assert outside.size
    assert outside.sum() <= 0.05 * outside.size


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        "torque_gain value=2",
        "reported_offset value=0.2",
        "friction value=0.1",
    ],
)
def test_the_band_contains_the_joint_torque_though_the_reported_torque_is_wrong(tmp_path: Path, fault: str) -> None:
    """The band is compared with the plant's torque from 10 ms after the fault on, in samples that have a band."""
    result = play(tmp_path, "weight", sine(0.5, 0.5), 4.0, axis=BLIND, faults=[f"{fault}@{AT}"])
    axis = result.axes[0]
    log = axis.log
    low, high = log["tau_j_stretch_low"], log["tau_j_stretch_high"]
    outside = beyond_band(result, AT + 0.01)
    assert outside.sum() <= 0.05 * outside.size  # zero if the axis was stopped at once
    before = np.isfinite(low) & (log["t"] > 1.0) & (log["t"] < AT)
    assert np.mean((high - low)[before]) < 0.3  # N*m; the band is narrow without a contradiction
