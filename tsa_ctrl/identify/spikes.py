"""Replace spikes in the columns of a log: a few samples that differ from all their neighbours.

A running median keeps steps and longer pulses, so these are not spikes, nor are noise and fast motion.
"""

from __future__ import annotations

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import Table
from tsa_ctrl.model.functions import Array

MEDIANS = 1 << 16  # samples of which the medians are computed at once
LONGEST_SPIKE = 10  # samples; a longer deviation may be a real event
MOST_SPIKES = 0.03  # largest fraction of samples in spikes; a column with more has a different fault
SPIKE = 1.0  # least distance of a spike from the median around it, over the range of these medians
NOISE_RANGE = 7.7  # five standard deviations of plain noise over half of the distances from the median
TOGETHER = 0.25  # largest difference between the samples before and after a spike, over the size of the spike
GLITCH = 0.05, 10.0  # for an angle: the same over the range, and over the distance of 97 % of the samples
SHARE_OF_REJECTION = 3.0  # a torque column with too many spikes is rejected if half of them are this much larger


def without_spikes(
    table: Table, columns: dict[str, Array], names: frozenset[str], notes: list[str]
) -> dict[str, Array]:
    """Return the columns with each spike of at most LONGEST_SPIKE samples in `names` replaced by a straight line.

    Each change adds a note.

    Raises:
        UsageError: a torque column has too many spikes.
    """
    out = dict(columns)
    for name in sorted(names & set(columns)):
        values = columns[name]
        middle = _running_median(values)
        away = np.abs(values - middle)
        whole = float(np.ptp(middle))
        half, often = np.quantile(away, (0.5, 0.97))
        least = SPIKE * max(whole, NOISE_RANGE * half)
        if name.startswith("q_"):
            least = max(GLITCH[0] * whole, GLITCH[1] * often)
        far = away > least
        if whole <= 0.0 or not far.any():
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], far, [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            apart = abs(values[min(end, len(values) - 1)] - values[max(begin - 1, 0)])
            inside = begin > 0 and end < len(values)
            far[begin:end] = end - begin <= LONGEST_SPIKE and not (inside and apart > TOGETHER * away[begin:end].max())
        edges = np.flatnonzero(np.diff(np.concatenate([[0], far, [0]])))
        if not edges.size:
            continue
        longest = int(np.max(edges[1::2] - edges[::2]))
        found = f"column {name} has {_counted(len(edges) // 2, 'spike')} of up to {_counted(longest, 'sample')}"
        first = table.place(int(edges[0]))
        if far.mean() > MOST_SPIKES:
            if name.startswith("tau_") and np.median(away[far]) > SHARE_OF_REJECTION * least:
                raise UsageError(
                    f"{table.label}: {found}, the first at {first}; they are {far.mean():.1%} of the samples, and at "
                    f"most {MOST_SPIKES:.0%} can be replaced: repair the sensor or its cable, or cut the file"
                )
            continue
        row = np.arange(len(values))
        out[name] = np.where(far, np.interp(row, row[~far], values[~far]), values)
        count = _counted(int(np.count_nonzero(far)), "sample")
        notes.append(f"{found}, {count} in all, the first at {first}: replaced by straight lines")
    return out


def _running_median(values: Array) -> Array:
    """Return the median of each sample and its LONGEST_SPIKE neighbours on either side, (n,)."""
    around = np.pad(values, LONGEST_SPIKE, mode="reflect" if len(values) > LONGEST_SPIKE else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(around, 2 * LONGEST_SPIKE + 1)
    return np.concatenate(
        [np.median(windows[start : start + MEDIANS], axis=1) for start in range(0, len(windows), MEDIANS)]
    )


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
