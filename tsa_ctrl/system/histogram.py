"""Count wake-up latency and execution time in bins of 5 us, cheaply enough for every cycle."""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence
from dataclasses import dataclass

WIDTH = 5_000  # ns per bin
BINS = 401  # 0 to 2 ms, and one bin for longer durations


def count(bins: MutableSequence[int] | memoryview, nanoseconds: int) -> None:
    """Add one duration."""
    index = nanoseconds // WIDTH
    bins[index if 0 <= index < BINS - 1 else (BINS - 1 if index > 0 else 0)] += 1


@dataclass(frozen=True)
class Distribution:
    """The percentiles of one histogram: upper bin edges in s, nan without samples."""

    samples: int
    p50: float
    p99: float
    p999: float
    above: int  # samples beyond the last bin


def distribution(bins: Sequence[int] | memoryview) -> Distribution:
    """Return the percentiles of a histogram."""
    counts = list(bins)
    return Distribution(
        sum(counts), percentile(counts, 0.5), percentile(counts, 0.99), percentile(counts, 0.999), counts[-1]
    )


def percentile(counts: Sequence[int], share: float) -> float:
    """Return the upper edge (s) of the bin in which `share` of the samples is reached; nan without samples."""
    wanted = share * sum(counts)
    seen = 0
    for index, number in enumerate(counts):
        seen += number
        if seen >= wanted and seen > 0:
            return (index + 1) * WIDTH * 1e-9
    return float("nan")


def coarse(bins: Sequence[int] | memoryview) -> list[tuple[float, int]]:
    """Return (upper edge in s, samples) for readable steps of 10, 20, 50, 100, ... us. The last edge is inf."""
    counts = list(bins)
    edges = [10, 20, 50, 100, 200, 500, 1000, 2000]
    result, start = [], 0
    for edge in edges:
        end = edge * 1000 // WIDTH
        result.append((edge / 1e6, sum(counts[start:end])))
        start = end
    result.append((float("inf"), sum(counts[start:])))
    return result
