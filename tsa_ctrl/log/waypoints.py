"""Waypoints: a table over a rising time that is played (set-point, motion), checked in one place for all players."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import Table, read_table

LEAST_ROWS = 2


def read_waypoints(path: str | Path, needed: Sequence[str], optional: Sequence[str] = ()) -> Table:
    """Read the columns `t` (s), `needed` and, where there, `optional` of a CSV, CSV.gz or Parquet file.

    Raises UsageError naming file, column and row: a column that is missing, a value that is not finite, fewer than two
    rows, a time that does not rise.
    """
    wanted = ("t", *needed, *optional)
    table = read_table(path, wanted)
    for name in ("t", *needed):
        if name not in table.columns:
            there = ", ".join([*table.columns, *table.left_out]) or "none"
            raise UsageError(f"{path}: column '{name}' is missing, found {there}; add it")
    if len(table) < LEAST_ROWS:
        raise UsageError(f"{path}: {len(table)} rows; give at least {LEAST_ROWS}")
    for name, values in table.columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise UsageError(f"{path}: column '{name}', {table.place(int(bad[0]))}: not a finite number; correct it")
    back = np.flatnonzero(np.diff(table.columns["t"]) <= 0.0)
    if back.size:
        raise UsageError(f"{path}: column 't', {table.place(int(back[0]) + 1)}: time does not rise; sort the file")
    return table


def from_zero(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same times, counted from the first."""
    shifted: NDArray[np.float64] = t - t[0]
    return shifted
