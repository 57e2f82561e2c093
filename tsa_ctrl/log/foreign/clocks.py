"""Place the columns of a binary file on one clock."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.foreign.names import Name
from tsa_ctrl.log.foreign.units import scale_of

Columns = dict[str, NDArray[Any]]
TIME = "time [s]"  # time column of a format that stores time separately from the columns


@dataclass(frozen=True)
class Arrays:
    """The columns of a binary file, of equal length, and the names of the columns without a place on their clock."""

    columns: Columns
    dropped: tuple[str, ...] = ()


def columns(found: Iterator[tuple[str, Any, str]], path: Path) -> Arrays:
    """Split matrices into columns, and place the columns on one clock.

    A group with its own time is a table with its own clock. Columns of a group without a time belong to the clock of
    the nearest folder above it, or to the only clock of equal length. Tables with different clocks are interpolated
    onto the longest one. Without any time, the columns of the most common length are returned.

    Args:
        found: name, array and group of each signal.
        path: file, for the message.

    Raises:
        UsageError: The file has no column.
    """
    every: dict[str, tuple[NDArray[Any], str]] = {}

    def add(name: str, values: NDArray[Any], group: str) -> None:
        every[f"{group}/{name}" if name in every else name] = (values, group)

    def split(name: str, values: Any, group: str) -> None:
        array = np.squeeze(np.asarray(values))
        if array.dtype.names:
            for part in array.dtype.names:
                split(part, array[part], name)
        elif array.ndim == 1 and array.size > 1:
            add(name or "column 1", array, group)
        elif array.ndim == 2:
            # A signal has more samples than a file has signals.
            by_column = array if array.shape[0] >= array.shape[1] else array.T
            for i, column in enumerate(by_column.T, start=1):
                add(f"{name}.{i}" if name else f"column {i}", column, group)

    for name, values, group in found:
        split(name, values, group)
    if not every:
        raise UsageError(f"{path}: contains no column of numbers; give a file with at least a time and a torque")
    return _placed(every)


def _placed(every: Mapping[str, tuple[NDArray[Any], str]]) -> Arrays:
    clocks = _clocks(every)
    if not clocks:
        lengths = [len(values) for values, _ in every.values()]
        rows = max(lengths, key=lambda length: (lengths.count(length), length))
        kept = {name: values for name, (values, _) in every.items() if len(values) == rows}
        return Arrays(kept, tuple(name for name in every if name not in kept))
    same: dict[str, str] = {}  # each clock, and the first one that is equal to it
    for name in clocks.values():
        t = _seconds(name, every[name][0])
        same[name] = next((n for n in same.values() if _is_equal(t, _seconds(n, every[n][0]))), name)
    tables: dict[str, Columns] = {}
    dropped: list[str] = []
    for name, (values, group) in every.items():
        if name in same:
            continue
        own = _clock_above(group, clocks)
        fitting = {clock for clock in same.values() if len(every[clock][0]) == len(values)}
        if own is not None and same[own] in fitting:
            fitting = {same[own]}
        if len(fitting) == 1:
            tables.setdefault(fitting.pop(), {})[name] = values
        else:
            dropped.append(name)
    if not tables:
        tables = {next(iter(same)): {}}
    dropped += [clock for clock in dict.fromkeys(same.values()) if clock not in tables]
    if len(tables) == 1:
        ((clock, table),) = tables.items()
        return Arrays({name: every[name][0] for name in every if name == clock or name in table}, tuple(dropped))
    merged = on_one_clock({clock: _increasing(_seconds(clock, every[clock][0]), tables[clock]) for clock in tables})
    if any(Name(clock).unit is None and every[clock][0].dtype.kind not in "Mm" for clock in tables):
        merged = {"time" if name == TIME else name: values for name, values in merged.items()}
    return Arrays(merged, tuple(dropped) + outside(tables, merged))


def _clocks(every: Mapping[str, tuple[NDArray[Any], str]]) -> dict[str, str]:
    """Return the name of the time column of each group that has one."""
    found: dict[str, list[str]] = {}
    for name, (values, group) in every.items():
        leaf = name.removeprefix(group).lstrip("/.") if group else name
        if Name(leaf).columns != {"t"} or values.dtype.kind not in "fiuMm":
            continue
        t = _seconds(name, values)
        steps = np.diff(t[np.isfinite(t)])
        if steps.size and bool(np.all(steps >= 0)) and bool(np.any(steps > 0)):
            found.setdefault(group, []).append(name)
    return {group: min(names, key=lambda name: Name(name).unknown) for group, names in found.items()}


def _clock_above(group: str, clocks: Mapping[str, str]) -> str | None:
    """Return the clock of a group, or of the nearest group that contains it."""
    while group not in clocks and group:
        group = re.sub(r"[/.]?[^/.]*$", "", group)
    return clocks.get(group)


def _seconds(name: str, values: NDArray[Any]) -> NDArray[np.float64]:
    if values.dtype.kind in "Mm":
        stamps = values.astype("datetime64[ns]" if values.dtype.kind == "M" else "timedelta64[ns]")
        return np.where(np.isnat(stamps), np.nan, stamps.astype(np.float64) * 1e-9)
    return np.asarray(values.astype(np.float64) * (scale_of(Name(name).unit or "s", "s") or 1.0), dtype=np.float64)


def _is_equal(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return len(a) == len(b) and bool(np.allclose(a, b, rtol=1e-12, atol=1e-9, equal_nan=True))


def _increasing(t: NDArray[np.float64], table: Columns) -> tuple[NDArray[np.float64], Columns]:
    """Return time and columns without the rows whose time is not a number or does not increase."""
    keep = np.flatnonzero(np.isfinite(t))
    keep = keep[np.concatenate([[True], np.diff(np.maximum.accumulate(t[keep])) > 0])]
    return t[keep], {name: values[keep] for name, values in table.items()}


def outside(tables: Mapping[str, Columns], merged: Columns) -> tuple[str, ...]:
    """Return the names of the columns that have no number in the time range of the common clock."""
    return tuple(name for table in tables.values() for name in table if name not in merged)


def on_one_clock(tables: Mapping[str, tuple[NDArray[np.float64], Columns]]) -> Columns:
    """Interpolate tables with separate clocks onto the longest clock, with nan outside a table's time range."""
    clock = max((t for t, _ in tables.values()), key=len)
    clock = clock[np.concatenate([[True], np.diff(np.maximum.accumulate(clock)) > 0])]
    found: Columns = {TIME: clock - clock[0]}
    for t, table in tables.values():
        for name, values in table.items():
            good = np.isfinite(values.astype(float))
            if good.any():
                found[name] = np.interp(clock, t[good], values[good].astype(float), left=np.nan, right=np.nan)
    return found
