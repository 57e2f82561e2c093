"""A ring of two axes, as the loop has it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tsa_ctrl.log.ring import RingWriter


@pytest.fixture
def ring() -> Iterator[RingWriter]:
    made = RingWriter(axes=2, slots=1024)
    yield made
    made.close()
