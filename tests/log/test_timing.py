"""The time of a log: period, jitter and skipped cycles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.log.timing import fit_grid

T = np.arange(500) * 1e-3


@given(period=st.floats(1e-4, 0.05), start=st.floats(-1e4, 1e6), n=st.integers(3, 2000))
def test_a_uniform_time_has_its_period_and_no_jitter(period: float, start: float, n: int) -> None:
    grid = fit_grid(start + period * np.arange(n))
    assert grid.period == pytest.approx(period, rel=1e-4)
    assert grid.jitter < 1e-3


@pytest.mark.parametrize("share", [0.05, 0.19])
def test_noise_of_the_stamps_is_measured_against_the_grid_and_a_wandering_clock_by_its_steps(share: float) -> None:
    noise = np.random.default_rng(1).uniform(-share, share, len(T)) * 1e-3
    grid = fit_grid(T + noise)
    assert 0.9 * share < grid.jitter < 1.1 * share
    assert grid.period == pytest.approx(1e-3, rel=1e-3)
    steps = 1e-3 * (1.0 + np.random.default_rng(2).uniform(-share, share, len(T)))
    assert fit_grid(np.cumsum(steps)).jitter < 1.1 * share


def test_rounded_times_keep_their_true_period() -> None:
    t = np.round(np.arange(3000) / 3000.0, 4)
    assert fit_grid(t).rate == pytest.approx(3000.0, rel=1e-5)


def test_a_short_skip_is_counted_and_a_hole_is_more_jitter_than_any_log_may_have() -> None:
    grid = fit_grid(np.delete(T, 123))
    assert grid.jitter > 0.4
    assert grid.worst == 123
    grid = fit_grid(np.delete(T, [123, 124]), longest_skip=0.02)
    assert (grid.skipped, int(grid.index[123])) == (2, 125)
    assert grid.jitter < 1e-9
    grid = fit_grid(np.delete(T, range(100, 150)), longest_skip=0.02)
    assert grid.skipped == 0
    assert grid.jitter > 1.0
