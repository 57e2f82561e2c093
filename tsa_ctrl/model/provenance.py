"""The `[provenance]` of a model file: what is written there as a table, and what is read again of a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit


def interval_low(provenance: Mapping[str, Any], name: str) -> float | None:
    """Lower end of an interval that a calibration wrote; None where there is none that is one."""
    intervals = provenance.get("intervals")
    ends = intervals.get(name) if isinstance(intervals, Mapping) else None
    if not isinstance(ends, list) or len(ends) != 2 or not all(isinstance(end, int | float) for end in ends):
        return None
    low, high = float(ends[0]), float(ends[1])
    return low if 0.0 <= low <= high else None


def toml_table(values: Mapping[str, Any]) -> Any:
    """Plain values and mappings as a table of tomlkit."""
    table = tomlkit.table()
    for key, value in values.items():
        table[key] = toml_table(value) if isinstance(value, Mapping) else value
    return table
