"""Represent a value with its 95 % interval and unit, the form of every identification result."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # scipy.stats is slow to import

# Intervals whose variance was estimated have half widths by Student's t, in units of the standard deviation.

LEVEL = 0.95  # level of every reported interval, as usual
# Degrees of freedom of the noise density in the relevant bands: each band of the spectrum has at least 10 of them
# (FEWEST_WAVES pairs)
NOISE = 12.0
BLOCKS = 10  # blocks of a log, each left out once by a jackknife: t with 9 degrees of freedom is 2.3


def half_width(freedom: float) -> float:
    """Return the half width of a two-sided interval at `LEVEL`, in standard deviations (Student's t).

    `freedom`: degrees of freedom of the estimated variance.
    """
    return float(stdtrit(freedom, 0.5 + 0.5 * LEVEL))


def jackknife_half_width(without: Sequence[float] | NDArray[np.float64]) -> float:
    """Return the half width of an estimate's interval from the (blocks,) estimates that each leave out one block."""
    estimates = np.asarray(without, dtype=np.float64)
    count = estimates.size
    deviation = math.sqrt((count - 1) / count * float(np.sum(np.square(estimates - estimates.mean()))))
    return half_width(count - 1) * deviation


def jackknife(
    parts: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
    value: Callable[[NDArray[np.float64], NDArray[np.float64]], float],
) -> tuple[float, float]:
    """Return a result of normal equations and the half width of its interval.

    Args:
        parts: the equations of each block of time: squares (k, k) and products (k,) or (k, m).
        value: function that returns the result of the summed equations.
    """
    squares, products = (np.sum(each, axis=0) for each in zip(*parts, strict=True))
    half = jackknife_half_width([value(squares - a, products - b) for a, b in parts])
    return value(squares, products), half


@dataclass(frozen=True)
class Quantity:
    """`value` with the 95 % interval [`low`, `high`]; `unit` is a public unit string (N, N*m, rad, 1, ...)."""

    value: float
    low: float
    high: float
    unit: str

    @property
    def share(self) -> float:
        """Return the half width of the interval relative to the value."""
        return 0.5 * (self.high - self.low) / self.value

    @property
    def told(self) -> bool:
        """Return True if the interval is finite; an infinite one marks a quantity that the logs do not determine."""
        return math.isfinite(self.high - self.low)

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {spelled(self.unit)}"
        return f"{self.value:.4g}{unit} ({self.low:.4g} to {self.high:.4g})"


def spelled(unit: str) -> str:
    """Return a unit string with typographic signs, such as N·m for N*m."""
    return unit.replace("*", "·").replace("^2", "²")


def rounded(value: float, share: float) -> float:
    """Return the value rounded to about a tenth of its interval; `share`: relative half width of the interval."""
    digits = max(2, 1 + math.ceil(-math.log10(max(share, 1e-6))))
    return float(f"{value:.{digits}g}")
