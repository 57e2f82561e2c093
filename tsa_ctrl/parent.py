"""A process that was started for another one ends with it, however that ends (Linux: prctl(2), PR_SET_PDEATHSIG)."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PARENT = "TSA_PARENT"  # environment: the process that the started one belongs to
_PR_SET_PDEATHSIG = 1


def environment() -> dict[str, str]:
    """The environment for a process that shall get SIGTERM when this one is gone, killed or not."""
    return {**os.environ, _PARENT: str(os.getpid())}


def follow() -> None:
    """Called by the started process: a parent that is gone already ends it at once."""
    parent = os.environ.pop(_PARENT, "")
    if not parent or not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if str(os.getppid()) != parent:
        sys.exit(1)
