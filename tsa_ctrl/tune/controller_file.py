"""What a tuning may change in the controller's file: the keys of [axis.law] that follow from measurements."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit

from tsa_ctrl.errors import UsageError

TUNED = ("motor_inertia", "delay", "ringing", "turn", "lead", "damping", "compensation")
MOTOR = TUNED[:-1]  # what moves and damps the motor by itself
MARK = "tsa tune: "  # begins the comment beside each


@dataclass(frozen=True)
class Key:
    """A value of [axis.law] and what is written beside it."""

    value: float
    comment: str


def with_law(text: str, axis: str, keys: Mapping[str, Key]) -> str:
    """The file with these keys in the axis' [axis.law], each with its comment; all else stays as it is written.

    Raises UsageError where the file's layout does not allow it.
    """
    document: Any = tomlkit.parse(text)
    table = next(table for table in document["axis"] if table["name"] == axis)
    if "law" not in table:
        table["law"] = tomlkit.table()
    law = table["law"]
    for name, key in keys.items():
        law[name] = key.value
        if not isinstance(law, tomlkit.items.InlineTable):
            law[name].comment(MARK + key.comment)
    new: str = tomlkit.dumps(document)
    wanted = tomllib.loads(text)
    chosen = next(table for table in wanted["axis"] if table["name"] == axis)
    chosen["law"] = {**chosen.get("law", {}), **{name: key.value for name, key in keys.items()}}
    try:
        same = tomllib.loads(new) == wanted
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        lines = ", ".join(f"{name} = {key.value:g}" for name, key in keys.items())
        raise UsageError(f"axis '{axis}': {lines} does not go into this layout; put it into [axis.law]")
    return new


def moved(text: str, axis: str, model: str, folder: Path) -> str:
    """Return the file for another folder: this axis' model is `model`, and other relative paths start at `folder`."""
    document: Any = tomlkit.parse(text)
    for table in document["axis"]:
        table["model"] = model if table["name"] == axis else str((folder / table["model"]).resolve())
        profile, setpoint = str(table["drive"].get("profile", "")), table.get("setpoint", {})
        if profile.endswith(".toml"):
            table["drive"]["profile"] = str((folder / profile).resolve())
        if "file" in setpoint:
            setpoint["file"] = str((folder / setpoint["file"]).resolve())
    return str(tomlkit.dumps(document))


def differ_in_law_alone(old: str, new: str, axis: str) -> bool:
    """Whether `new` is what `with_law` makes of `old`."""
    document: Any = tomlkit.parse(new)
    law: Any = next((table.get("law", {}) for table in document.get("axis", []) if table.get("name") == axis), {})
    keys = {}
    for name in law:  # in the order in which they were added
        if name in TUNED:
            comment = law[name].trivia.comment.removeprefix("#").strip()
            if comment.startswith(MARK) or isinstance(law, tomlkit.items.InlineTable):
                keys[name] = Key(float(law[name]), comment.removeprefix(MARK))
    return bool(keys) and with_law(old, axis, keys) == new
