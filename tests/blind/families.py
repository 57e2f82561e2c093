"""The families of cases, and a function that creates a case of any family."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from .cases import (
    HIDDEN_DIRECTION,
    POOR,
    Case,
    hidden_direction_case,
    none_case,
    outside_case,
    pair_case,
    single_case,
    timing_case,
)
from .confounded import ROWS, confounded_case
from .geared import NAMES as GEARED_NAMES
from .geared import geared_case
from .outside import STRANGERS
from .rigid import NAMES as RIGID_NAMES
from .rigid import rigid_case
from .strength import NAMES

# Names of each family, used in turn.
FAMILIES: dict[str, tuple[str, ...]] = {
    "none": ("rich", "rich_again", "rich_once_more", "plain", *POOR),
    "hidden_direction": HIDDEN_DIRECTION,
    "single": NAMES,
    "pair": ("any",),
    "outside": tuple(STRANGERS),
    "confounded": tuple(ROWS),
    "rigid": RIGID_NAMES,
    "geared": GEARED_NAMES,
}

_MAKERS: dict[str, Callable[[str, int, bool], Case]] = {
    "none": none_case,
    "hidden_direction": hidden_direction_case,
    "single": single_case,
    "pair": pair_case,
    "outside": outside_case,
    "confounded": confounded_case,
    "rigid": rigid_case,
    "geared": geared_case,
    "timing": timing_case,
}


def case(family: str, name: str, seed: int, short: bool = False) -> Case:
    """Return one case, which the arguments determine completely.

    If `short` is set, the case has one run of 12 to 20 s, as in the quick gate.
    """
    return _MAKERS[family](name, seed, short)


def make_cases(n: int, families: Iterable[str] = tuple(FAMILIES), seed: int = 0, short: bool = False) -> Iterator[Case]:
    """Yield `n` cases of each family, with its names in turn."""
    for family in families:
        names = FAMILIES[family]
        for i in range(n):
            yield case(family, names[i % len(names)], seed + i // len(names), short)
