"""Summarise a log: rate, duration, jitter, columns with their ranges, and the events of the recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.convert import coded
from tsa_ctrl.log.mcap_file import Note
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.log.table import Table, kind_of, read_table, sha256_of, split_axis
from tsa_ctrl.log.timing import check_increasing, fit_grid, repair_timestamps
from tsa_ctrl.outputs import json_types
from tsa_ctrl.signals import COLUMNS

Codes = dict[str, dict[int, str]]


@dataclass(frozen=True)
class ColumnRange:
    """The range of one column.

    Attributes:
        name: name of the column.
        unit: unit of the column; "" if unknown.
        low: smallest value; None without values.
        high: largest value; None without values.
        missing: number of rows without a value.
        names: names of the codes that occur in a coded column.
    """

    name: str
    unit: str
    low: float | None
    high: float | None
    missing: int
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class AxisInfo:
    """The summary of one axis.

    Attributes:
        axis: name of the axis; None for a table.
        rate: sampling rate, Hz.
        seconds: duration, s.
        rows: number of rows.
        jitter: largest timing error as a fraction of the period.
        skipped: number of missing samples.
        columns: ranges of the columns.
        text_columns: names of the columns without numbers.
    """

    axis: str | None
    rate: float
    seconds: float
    rows: int
    jitter: float
    skipped: int
    columns: list[ColumnRange]
    text_columns: tuple[str, ...] = ()


@dataclass(frozen=True)
class LogInfo:
    """The summary of a log file.

    Attributes:
        path: path of the log.
        sha256: hexadecimal SHA-256 of the file.
        axes: axes of the log. A table has one axis without a name.
        about: metadata of the header.
        problems: defects of the file as text.
        notes: events of the recording, such as faults with their cause.
    """

    path: str
    sha256: str
    axes: list[AxisInfo]
    about: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of `tsa log info`, with rate and columns for all axes together."""
        names = dict.fromkeys(column.name for axis in self.axes for column in axis.columns)
        names |= dict.fromkeys(name for axis in self.axes for name in axis.text_columns)
        return {
            "schema": 1,
            "log": self.path,
            "sha256": self.sha256,
            "rate": self.axes[0].rate,
            "seconds": max(axis.seconds for axis in self.axes),
            "rows": [axis.rows for axis in self.axes],
            "columns": list(names),
            "axes": [axis.axis for axis in self.axes if axis.axis is not None],
            "jitter_percent": 100.0 * max(axis.jitter for axis in self.axes),
            "skipped": [axis.skipped for axis in self.axes],
            "recorded_by": self.about.get("version"),
            "build": self.about.get("build"),
            "started": self.about.get("started"),
            "problems": self.problems,
            "events": json_types(self.notes),
        }


def inspect(path: str | Path) -> LogInfo:
    """Summarise a log. Raise UsageError if it cannot be read or has no usable time."""
    file, axis = split_axis(path)
    sha256 = sha256_of(path)
    if kind_of(file) != ".mcap":
        table = read_table(path)
        if "t" not in table.columns:
            names = ", ".join(table.columns) or "none"
            raise UsageError(f"{table.label}: column t is missing (found: {names}); add it, or run tsa log import")
        columns = _Columns(list(table.columns), {})
        columns.add(table.columns.values())
        return LogInfo(str(path), sha256, [_axis_info(table, columns, 0.0, empty=True)], problems=_repairs(table))
    log = LogFile(file)
    found = {name: _Columns(log.fields, log.codes) for name in log.chosen(axis)}
    for name, block in log.blocks(log.fields):
        if name in found:
            found[name].add(block.T)
    infos = [_axis_info(Table(f"{file}:{name}", {}, axis=name), c, np.inf, empty=False) for name, c in found.items()]
    return LogInfo(str(path), sha256, infos, log.about, log.problems, log.notes)


class _Columns:
    """The times of one axis (s), and range, missing values and codes of each column, collected block by block."""

    def __init__(self, names: Sequence[str], codes: Codes) -> None:
        self._names = list(names)
        self._codes = codes
        self._low = [np.inf] * len(self._names)
        self._high = [-np.inf] * len(self._names)
        self._missing = [0] * len(self._names)
        self._found: dict[str, set[float]] = {name: set() for name in self._names if codes.get(name)}
        self._times = bytearray()  # grows in place, and only these 8 bytes per row are kept

    def add(self, columns: Iterable[NDArray[np.float64]]) -> None:
        """Add the next rows, with one column for each name."""
        for i, (name, values) in enumerate(zip(self._names, columns, strict=True)):
            if name == "t":
                self._times += values.astype(np.float64).tobytes()
            good = values[np.isfinite(values)]
            self._missing[i] += len(values) - len(good)
            if len(good):
                self._low[i] = min(self._low[i], float(good.min()))
                self._high[i] = max(self._high[i], float(good.max()))
            if name in self._found:
                self._found[name].update(np.unique(good).tolist())

    @property
    def t(self) -> NDArray[np.float64]:
        return np.frombuffer(self._times, dtype=np.float64)

    def ranges(self, empty: bool) -> list[ColumnRange]:
        """Return the ranges of all columns with values. `empty` adds the columns without values."""
        found = []
        for i, name in enumerate(self._names):
            there = self._low[i] <= self._high[i]
            if not (there or empty or name == "t"):
                continue
            unit = COLUMNS[name].unit if name in COLUMNS else ""
            low, high = (self._low[i], self._high[i]) if there else (None, None)
            codes = tuple(coded(np.array(sorted(self._found[name])), self._codes[name])) if name in self._found else ()
            found.append(ColumnRange(name, unit, low, high, self._missing[i], codes))
        return found


def _repairs(table: Table) -> list[str]:
    """Return the notes on duplicate time stamps and gaps that are also reported when the log is used."""
    try:
        return list(dict.fromkeys(note for piece in repair_timestamps(table) for note in piece.notes))
    except UsageError as error:
        return [str(error).removeprefix(f"{table.label}: ")]


def _axis_info(table: Table, columns: _Columns, longest_skip: float, empty: bool) -> AxisInfo:
    t = columns.t
    if len(t) < 2:
        raise UsageError(f"{table.label}: too few rows ({len(t)}); at least 2 are needed: give a longer log")
    check_increasing(table, t, doubled=True)
    grid = fit_grid(np.unique(t), longest_skip)
    ranges = columns.ranges(empty)
    return AxisInfo(
        table.axis, grid.rate, float(t[-1] - t[0]), len(t), grid.jitter, grid.skipped, ranges, table.left_out
    )
