"""The excitation: within its bounds, smooth at both ends, away from the motion's frequencies, and rejected early."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

from tests.model.actuator import ACTUATOR
from tests.model.capstan import Pair
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.curvature import Profile
from tsa_ctrl.tune.excitation import (
    FREQUENCIES,
    Bounds,
    Response,
    apart,
    design,
    from_file,
    most_torque,
    multi_sine,
    playing,
    response,
)

BOUNDS = Bounds(torque=1.0, speed=4.0, travel=(-1.0, 1.0))
MOVED = Response(peak_speed=0.5, rms_speed=0.3, angle=(-0.1, 0.1), frequency=0.6, by_torque=0.9)
CARRIED = Response(peak_speed=3.0, rms_speed=1.0, angle=(0.0, 1.1), frequency=0.62, by_torque=0.05)


def test_a_waveform_begins_and_ends_at_zero_and_reaches_its_peak() -> None:
    wave = multi_sine(FREQUENCIES, 0.7, 20.0)
    assert wave.tau_j_des[0] == wave.tau_j_des[-1] == 0.0
    assert (wave.peak, wave.seconds) == pytest.approx((0.7, 20.0))


def test_a_file_is_played_ramped_and_no_higher_than_the_design_allows(tmp_path: Path) -> None:
    designed = design(CARRIED, 0.2, BOUNDS, 20.0, 8.0)
    (tmp_path / "experiment.csv").write_text("t,tau_j_des\n0,2\n5,2\n10,-2\n")
    wave = from_file(tmp_path / "experiment.csv")
    assert wave.tau_j_des[0] == wave.tau_j_des[-1] == 0.0
    assert np.interp(3.0, wave.t, wave.tau_j_des) == pytest.approx(2.0)
    found = playing(designed, wave)
    assert found.excitation.peak == pytest.approx(BOUNDS.torque)
    assert found.excitation.seconds == pytest.approx(10.0, abs=0.02)
    assert "50% of its torque" in found.reasons[-1]
    (tmp_path / "experiment.csv").write_text("t,tau_j_des\n0,0\n5,0.4\n10,0\n")
    wave = from_file(tmp_path / "experiment.csv")
    assert playing(designed, wave).excitation.peak == wave.peak


@pytest.mark.parametrize(
    "text",
    ["t,tau_j_des\n0,0\n10,0\n", "t,tau_j_des\n0,0\n1,0.2\n", "t,torque\n0,1\n9,2\n", "t,tau_j_des\n0,1\n1e9,2\n"],
)
def test_a_file_that_cannot_excite_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "experiment.csv").write_text(text)
    with pytest.raises(UsageError, match=r"experiment\.csv"):
        from_file(tmp_path / "experiment.csv")


@pytest.mark.parametrize("x", [0.05, 0.3, 0.6, 0.9, 1.2])
@pytest.mark.parametrize("shape", ["file", "motor_end", "uniform"])
def test_a_torque_can_excite_every_friction_angle(x: float, shape: str) -> None:
    """Both tendons are under tension by the capstan equation, even if friction angle and pretension are a fifth off."""
    model = dataclasses.replace(ACTUATOR, friction_coefficient=x / ACTUATOR.bending_angle)
    profile = {"file": "joint_end", "motor_end": "motor_end", "uniform": "uniform"}[shape]
    if shape != "file":
        model = model.with_effects({"elongation_coupling": {"curvature_profile": profile}})
    torque = most_torque(model, 100.0)
    assert torque > 0.05
    for off in (0.8, 1.2):
        pair = Pair(Profile.of(profile).points[1:], off * x, pretension=0.8 * ACTUATOR.pretension)
        for wanted, way in itertools.product((torque, -torque), (1.0, -1.0)):
            at_rest = pair.joint_torque(0.0, way)
            motor = (wanted - at_rest) / (pair.joint_torque(1.0, way) - at_rest)
            assert min(pair.motor_tensions(motor, way)) > 0.0


def test_the_motor_limit_bounds_the_torque() -> None:
    assert most_torque(ACTUATOR, 0.8) < most_torque(ACTUATOR, 1.0) < most_torque(ACTUATOR, 100.0)
    with pytest.raises(UsageError, match=r"hardly overcomes .* up to 0.544 N\*m .*; raise limits.torque, or lower"):
        most_torque(ACTUATOR, 0.1)


@pytest.mark.parametrize(
    ("found", "bounds", "words"),
    [
        (dataclasses.replace(MOVED, rms_speed=0.001), BOUNDS, "hardly moves"),
        (CARRIED, Bounds(1.0, 2.0), "moved at up to 3"),
    ],
)
def test_a_joint_that_stands_or_is_moved_too_fast_is_refused(found: Response, bounds: Bounds, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        design(found, 0.2, bounds, 20.0, 8.0)


def test_a_joint_moved_from_outside_gets_the_full_torque_at_other_frequencies() -> None:
    found = design(CARRIED, 0.2, BOUNDS, 20.0, 8.0)
    assert found.excitation.peak == pytest.approx(1.0)
    spectrum = np.abs(np.fft.rfft(found.excitation.tau_j_des))
    frequency = np.fft.rfftfreq(found.excitation.t.size, 0.005)
    assert abs(frequency[int(np.argmax(spectrum))] - CARRIED.frequency) > 0.05
    assert "moved from outside" in found.reasons[0]


@pytest.mark.parametrize(
    ("bounds", "factor"),
    [(Bounds(10.0, 1.0), 1.0 / 0.5), (Bounds(10.0, 100.0, (-0.2, 0.3)), 0.2 / 0.1)],
    ids=["speed", "travel"],
)
def test_a_joint_that_the_torque_moves_stays_within_its_bounds(bounds: Bounds, factor: float) -> None:
    assert design(MOVED, 0.2, bounds, 20.0, 8.0).excitation.peak == pytest.approx(0.2 * 0.7 * factor)


def test_the_verification_is_gentler_and_another_motion() -> None:
    found = design(CARRIED, 0.2, BOUNDS, 20.0, 20.0)
    assert found.verification.peak < found.excitation.peak
    a, b = found.excitation.tau_j_des, found.verification.tau_j_des
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.3


@pytest.mark.parametrize("motion", [0.1, 0.3, 0.53, 0.6, 1.0, 3.0])
def test_frequencies_keep_their_distance_from_the_motion_and_its_harmonics(motion: float) -> None:
    for frequency in FREQUENCIES:
        moved = apart(frequency, motion)
        order = max(1, round(moved / motion))
        assert abs(moved - order * motion) > 0.1 * motion


def record(omega: np.ndarray, tau_m: np.ndarray) -> Dataset:
    t = np.arange(omega.size) / 200.0
    return Dataset.from_arrays({"t": t, "tau_m": tau_m, "omega_j": omega, "q_j": np.cumsum(omega) / 200.0}, "probe")


def test_a_response_tells_who_moves_the_joint() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 10.0, 0.005)
    torque = 0.2 * np.sin(2.0 * np.pi * 0.5 * t)
    own = record(0.8 * np.roll(torque, 40) + 0.01 * rng.normal(size=t.size), torque)
    others = record(np.sin(2.0 * np.pi * 0.63 * t), torque)
    assert response(own).by_torque > 0.9
    assert response(others).by_torque < 0.2
    assert response(others).frequency == pytest.approx(0.63, abs=0.06)
    assert response(others).peak_speed == pytest.approx(1.0, abs=0.01)
