"""Analyse the times of a log: its period, deviations from a uniform grid, and repeated or missing samples."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import Table

Array = NDArray[np.float64]

# s, longest time without a row, or without a value of a device, that linear interpolation fills. For a joint's fastest
# motion, 5 Hz, its error is at most (2 pi 5 Hz 20 ms)^2 / 8 = 5 %.
LONGEST_SKIP = 0.020
CLOSE = 0.20  # of the typical step: a larger difference of the fitted period is caused by gaps, not by rounding


@dataclass(frozen=True)
class TimeGrid:
    """The uniform grid that fits the times of a log.

    `jitter` is the smaller of two largest deviations: of a time from the grid, and of a step from the period. Noise of
    the stamps doubles in the steps, and the drift of a slow clock accumulates in the times.

    Attributes:
        index: sample number of each row on the grid, including known skipped cycles, (n,).
        period: period that fits all rows, s.
        typical: median step, s.
        times: time of each row on the grid, s, (n,).
        jitter: largest deviation as a fraction of the period.
        worst: row (0-based) after the step with the largest deviation.
    """

    index: NDArray[np.int64]
    period: float
    typical: float
    times: Array
    jitter: float
    worst: int

    @property
    def rate(self) -> float:
        """Return the rate in Hz, without rounding noise in the last digits."""
        return float(f"{1.0 / self.period:.10g}")

    @property
    def skipped(self) -> int:
        """Return the number of grid samples without a row."""
        return int(self.index[-1]) + 1 - len(self.index)


def longest_step(typical: float, longest_skip: float) -> float:
    """Return the longest step (s) between two rows that is not a gap: a skip or one slow sample, plus its jitter."""
    return max(longest_skip, typical) + 1.5 * typical


def fit_grid(t: Array, longest_skip: float = 0.0) -> TimeGrid:
    """Return the grid of increasing times (n,), n >= 2. Skips of up to `longest_skip` s count as whole samples."""
    steps = np.diff(t)
    typical = float(np.median(steps))
    whole = np.maximum(np.rint(steps / typical), 1.0)
    whole[steps > longest_skip + 1.5 * typical] = 1.0
    if longest_skip == 0.0:
        whole[:] = 1.0
    return _counted(t, typical, whole)


def fit_stamps(t: Array) -> TimeGrid:
    """Return the grid of increasing stamps (n,) without gaps, n >= 2, with lost samples counted if this fits better.

    The alternative is late rows and noisy stamps: every row is one sample, and a short step follows a long one.
    """
    steps = np.diff(t)
    typical = float(np.median(steps))
    each = _counted(t, typical, np.ones(len(steps)))
    if each.jitter <= CLOSE:
        return each
    lost = _counted(t, typical, np.maximum(np.rint(steps / typical), 1.0))
    return min((each, lost), key=lambda grid: float(np.mean(np.square(t - grid.times))) / grid.period**2)


def _counted(t: Array, typical: float, whole: Array) -> TimeGrid:
    """Return the grid whose steps span `whole` samples, (n - 1,)."""
    steps = np.diff(t)
    index = np.concatenate([[0], np.cumsum(whole)]).astype(np.int64)
    centred = index - float(np.mean(index))
    fitted = float(centred @ t) / float(centred @ centred)
    period = fitted if abs(fitted - typical) < CLOSE * typical else typical
    times = np.asarray(float(np.mean(t)) + period * centred, dtype=np.float64)
    step_error = np.abs(steps / period - whole)
    jitter = min(float(step_error.max()), float(np.max(np.abs(t - times))) / period)
    return TimeGrid(index, period, typical, times, jitter, int(np.argmax(step_error)) + 1)


def check_increasing(table: Table, t: Array, doubled: bool = False) -> None:
    """Raise UsageError if a time is not a number, repeats or decreases, or if all times are equal.

    Args:
        table: table of the times, for messages.
        t: times, s, (n,).
        doubled: True to accept a stamp that equals the previous one.
    """
    good = np.isfinite(t)
    if not good.all():
        place = table.place(int(np.argmin(good)))
        raise UsageError(f"{table.label}: column t, {place}: found no number; every row needs its time: correct it")
    steps = np.diff(t)
    onward = steps >= 0.0 if doubled else steps > 0.0
    if not onward.all():
        row = int(np.argmin(onward)) + 1
        cure = "sort the rows by time" if doubled else "sort the rows by time and remove duplicates"
        raise UsageError(
            f"{table.label}: column t, {table.place(row)}: time {t[row]:.9g} s does not increase "
            f"(previous row: {t[row - 1]:.9g} s); {cure}"
        )
    if len(steps) and not steps.any():
        raise UsageError(
            f"{table.label}: column t: all {len(t)} times are {t[0]:.9g} s; log the time of each row with more digits"
        )


# Repair the time stamps of a table: average rows with equal stamps and split the table at gaps.

SHORTEST = 1.0  # s of a piece; in a shorter piece both ends (0.15 s of filter each, friction build-up) take half
LEAST_KEPT = 0.5  # least share of kept rows; if more rows are lost, the time stamps are probably wrong


def repair_timestamps(table: Table, strict: bool = False) -> list[Table]:
    """Return the table as pieces without gaps and duplicate time stamps. The `notes` of each piece list the changes.

    Late rows, lost samples and noisy stamps are kept, because `timing.resampled` interpolates linearly between the
    stamps. A step that is too long for interpolation is a gap. A log of the daemon, which counts its lost cycles, and a
    table without time are returned unchanged.

    Args:
        table: table as read from the file.
        strict: True to return the table unchanged, so that time stamps that do not increase are rejected later.

    Raises:
        UsageError: Time is not a number or decreases, or gaps leave too few rows. The message is one line with file,
            row, column and remedy.
    """
    t = table.columns.get("t")
    if strict or table.recorded or t is None or len(t) < 3:
        return [table]
    check_increasing(table, t, doubled=True)
    joined = _joined(table)
    return _pieces(joined) if len(joined) > 2 else [table]


def _joined(table: Table) -> Table:
    """Average rows with equal time stamps, which a coarse clock or a row written twice causes."""
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
