"""Cached cases for several tests. One worker runs these tests and draws each case once."""

from __future__ import annotations

from functools import cache

import pytest

from . import case
from .cases import Case

together = pytest.mark.xdist_group("blind draws")


@cache
def drawn(family: str, name: str, seed: int) -> Case:
    """Return a short case. It is cached, so do not modify it."""
    return case(family, name, seed, short=True)
