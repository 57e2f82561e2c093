"""The joint's velocity and acceleration from its angles: not late, and as quiet as the encoder allows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsa_ctrl.control.motion_filter import LONGEST, QUIET, Motion

PERIOD = 1e-3


def count(bits: int) -> float:
    """rad"""
    return 2.0 * math.pi / (1 << bits)


def fed(angles: np.ndarray, bits: int = 20) -> Motion:
    motion = Motion(PERIOD, count(bits), 6e-3)
    for angle in angles:
        motion.update(count(bits) * math.floor(float(angle) / count(bits)))
    return motion


def test_a_steady_acceleration_is_followed_without_delay() -> None:
    """A parabola: velocity and acceleration are those of its end."""
    t = np.arange(0.0, 0.5, PERIOD)
    motion = fed(0.1 + 2.0 * t - 40.0 * t * t)
    assert motion.velocity == pytest.approx(2.0 - 80.0 * t[-1], abs=0.01)
    assert motion.acceleration == pytest.approx(-80.0, abs=1.0)


def test_a_reversal_is_foretold() -> None:
    """Of a swing of 1 Hz and 1 rad, 6 ms ahead, to half a millisecond."""
    motion = Motion(PERIOD, count(20), 6e-3)
    t = np.arange(0.0, 1.5, PERIOD)
    found = []
    for s in t:
        motion.update(count(20) * math.floor(math.sin(2.0 * math.pi * s) / count(20)))
        found.append(motion.velocity + 6e-3 * motion.acceleration)
    seen = t[np.flatnonzero(np.diff(np.sign(found[100:]))) + 100]
    np.testing.assert_allclose(seen + 6e-3, [0.25, 0.75, 1.25], atol=1.5e-3)


@pytest.mark.parametrize("bits", [12, 13, 14, 16, 17, 20])
def test_standstill_on_the_edge_of_a_count_is_quieter_than_it_says(bits: int) -> None:
    """Whatever the pattern of one count up and down is that trembling makes: no more than 1.5 times `noise`."""
    motion = Motion(PERIOD, count(bits), 6e-3)
    worst = 0.0
    for edge in np.random.default_rng(bits).integers(0, 2, 20_000):
        motion.update(count(bits) * float(edge))
        worst = max(worst, abs(motion.velocity + 6e-3 * motion.acceleration))
    assert 0.0 < worst < 1.5 * motion.noise


def test_memory_grows_where_counts_are_coarse_and_no_further() -> None:
    fine, coarse = Motion(PERIOD, count(20), 6e-3), Motion(PERIOD, count(12), 6e-3)
    assert fine.memory < coarse.memory == LONGEST
    assert fine.noise < QUIET < coarse.noise


def test_a_missing_answer_is_no_standstill() -> None:
    """Three cycles without a fresh angle in steady motion change nothing."""
    motion = fed(2.0 * np.arange(0.0, 0.2, PERIOD))
    for _ in range(3):
        motion.update(math.nan, fresh=False)
    motion.update(2.0 * 0.203)
    assert motion.velocity == pytest.approx(2.0, abs=0.01)


def test_before_two_angles_nothing_moves() -> None:
    motion = Motion(PERIOD, count(20), 6e-3)
    motion.update(math.nan)
    motion.update(1.0)
    assert (motion.velocity, motion.acceleration) == (0.0, 0.0)
