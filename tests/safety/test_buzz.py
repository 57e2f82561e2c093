"""A motor that buzzes, told from reversals, noise and a set-point that is fast itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsa_ctrl.safety.buzz import Buzz

PERIOD = 1e-3
LEVEL = 0.03  # N*m RMS


def watch(added: np.ndarray, wanted: np.ndarray | None = None, period: float = PERIOD) -> list[int]:
    """Cycles in which it is said to buzz."""
    buzz = Buzz(LEVEL, period)
    other = np.zeros_like(added) if wanted is None else wanted
    return [n for n, pair in enumerate(zip(added.tolist(), other.tolist(), strict=True)) if buzz.update(*pair)]


def times(seconds: float, period: float = PERIOD) -> np.ndarray:
    return np.arange(0.0, seconds, period)


@pytest.mark.parametrize("period", [2e-3, 1e-3, 5e-4])
@pytest.mark.parametrize("share", [0.06, 0.1, 0.2, 1.0 / 3.0])
def test_a_swing_up_to_a_third_of_the_rate_is_seen_within_half_a_second(period: float, share: float) -> None:
    t = times(1.0, period)
    found = watch(0.3 + 0.1 * np.sin(2.0 * math.pi * share * t / period), period=period)
    assert found
    assert found[0] * period <= 0.5


def test_its_frequency_is_told() -> None:
    buzz = Buzz(LEVEL, PERIOD)
    for value in (0.15 * np.sin(2.0 * math.pi * 41.0 * times(0.5))).tolist():
        buzz.update(value, 0.0)
    assert buzz.frequency == pytest.approx(41.0, abs=2.0)


@pytest.mark.parametrize("frequency", [0.5, 2.0, 5.0])
def test_the_turns_of_a_motion_are_left_alone(frequency: float) -> None:
    """The friction term of a joint that is moved to and fro: steps of 0.9 N*m, within 8 ms, and ringing after them."""
    t = times(6.0)
    turns = 0.45 * np.sign(np.sin(2.0 * math.pi * frequency * t))
    turns = np.convolve(turns, np.hanning(8) / np.hanning(8).sum(), "same")
    since = (t * 2.0 * frequency % 1.0) / (2.0 * frequency)
    ringing = 0.05 * np.exp(-since / 0.02) * np.sin(2.0 * math.pi * 100.0 * t)
    assert watch(turns + ringing) == []


def test_noise_is_left_alone() -> None:
    """Of the measured speed in the damping."""
    assert watch(np.random.default_rng(3).normal(0.0, 0.02, 10_000)) == []


def test_a_set_point_that_is_as_fast_explains_it() -> None:
    t = times(3.0)
    swing = np.sin(2.0 * math.pi * 30.0 * t)
    assert watch(0.2 * swing, 0.2 * swing) == []
    assert watch(0.2 * swing, 0.2 * np.sin(2.0 * math.pi * t)) != []


def test_a_short_swing_is_left_alone() -> None:
    t = times(3.0)
    assert watch(np.where(t < 0.35, 0.2 * np.sin(2.0 * math.pi * 60.0 * t), 0.0)) == []


def test_what_is_not_finite_does_not_stick_and_reset_forgets() -> None:
    buzz = Buzz(LEVEL, PERIOD)
    swing = (0.2 * np.sin(2.0 * math.pi * 60.0 * times(0.42))).tolist()
    for value in swing[:380]:
        assert not buzz.update(value, 0.0)
    buzz.reset()
    for value in [math.nan, math.inf, *swing[:380]]:
        assert not buzz.update(value, 0.0)
    assert any(buzz.update(value, 0.0) for value in swing[380:])
