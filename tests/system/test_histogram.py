"""Test the histograms of durations."""

from __future__ import annotations

import math

import pytest

from tsa_ctrl.system.histogram import BINS, coarse, count, distribution


def filled(*nanoseconds: int) -> list[int]:
    bins = [0] * BINS
    for duration in nanoseconds:
        count(bins, duration)
    return bins


@pytest.mark.parametrize(
    ("duration", "index"),
    [(0, 0), (4_999, 0), (5_000, 1), (1_999_999, 399), (2_000_000, 400), (10**12, 400), (-1, 0)],
)
def test_each_duration_has_one_bin(duration: int, index: int) -> None:
    """Bins are 5 us wide. The last one has all longer durations, and the first one negative durations."""
    assert filled(duration)[index] == 1


def test_percentiles_are_upper_edges() -> None:
    """p50 and p99 of a hundred samples are upper edges of bins. A percentile requires samples."""
    found = distribution(filled(*[12_000] * 98, 52_000, 10**9))
    assert (found.p50, found.p99) == pytest.approx((15e-6, 55e-6))
    assert (found.samples, found.above) == (100, 1)
    assert math.isnan(distribution([0] * BINS).p50)


def test_coarse_bins_hold_every_sample() -> None:
    """The coarse histogram counts each sample once."""
    bins = coarse(filled(1_000, 11_000, 30_000, 1_500_000, 5_000_000))
    assert [number for _, number in bins] == [1, 1, 1, 0, 0, 0, 0, 1, 1]
    assert bins[0][0] == pytest.approx(10e-6)
    assert math.isinf(bins[-1][0])
