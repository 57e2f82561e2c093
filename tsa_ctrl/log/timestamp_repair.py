"""Repair the time stamps of a table: average rows with equal stamps and split the table at gaps."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import Table
from tsa_ctrl.log.timing import LONGEST_SKIP, check_increasing, longest_step

Array = NDArray[np.float64]

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
        f"{doubled} of {len(t)} rows ({doubled / len(t):.2%}) have the stamp of the row before, first {row}: averaged"
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
    where = f"{table.place(widest)}: a step of {steps[widest - 1]:.4g} s where the period is {np.median(steps):.4g} s"
    if rows < LEAST_KEPT * len(t):
        raise UsageError(
            f"{table.label}: column t, {where}; {len(holes)} such holes leave {rows / len(t):.0%} of the rows in "
            f"pieces of {SHORTEST:g} s, at least {LEAST_KEPT:.0%} must be: log at a steady rate, or correct the stamps"
        )
    dropped = (
        f", {len(t) - rows} rows ({1.0 - rows / len(t):.2%}) in shorter ones are left out" if rows < len(t) else ""
    )
    pieces = f"1 piece of {SHORTEST:g} s or more" if len(kept) == 1 else f"{len(kept)} pieces"
    count = "a hole" if len(holes) == 1 else f"{len(holes)} holes"
    note = f"time has {count}, the widest at {where}: taken as {pieces}{dropped}"
    return [_cut(table, a, b, note) for a, b in kept]


def _cut(table: Table, start: int, end: int, note: str) -> Table:
    columns = {name: values[start:end] for name, values in table.columns.items()}
    rows = np.arange(start, end) if table.rows is None else table.rows[start:end]
    return dataclasses.replace(table, columns=columns, rows=rows, notes=(*table.notes, note))
