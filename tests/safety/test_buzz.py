"""Detection of a chattering motor, as opposed to reversals, noise and a fast set-point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from tsa_ctrl.safety.compensation_backoff import ChatterDetector

PERIOD = 1e-3
LEVEL = 0.03  # N*m RMS


def watch(added: np.ndarray, wanted: np.ndarray | None = None, period: float = PERIOD) -> list[int]:
    """Return the cycles in which chatter is detected."""
    buzz = ChatterDetector(LEVEL, period)
    other = np.zeros_like(added) if wanted is None else wanted
    return [n for n, pair in enumerate(zip(added.tolist(), other.tolist(), strict=True)) if buzz.update(*pair)]


def above(values: np.ndarray, period: float) -> np.ndarray:
    """Return the part of the values above 20 Hz, from the second value on.

    The previous output of a first-order low-pass is subtracted from each value.
    """
    keep = math.exp(-2.0 * math.pi * 20.0 * period)
    slow = lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])[0]
    return np.asarray(values[1:] - slow[:-1])


def foretold(added: np.ndarray, wanted: np.ndarray, period: float) -> list[tuple[int, float]]:
    """Return the cycles and the frequencies (Hz) of the expected detections: ten loud blocks of 40 ms in a row."""
    fast, other = above(added, period), above(wanted, period)
    length = max(2, round(0.04 / period))
    turned = np.concatenate(([False], fast[1:] * fast[:-1] < 0.0))
    blocks = fast.size // length
    power, explained, turns = (
        part[: blocks * length].reshape(blocks, length).sum(axis=1)
        for part in (fast * fast, other * other, turned.astype(float))
    )
    loud = (power > LEVEL**2 * length) & (explained < 0.04 * power)
    found, begin = [], 0
    for block in range(blocks):
        if not loud[block]:
            begin = block + 1
        elif block + 1 - begin == 10:
            found.append(((block + 1) * length, turns[begin : block + 1].sum() / (20 * length * period)))
            begin = block + 1
    return found


def times(seconds: float, period: float = PERIOD) -> np.ndarray:
    return np.arange(0.0, seconds, period)


@pytest.mark.parametrize(("period", "drawn"), [(1e-3, 40), (2.5e-3, 20), (5e-2, 30)])
def test_is_told_in_the_cycle_in_which_ten_blocks_have_been_loud(period: float, drawn: int) -> None:
    """The oscillations start and stop. Their size is near the level, and the set-point nearly explains them."""
    draw = np.random.default_rng(5)
    told = 0
    for _ in range(drawn):
        t = times(2.5 if period < 0.01 else 20.0, period)
        frequency = math.exp(draw.uniform(math.log(10.0), math.log(300.0))) * min(1.0, 1e-3 / period)
        size = LEVEL * math.sqrt(2.0) * draw.uniform(0.8, 3.0)
        swing = size * np.sin(2.0 * math.pi * frequency * t + draw.uniform(0.0, 6.0))
        swing[t > draw.uniform(0.3, 2.0) * t[-1]] = 0.0
        added = 0.2 + swing + draw.normal(0.0, 1e-3, t.size)
        wanted = draw.uniform(0.0, 0.3) * np.roll(swing, 1) - 0.1
        buzz, found = ChatterDetector(LEVEL, period), []
        for n, pair in enumerate(zip(added.tolist(), wanted.tolist(), strict=True)):
            if buzz.update(*pair):
                found.append((n, buzz.frequency))
        expected = foretold(added, wanted, period)
        assert [n for n, _ in found] == [n for n, _ in expected]
        assert [hertz for _, hertz in found] == pytest.approx([hertz for _, hertz in expected])
        told += len(found)
    assert told > drawn / 2


@pytest.mark.parametrize("period", [2e-3, 1e-3, 5e-4])
@pytest.mark.parametrize("share", [0.06, 1.0 / 3.0])
def test_a_swing_up_to_a_third_of_the_rate_is_seen_within_half_a_second(period: float, share: float) -> None:
    t = times(1.0, period)
    found = watch(0.3 + 0.1 * np.sin(2.0 * math.pi * share * t / period), period=period)
    assert found
    assert found[0] * period <= 0.5


@pytest.mark.parametrize("frequency", [0.5, 2.0, 5.0])
def test_the_turns_of_a_motion_are_left_alone(frequency: float) -> None:
    """The friction term of a joint that moves to and fro has steps of 0.9 N*m within 8 ms, followed by ringing."""
    t = times(6.0)
    turns = 0.45 * np.sign(np.sin(2.0 * math.pi * frequency * t))
    turns = np.convolve(turns, np.hanning(8) / np.hanning(8).sum(), "same")
    since = (t * 2.0 * frequency % 1.0) / (2.0 * frequency)
    ringing = 0.05 * np.exp(-since / 0.02) * np.sin(2.0 * math.pi * 100.0 * t)
    assert watch(turns + ringing) == []


def test_what_is_not_finite_does_not_stick_and_reset_forgets() -> None:
    buzz = ChatterDetector(LEVEL, PERIOD)
    swing = (0.2 * np.sin(2.0 * math.pi * 60.0 * times(0.42))).tolist()
    for value in swing[:380]:
        assert not buzz.update(value, 0.0)
    buzz.reset()
    for value in [math.nan, math.inf, *swing[:380]]:
        assert not buzz.update(value, 0.0)
    assert any(buzz.update(value, 0.0) for value in swing[380:])
    assert buzz.frequency > 0.0
    buzz.reset()
    assert buzz.frequency == 0.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_number_that_no_torque_can_have_is_passed_over(side: float) -> None:
    """Samples are ignored if the sum of both torques exceeds a million. Below it, oscillations are detected."""
    swing = 4e5 * np.sin(2.0 * math.pi * 60.0 * times(0.5))
    added = side * 5e5 + swing
    assert watch(added, np.full_like(swing, side * 9e4)) != []  # 0.99e6 at its peaks
    assert watch(np.abs(added) * side, np.full_like(swing, side * 9.5e5)) == []
    few = np.where(np.arange(500) % 2, 0.2 * np.sin(2.0 * math.pi * 60.0 * times(0.5)), side * 1.01e6)
    assert watch(few) == []
    nan_first = np.concatenate(([math.nan, side * 1.01e6], 0.2 * np.sin(2.0 * math.pi * 60.0 * times(0.5))))
    assert [n - 2 for n in watch(nan_first)] == watch(nan_first[2:])


@pytest.mark.parametrize("period", [1e-3, 4e-3])
def test_the_turns_of_a_hand_that_trembles_are_looked_through(period: float) -> None:
    """The friction term steps 16 times per second. This is detected as chatter unless each step follows the joint."""
    t = times(2.0, period)
    phase = 8.0 * t % 0.5
    term = 0.2 * np.sign(np.sin(2.0 * math.pi * 8.0 * t + 1e-6))
    found = {}
    for name, follows in (("follows", phase < 0.02 * 8.0), ("not", np.zeros(t.size, dtype=bool))):
        buzz = ChatterDetector(LEVEL, period)
        found[name] = [
            buzz.update(*values) for values in zip(term.tolist(), [0.0] * t.size, follows.tolist(), strict=True)
        ]
    assert any(found["not"])
    assert not any(found["follows"])


def test_a_swing_is_told_between_the_turns_of_a_hand() -> None:
    t = times(3.0)
    follows = (8.0 * t % 0.5) < 0.04 * 8.0
    swing = 2.0 * LEVEL * np.sin(2.0 * math.pi * 70.0 * t)
    buzz = ChatterDetector(LEVEL, PERIOD)
    assert any(buzz.update(*values) for values in zip(swing.tolist(), [0.0] * t.size, follows.tolist(), strict=True))
