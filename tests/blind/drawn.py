"""Cases that several tests look at, each drawn once by the worker that has them all."""

from __future__ import annotations

from functools import cache

import pytest

from . import case
from .cases import Case

together = pytest.mark.xdist_group("blind draws")


@cache
def drawn(family: str, name: str, seed: int) -> Case:
    """A short case; nobody may change it."""
    return case(family, name, seed, short=True)
