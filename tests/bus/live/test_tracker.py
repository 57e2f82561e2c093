"""Test the conversion of encoder counts to angle and velocity."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.bus.live.axis import PositionTracker

COUNTS = 4096


def tracker(counts_range: int = 1 << 32, zero: int = 0, cutoff: float = 50.0) -> PositionTracker:
    return PositionTracker(2.0 * math.pi / COUNTS, counts_range, zero, cutoff)


@given(
    steps=st.lists(st.integers(-2000, 2000), min_size=1, max_size=50),
    start=st.integers(0, 2**32 - 1),
    counts_range=st.sampled_from([1 << 32, COUNTS * 2, 1 << 20]),
)
def test_angle_is_the_sum_of_all_steps_however_often_it_wraps(steps: list[int], start: int, counts_range: int) -> None:
    position, follower = start, tracker(counts_range)
    follower.update(position % counts_range, 0.0)
    first = follower.angle
    for number, step in enumerate(steps, start=1):
        position += step
        follower.update(position % counts_range, 1e-3 * number)
    assert follower.angle - first == pytest.approx(sum(steps) * 2.0 * math.pi / COUNTS, abs=1e-9 * max(1.0, abs(first)))


@pytest.mark.parametrize(
    ("counts_range", "zero", "count", "counts"),
    [(COUNTS, 10, 9, -1), (1 << 32, 0, 2**32 - 1024, -1024), (1 << 32, 0, 1000, 1000)],
)
def test_first_angle_is_the_one_nearest_to_zero(counts_range: int, zero: int, count: int, counts: int) -> None:
    follower = tracker(counts_range, zero)
    follower.update(count, 0.0)
    assert follower.angle == pytest.approx(counts * 2.0 * math.pi / COUNTS)


def test_step_response_is_that_of_the_stated_low_pass() -> None:
    follower = tracker(cutoff=20.0)
    follower.update(0, 0.0)
    speed = 8 * 2.0 * math.pi / COUNTS / 1e-3
    for number in range(1, 9):
        follower.update(8 * number, 1e-3 * number)
        assert follower.velocity == pytest.approx(speed * (1.0 - math.exp(-2.0 * math.pi * 20.0 * 1e-3 * number)))


def test_missed_sample_only_lengthens_the_interval() -> None:
    follower = tracker()
    for number in [*range(300), *range(310, 700)]:
        follower.update(number * 4, 1e-3 * number)
    assert follower.velocity == pytest.approx(4 * 2.0 * math.pi / COUNTS / 1e-3, rel=1e-9)


def test_two_samples_of_one_time_change_no_velocity() -> None:
    follower = tracker()
    follower.update(0, 1.0)
    follower.update(100, 1.0)
    assert follower.velocity == 0.0
