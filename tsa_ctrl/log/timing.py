"""The time of a log: its period, how far samples lie off a uniform grid, and where time stands still or is missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import Table

Array = NDArray[np.float64]

CLOSE = 0.20  # of the typical step: a fitted period further away than this is the work of holes, not of rounding


@dataclass(frozen=True)
class TimeGrid:
    """The uniform grid that fits a log's times.

    `index` is the number of each row's sample on the grid (rows counted, and skipped cycles where those are known);
    `period` in s fits all rows, `typical` is the median step; `times` is the grid's time of each row. `jitter` is the
    largest deviation of a time from the grid or of a step from the period, whichever is smaller, as a fraction of the
    period: noise of the stamps doubles in the steps, and a slowly drifting clock adds up in the times. `worst` is the
    row (0-based) after the step that is furthest off.
    """

    index: NDArray[np.int64]
    period: float
    typical: float
    times: Array
    jitter: float
    worst: int

    @property
    def rate(self) -> float:
        """Hz, without the noise of the last digits."""
        return float(f"{1.0 / self.period:.10g}")

    @property
    def skipped(self) -> int:
        """Samples of the grid that no row fills."""
        return int(self.index[-1]) + 1 - len(self.index)


def fit_grid(t: Array, longest_skip: float = 0.0) -> TimeGrid:
    """The grid of increasing times, shape (n,), n >= 2; skips of up to `longest_skip` s count as whole samples."""
    steps = np.diff(t)
    typical = float(np.median(steps))
    whole = np.maximum(np.rint(steps / typical), 1.0)
    whole[steps > longest_skip + 1.5 * typical] = 1.0
    if longest_skip == 0.0:
        whole[:] = 1.0
    index = np.concatenate([[0], np.cumsum(whole)]).astype(np.int64)
    centred = index - float(np.mean(index))
    fitted = float(centred @ t) / float(centred @ centred)
    period = fitted if abs(fitted - typical) < CLOSE * typical else typical
    times = np.asarray(float(np.mean(t)) + period * centred, dtype=np.float64)
    step_error = np.abs(steps / period - whole)
    jitter = min(float(step_error.max()), float(np.max(np.abs(t - times))) / period)
    return TimeGrid(index, period, typical, times, jitter, int(np.argmax(step_error)) + 1)


def check_increasing(table: Table, t: Array, first: int = 0) -> None:
    """Raise UsageError where time is no number, stands still or runs back; `first` is the table's row of t[0]."""
    good = np.isfinite(t)
    if not good.all():
        place = table.place(int(np.argmin(good)) + first)
        raise UsageError(f"{table.label}: column t, {place}: found no number; every row needs its time: correct it")
    steps = np.diff(t)
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 1
        raise UsageError(
            f"{table.label}: column t, {table.place(row + first)}: time {t[row]:.9g} s does not increase (before it "
            f"{t[row - 1]:.9g} s); sort the rows by time and remove doubled ones"
        )
