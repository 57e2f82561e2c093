"""Student's t: half widths of intervals whose variance was estimated, in units of the standard deviation."""

from __future__ import annotations

from scipy.special import stdtrit  # scipy.stats is slow to import

LEVEL = 0.95  # of every interval that is told: the usual one
# Degrees of freedom of the noise's density where it matters: a band of its spectrum has 10 (FEWEST_WAVES pairs) or more
NOISE = 12.0


def half_width(freedom: float, level: float = LEVEL) -> float:
    """Of the two-sided interval at `level`, with `freedom` degrees of freedom, over the standard deviation."""
    return float(stdtrit(freedom, 0.5 + 0.5 * level))
