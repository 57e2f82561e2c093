"""A running server of the local socket for the tests of clients."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.serving import Serving


@pytest.fixture
def serving(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Serving]:
    """Yield a server of the axes knee and hip, or of the module's `AXES`."""
    running = Serving(tmp_path / "tsa.sock", getattr(request.module, "AXES", ["knee", "hip"]))
    assert running.ready, running.greeting
    yield running
    with contextlib.suppress(ProcessLookupError):
        running.process.send_signal(signal.SIGCONT)
    running.end()
