"""Check the arguments of the Python interface, so that a wrong type raises an error of one line."""

from __future__ import annotations

import math
import operator
import os
from pathlib import Path
from typing import Any

from tsa_ctrl.errors import UsageError


def kind_of(value: Any) -> str:
    """Return the name of the type of a value for messages."""
    return value.__name__ if isinstance(value, type) else type(value).__name__


def path_of(value: Any, place: str, permitted: str) -> Path:
    """Return a path.

    Args:
        value: argument of the caller.
        place: function or argument, for the message.
        permitted: permitted arguments, for the message.

    Raises:
        UsageError: `value` is not a path, or is the text of a file.
    """
    if not isinstance(value, (str, os.PathLike)) or not isinstance(os.fspath(value), str):
        raise UsageError(f"{place}: found a {kind_of(value)}; give {permitted}")
    text = os.fspath(value)
    if "\n" in text or "\0" in text:
        raise UsageError(f"{place}: {text[:40]!r} is not a path; give {permitted}")
    return Path(text)


def number_of(value: Any, place: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a number as a float, which may be nan if no bounds are given.

    Raises:
        UsageError: `value` is not a number, or is outside its bounds.
    """
    bounded = math.isfinite(low) or math.isfinite(high)
    permitted = f"a number from {low:g} to {high:g}" if bounded else "a number"
    try:
        if isinstance(value, (str, bytes)):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise UsageError(f"{place}: found {value!r:.60}; give {permitted}") from None
    if bounded and not low <= number <= high:
        raise UsageError(f"{place}: found {number:g}; give {permitted}")
    return number


def whole_of(value: Any, place: str) -> int:
    """Return a whole number of at least 0; raise UsageError for another value."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if number < 0:
        raise UsageError(f"{place}: found {value!r:.60}; give a whole number of at least 0")
    return number
