"""A table as it comes, made one that has a uniform time: doubled stamps joined, split at holes; nothing in silence.

A late row, a lost sample and a noisy stamp need no mending here: its stamp says when a row was taken, and straight
lines between stamps give the uniform grid (`timing.resampled`). What a straight line cannot give is a hole.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import Table
from tsa_ctrl.log.timing import LONGEST_SKIP, check_increasing, longest_step

Array = NDArray[np.float64]

SHORTEST = 1.0  # s, of a piece: the ends of a shorter one cost half of it (filters 0.15 s each, friction building up)
LEAST_KEPT = 0.5  # of the rows: of a table with more holes than this the stamps are wrong, not some rows missing


def mended(table: Table, strict: bool = False) -> list[Table]:
    """The table in pieces without holes and without doubled stamps, in order; each says in `notes` what was done.

    `strict`: nothing is done, and stamps that do not increase are an error. A daemon's own log, whose losses are known
    by its cycles, and a table without time come back as they are. Raises UsageError, one line with file, row, column
    and cure, where time is no number or runs back, or where most rows lie between holes.
    """
    t = table.columns.get("t")
    if strict or table.recorded or t is None or len(t) < 3:
        return [table]
    check_increasing(table, t, doubled=True)
    joined = _joined(table)
    return _pieces(joined) if len(joined) > 2 else [table]


def _joined(table: Table) -> Table:
    """Rows of one stamp as one row, their mean: a clock too coarse for the rate, or a row written twice."""
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
