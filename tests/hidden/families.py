"""The families of cases under one roof."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from .cases import POOR, Case, none_case, outside_case, pair_case, single_case
from .confounded import ROWS, confounded_case
from .outside import STRANGERS
from .rigid import NAMES as RIGID_NAMES
from .rigid import rigid_case
from .strength import NAMES

FAMILIES: dict[str, tuple[Callable[..., Case], tuple[str, ...]]] = {
    "none": (none_case, ("rich", "rich", "rich", "plain", *POOR)),
    "single": (single_case, NAMES),
    "pair": (pair_case, ("any",)),
    "outside": (outside_case, tuple(STRANGERS)),
    "confounded": (confounded_case, tuple(ROWS)),
    "rigid": (rigid_case, RIGID_NAMES),
}


def case(family: str, name: str, seed: int, short: bool = False) -> Case:
    """One case; `short`: 12-20 s and one run, as the quick gate uses."""
    return FAMILIES[family][0](name, seed, short)


def make_cases(n: int, families: Iterable[str] = tuple(FAMILIES), seed: int = 0, short: bool = False) -> Iterator[Case]:
    """`n` cases of each family, its names in turn."""
    for family in families:
        names = FAMILIES[family][1]
        for i in range(n):
            yield case(family, names[i % len(names)], seed + i // len(names), short)
