"""Test velocity and acceleration calculated from joint angles: no delay and the least possible noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsa_ctrl.control.motion_filter import HALF, JERK, LONGEST, MOST_EXPECTED, JointAngle, Motion

PERIOD = 1e-3


def count(bits: int) -> float:
    """Return the angle of one encoder count, rad."""
    return 2.0 * math.pi / (1 << bits)


def fed(angles: np.ndarray, bits: int = 20) -> Motion:
    motion = Motion(PERIOD, count(bits), 6e-3)
    for angle in angles:
        motion.update(count(bits) * math.floor(float(angle) / count(bits)))
    return motion


def test_a_steady_acceleration_is_followed_without_delay() -> None:
    """For a parabolic motion, velocity and acceleration equal the exact values at its end."""
    t = np.arange(0.0, 0.5, PERIOD)
    motion = fed(0.1 + 2.0 * t - 40.0 * t * t)
    assert motion.velocity == pytest.approx(2.0 - 80.0 * t[-1], abs=0.01)
    assert motion.acceleration == pytest.approx(-80.0, abs=1.0)


def test_a_reversal_is_foretold() -> None:
    """For a swing of 1 Hz and 1 rad, the prediction 6 ms ahead is accurate to 1.5 ms."""
    motion = Motion(PERIOD, count(20), 6e-3)
    t = np.arange(0.0, 1.5, PERIOD)
    found = []
    for s in t:
        motion.update(count(20) * math.floor(math.sin(2.0 * math.pi * s) / count(20)))
        found.append(motion.velocity + 6e-3 * motion.acceleration)
    seen = t[np.flatnonzero(np.diff(np.sign(found[100:]))) + 100]
    np.testing.assert_allclose(seen + 6e-3, [0.25, 0.75, 1.25], atol=1.5e-3)


@pytest.mark.parametrize("bits", [12, 14, 17, 20])
def test_standstill_on_the_edge_of_a_count_is_quieter_than_it_says(bits: int) -> None:
    """For a random pattern of one count up and down, the predicted velocity stays below 1.5 times `noise`."""
    motion = Motion(PERIOD, count(bits), 6e-3)
    worst = 0.0
    for edge in np.random.default_rng(bits).integers(0, 2, 10_000):
        motion.update(count(bits) * float(edge))
        worst = max(worst, abs(motion.velocity + 6e-3 * motion.acceleration))
    assert 0.0 < worst < 1.5 * motion.noise


def test_memory_grows_where_counts_are_coarse_and_no_further() -> None:
    memories = [Motion(PERIOD, count(bits), 6e-3).memory for bits in range(20, 7, -1)]
    assert memories == sorted(memories)
    assert memories[0] < 0.5 * memories[6] < memories[-1] <= LONGEST


@pytest.mark.parametrize("bits", [14, 16, 20])
@pytest.mark.parametrize("period", [1e-3, 2.5e-3, 4e-3])
def test_no_longer_memory_predicts_better(bits: int, period: float) -> None:
    """The sum of squares of two errors is smallest: one encoder count, and a change of the acceleration."""
    ahead = 5e-3 + 3.0 * period

    def predicted(motion: Motion, angles: np.ndarray) -> np.ndarray:
        found = []
        for angle in angles.tolist():
            motion.update(angle)
            found.append(motion.velocity + ahead * motion.acceleration)
        return np.array(found)

    def error(shortest: float) -> float:
        noise = np.abs(predicted(Motion(period, count(bits), ahead, shortest), np.r_[0.0, np.full(400, count(bits))]))
        t = period * np.arange(400)
        lag = predicted(Motion(period, count(bits), ahead, shortest), JERK * t**3 / 6.0)[-1]
        return math.hypot(float(noise.max()), JERK * (t[-1] + ahead) ** 2 / 2.0 - lag)

    chosen = Motion(period, count(bits), ahead).memory
    assert error(chosen) < error(1.3 * chosen) < error(2.0 * chosen)


def test_a_missing_answer_is_no_standstill() -> None:
    """Three cycles without a fresh angle in steady motion do not change the velocity."""
    motion = fed(2.0 * np.arange(0.0, 0.2, PERIOD))
    for _ in range(3):
        motion.update(math.nan, fresh=False)
    motion.update(2.0 * 0.203)
    assert motion.velocity == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize("bits", [12, 20])
@pytest.mark.parametrize("missing", [MOST_EXPECTED, 60_000])
def test_a_joint_that_stops_during_a_long_gap_is_at_rest_after_it(bits: int, missing: int) -> None:
    """Regression test: the parabola went on for the whole gap, and looked like motion for 0.1 s afterwards."""
    t = np.arange(0.0, 0.2, PERIOD)
    motion = fed(2.0 * t - 10.0 * t * t, bits)
    for _ in range(missing):
        motion.update(math.nan, fresh=False)
    assert (motion.velocity, motion.acceleration) == (0.0, 0.0)
    for _ in range(20):
        motion.update(0.3)
    assert (motion.angle, motion.velocity, motion.acceleration) == (0.3, 0.0, 0.0)


def test_before_two_angles_nothing_moves() -> None:
    motion = Motion(PERIOD, count(20), 6e-3)
    motion.update(math.nan)
    motion.update(1.0)
    assert (motion.velocity, motion.acceleration) == (0.0, 0.0)


def refined(angle: np.ndarray, motor: np.ndarray, bits: int = 12, turning: bool = False) -> np.ndarray:
    """Return the refined angle (rad) of a joint with a coarse encoder and the motor angle `motor`, (n,)."""
    joint = JointAngle(count(bits), PERIOD)
    readings = count(bits) * np.round(angle / count(bits))
    speeds = np.gradient(angle, PERIOD)
    values = zip(readings.tolist(), motor.tolist(), speeds.tolist(), strict=True)
    return np.array([joint.update(reading, of_motor, speed, turning) for reading, of_motor, speed in values])


SWING = 0.5 * np.sin(2.0 * math.pi * np.arange(0.0, 2.0, PERIOD))  # rad


@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_the_motor_refines_a_coarse_encoder(offset: float) -> None:
    """After the first counts, the error is less than half of the rounding error, for any zero of the motor's angle."""
    found = refined(SWING, SWING + offset)[200:] - SWING[200:]
    rounding = count(12) * np.round(SWING / count(12))[200:] - SWING[200:]
    assert np.std(found) < 0.5 * np.std(rounding)


def test_while_the_friction_term_turns_the_velocity_carries_on() -> None:
    wild = np.cumsum(np.random.default_rng(5).normal(0.0, 1e-3, SWING.size))
    np.testing.assert_array_equal(refined(SWING, wild, turning=True), refined(SWING, -wild, turning=True))


@pytest.mark.parametrize("seed", range(2))
def test_no_motor_takes_the_angle_from_the_encoders_count(seed: int) -> None:
    """With a random motor angle, the refined angle stays within `HALF` counts of the encoder reading."""
    wild = np.cumsum(np.random.default_rng(seed).normal(0.0, 1e-2, SWING.size))
    readings = count(12) * np.round(SWING / count(12))
    assert np.abs(refined(SWING, wild) - readings).max() <= HALF * count(12) + 1e-12


def test_a_joint_at_rest_does_not_follow_the_motor() -> None:
    """The refined angle of a locked joint stays constant while the motor elongates the tendons by several counts."""
    angle = np.zeros(1000)
    found = refined(angle, np.linspace(0.0, 5.0 * count(12), 1000))
    assert np.ptp(found[50:]) == 0.0


def test_a_motor_angle_that_is_missing_leaves_the_encoders() -> None:
    found = refined(SWING, np.full(SWING.size, math.nan))
    assert np.abs(found - SWING).max() <= (HALF + 0.5) * count(12)
