"""The time of a log: its period, the deviation of samples from a uniform grid, and repeated or missing times."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import Table

Array = NDArray[np.float64]

# s without a row, or without a value of a device, that a straight line fills: of a joint's fastest motion, 5 Hz,
# it misses (2 pi 5 Hz 20 ms)^2 / 8 = 5 % at most
LONGEST_SKIP = 0.020
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
        """Return the rate in Hz, without the noise of the last digits."""
        return float(f"{1.0 / self.period:.10g}")

    @property
    def skipped(self) -> int:
        """Return the number of samples of the grid that no row fills."""
        return int(self.index[-1]) + 1 - len(self.index)


def longest_step(typical: float, longest_skip: float) -> float:
    """Return the longest step (s) between two rows that is not a hole: a skip or one slow sample, and its lateness."""
    return max(longest_skip, typical) + 1.5 * typical


def fit_grid(t: Array, longest_skip: float = 0.0) -> TimeGrid:
    """Return the grid of increasing times (n,), n >= 2; skips of up to `longest_skip` s count as whole samples."""
    steps = np.diff(t)
    typical = float(np.median(steps))
    whole = np.maximum(np.rint(steps / typical), 1.0)
    whole[steps > longest_skip + 1.5 * typical] = 1.0
    if longest_skip == 0.0:
        whole[:] = 1.0
    return _counted(t, typical, whole)


def fit_stamps(t: Array) -> TimeGrid:
    """Return the grid of increasing stamps without holes (n,), n >= 2, with lost samples counted if this fits better.

    Late rows and noisy stamps are the alternative: every row is one sample, and a long step is followed by a short.
    """
    steps = np.diff(t)
    typical = float(np.median(steps))
    each = _counted(t, typical, np.ones(len(steps)))
    if each.jitter <= CLOSE:
        return each
    lost = _counted(t, typical, np.maximum(np.rint(steps / typical), 1.0))
    return min((each, lost), key=lambda grid: float(np.mean(np.square(t - grid.times))) / grid.period**2)


def _counted(t: Array, typical: float, whole: Array) -> TimeGrid:
    """Return the grid whose steps span `whole` samples (n - 1)."""
    steps = np.diff(t)
    index = np.concatenate([[0], np.cumsum(whole)]).astype(np.int64)
    centred = index - float(np.mean(index))
    fitted = float(centred @ t) / float(centred @ centred)
    period = fitted if abs(fitted - typical) < CLOSE * typical else typical
    times = np.asarray(float(np.mean(t)) + period * centred, dtype=np.float64)
    step_error = np.abs(steps / period - whole)
    jitter = min(float(step_error.max()), float(np.max(np.abs(t - times))) / period)
    return TimeGrid(index, period, typical, times, jitter, int(np.argmax(step_error)) + 1)


def check_increasing(table: Table, t: Array, first: int = 0, doubled: bool = False) -> None:
    """Raise UsageError if a time is not a number, repeats or decreases; `first` is the table's row of t[0].

    `doubled`: a stamp may repeat the row before.
    """
    good = np.isfinite(t)
    if not good.all():
        place = table.place(int(np.argmin(good)) + first)
        raise UsageError(f"{table.label}: column t, {place}: found no number; every row needs its time: correct it")
    steps = np.diff(t)
    onward = steps >= 0.0 if doubled else steps > 0.0
    if not onward.all():
        row = int(np.argmin(onward)) + 1
        cure = "sort the rows by time" if doubled else "sort the rows by time and remove duplicates"
        raise UsageError(
            f"{table.label}: column t, {table.place(row + first)}: time {t[row]:.9g} s does not increase "
            f"(previous row: {t[row - 1]:.9g} s); {cure}"
        )


# Repair the time stamps of a table: average rows with equal stamps and split the table at gaps.

SHORTEST = 1.0  # s, of a piece; in a shorter one the ends take half (0.15 s of filter each, friction build-up)
LEAST_KEPT = 0.5  # share of the rows; if more are lost, the time stamps are wrong rather than some rows missing


def repair_timestamps(table: Table, strict: bool = False) -> list[Table]:
    """Return the table as pieces without gaps and duplicate time stamps; `notes` of each piece list the changes.

    Late rows, lost samples and noisy stamps are kept, because `timing.resampled` interpolates linearly between the
    stamps. A gap is a step too long for that. A log of the daemon, which counts its lost cycles, and a table without
    time are returned unchanged.

    Args:
        table: the table as it was read.
        strict: True returns the table unchanged, so that time stamps that do not increase are rejected later.

    Raises:
        UsageError: time is not a number or decreases, or gaps leave too few rows. The message is one line with file,
            row, column and remedy.
    """
    t = table.columns.get("t")
    if strict or table.recorded or t is None or len(t) < 3:
        return [table]
    check_increasing(table, t, doubled=True)
    joined = _joined(table)
    return _pieces(joined) if len(joined) > 2 else [table]


def _joined(table: Table) -> Table:
    """Average rows with the same time stamp, which a coarse clock or a row written twice causes."""
    t = table.columns["t"]
    new = np.concatenate([[True], np.diff(t) > 0.0])
    if new.all():
        return table
    starts = np.flatnonzero(new)
    counts = np.diff(np.append(starts, len(t)))
    columns = {name: np.add.reduceat(values, starts) / counts for name, values in table.columns.items()}
    columns["t"] = t[starts]
    doubled = len(t) - len(starts)
    row = table.place(int(np.argmin(new)))
    note = (
        f"{doubled} of {len(t)} rows ({doubled / len(t):.2%}) with the time stamp of the previous row were averaged, "
        f"the first at {row}"
    )
    rows = starts if table.rows is None else table.rows[starts]
    return dataclasses.replace(table, columns=columns, rows=rows, notes=(*table.notes, note))


def _pieces(table: Table) -> list[Table]:
    t = table.columns["t"]
    steps = np.diff(t)
    holes = np.flatnonzero(steps > longest_step(float(np.median(steps)), LONGEST_SKIP)) + 1
    if len(holes) == 0:
        return [table]
    edges = [0, *(int(hole) for hole in holes), len(t)]
    spans = list(pairwise(edges))
    kept = [(a, b) for a, b in spans if t[b - 1] - t[a] >= SHORTEST]
    if not kept:
        kept = [max(spans, key=lambda span: span[1] - span[0])]
    rows = sum(b - a for a, b in kept)
    widest = int(holes[np.argmax(steps[holes - 1])])
    where = f"{table.place(widest)}: a step of {steps[widest - 1]:.4g} s at a period of {np.median(steps):.4g} s"
    if rows < LEAST_KEPT * len(t):
        raise UsageError(
            f"{table.label}: column t, {where}; {len(holes)} such gap(s) leave {rows / len(t):.0%} of the rows in "
            f"pieces of {SHORTEST:g} s or more; at least {LEAST_KEPT:.0%} are required: log at a steady rate or "
            "correct the time stamps"
        )
    dropped = (
        f", {len(t) - rows} rows ({1.0 - rows / len(t):.2%}) in shorter pieces are left out" if rows < len(t) else ""
    )
    pieces = f"1 piece of {SHORTEST:g} s or more" if len(kept) == 1 else f"{len(kept)} pieces"
    count = "a gap" if len(holes) == 1 else f"{len(holes)} gaps"
    note = f"time has {count}, the longest at {where}: used as {pieces}{dropped}"
    return [_cut(table, a, b, note) for a, b in kept]


def _cut(table: Table, start: int, end: int, note: str) -> Table:
    columns = {name: values[start:end] for name, values in table.columns.items()}
    rows = np.arange(start, end) if table.rows is None else table.rows[start:end]
    return dataclasses.replace(table, columns=columns, rows=rows, notes=(*table.notes, note))
