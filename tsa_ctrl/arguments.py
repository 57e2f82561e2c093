"""Check the arguments of the Python interface, so that a wrong type raises an error of one line."""

from __future__ import annotations

import functools
import inspect
import math
import operator
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from tsa_ctrl.errors import ArgumentsError, UsageError

P = ParamSpec("P")
R = TypeVar("R")


def listing_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function with an error that lists its arguments if a call does not fit them."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def called(*args: P.args, **named: P.kwargs) -> R:
        try:
            return function(*args, **named)
        except TypeError:
            try:
                signature.bind(*args, **named)
            except TypeError as wrong:
                kinds = signature.parameters.values()
                names = (f"{p.name}=" if p.kind is p.KEYWORD_ONLY else p.name for p in kinds if p.name != "self")
                permitted = ", ".join(names)
                unknown = [name for name in named if name not in signature.parameters]
                fault = f"no argument '{unknown[0]}'" if unknown else str(wrong)
                raise ArgumentsError(f"{function.__qualname__}: {fault}; the arguments are {permitted}") from None
            raise

    return called


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
        raise UsageError(f"{place}: found {_shown(value)}; give {permitted}") from None
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
        raise UsageError(f"{place}: found {_shown(value)}; give a whole number of at least 0")
    return number


def flag_of(value: Any, place: str) -> bool:
    """Return a truth value, of Python or NumPy, as a bool; raise UsageError for another value."""
    if isinstance(value, bool) or type(value).__name__ in ("bool", "bool_"):
        return bool(value)
    raise UsageError(f"{place}: found {_shown(value)}; give True or False")


def _shown(value: Any) -> str:
    return " ".join(repr(value).split())[:60]
