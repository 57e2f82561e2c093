"""Student's t: half widths of intervals whose variance was estimated, in units of the standard deviation."""

from __future__ import annotations

from scipy.special import stdtrit  # scipy.stats is slow to import

LEVEL = 0.95  # of every interval that is told
NOISE = 12.0  # degrees of freedom of the noise's density where it matters


def half_width(freedom: float, level: float = LEVEL) -> float:
    """Of the two-sided interval at `level`, with `freedom` degrees of freedom, over the standard deviation."""
    return float(stdtrit(freedom, 0.5 + 0.5 * level))
