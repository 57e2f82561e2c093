"""Provide a pseudo-terminal pair that can be unplugged and plugged in again, and waiting with a deadline."""

from __future__ import annotations

import os
import pty
import time
import tty
from collections.abc import Callable
from pathlib import Path

PATIENCE = 15.0  # s until a condition must be met on a slow machine


class Line:
    """A pseudo-terminal behind a fixed path, so that it can be unplugged and plugged in again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plug()

    def plug(self) -> None:
        self.ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._theirs))

    def unplug(self) -> None:
        self.path.unlink(missing_ok=True)
        os.close(self.ours)
        os.close(self._theirs)

    def send(self, data: bytes) -> None:
        os.write(self.ours, data)


def wait_for(condition: Callable[[], bool], meanwhile: Callable[[], None] = lambda: None) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "the condition never held"
        meanwhile()
        time.sleep(0.01)
