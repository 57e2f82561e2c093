"""Processes started for another one: they end with it (Linux: prctl(2), PR_SET_PDEATHSIG), and not by the terminal."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from subprocess import Popen

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


def child(module: str, *arguments: object, stdout: int = subprocess.PIPE, fd: int | None = None) -> Popen[bytes]:
    """`python -m MODULE ARGUMENTS`, told what it needs through its stdin; `fd` is handed on to it.

    Start it before real-time scheduling is asked for, so that it runs without it.
    """
    with terminal_blocked():
        return subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=stdout,
            pass_fds=() if fd is None else (fd,),
        )


def follow() -> None:
    """Called by the started process: a parent that is gone already ends it at once."""
    parent = os.environ.pop(_PARENT, "")
    if not parent or not sys.platform.startswith("linux"):
        return
    end_with_parent()
    if str(os.getppid()) != parent:
        sys.exit(1)


def end_with_parent(number: signal.Signals = signal.SIGTERM) -> None:
    """From now on this process gets the signal `number` when the one that started it is gone, killed or not."""
    with contextlib.suppress(OSError, AttributeError):  # not Linux
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)
