"""A ring with two axes for the tests of the log."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tsa_ctrl.log.ring import RingWriter


@pytest.fixture
def ring() -> Iterator[RingWriter]:
    made = RingWriter(axes=2, slots=1024)
    yield made
    made.close()
