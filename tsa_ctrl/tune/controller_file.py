"""The one key of the controller's file that a tuning may change: how fast the friction term turns."""

from __future__ import annotations

import tomllib
from typing import Any

import tomlkit

from tsa_ctrl.errors import UsageError


def with_slew(text: str, axis: str, slew: float) -> str:
    """The file with this `slew` (N*m/s) in the axis' [axis.law]; all else stays as it is written.

    Raises UsageError where the file's layout does not allow it.
    """
    document: Any = tomlkit.parse(text)
    table = next(table for table in document["axis"] if table["name"] == axis)
    if "law" not in table:
        table["law"] = tomlkit.table()
    table["law"]["slew"] = slew
    new: str = tomlkit.dumps(document)
    wanted = tomllib.loads(text)
    chosen = next(table for table in wanted["axis"] if table["name"] == axis)
    chosen["law"] = {**chosen.get("law", {}), "slew": slew}
    if tomllib.loads(new) != wanted:
        raise UsageError(f"axis '{axis}': slew = {slew:g} does not go into this layout; put it into [axis.law]")
    return new


def differ_in_slew_alone(old: str, new: str, axis: str) -> bool:
    """Whether `new` is what `with_slew` makes of `old`."""
    tables = tomllib.loads(new).get("axis", [])
    slew = next((table.get("law", {}).get("slew") for table in tables if table.get("name") == axis), None)
    return slew is not None and with_slew(old, axis, slew) == new
