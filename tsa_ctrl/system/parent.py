"""Processes started for another one: they end with it (Linux: prctl(2), PR_SET_PDEATHSIG), and not by the terminal."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Iterator

_PARENT = "TSA_PARENT"  # environment: the process that the started one belongs to
_PR_SET_PDEATHSIG = 1


def environment() -> dict[str, str]:
    """The environment for a process that shall get SIGTERM when this one is gone, killed or not."""
    return {**os.environ, _PARENT: str(os.getpid())}


@contextlib.contextmanager
def terminal_blocked() -> Iterator[None]:
    """What is started inside never gets the terminal's signals, not even before it can say so: its owner ends it.

    They wait for the end of the block here.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def follow() -> None:
    """Called by the started process: a parent that is gone already ends it at once."""
    parent = os.environ.pop(_PARENT, "")
    if not parent or not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if str(os.getppid()) != parent:
        sys.exit(1)
