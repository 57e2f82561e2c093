"""A process beside the loop in two: a worker, and its parent, which replaces it when it is gone or hangs.

The worker leaves a sign of life where both can read it. One that leaves none is killed first, and waited for: never are
there two. The loop's process has no part in it, as a fork there would cost it cycles.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from subprocess import Popen

# Processes started for another one: they end with it (Linux: prctl(2), PR_SET_PDEATHSIG), and not by the terminal.

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


LOOK = 0.1  # s between two looks at the worker
REST = 1.0  # s between two starts: one that dies at once shall not take the processor from a loop
MOST = 10  # workers in the place of another; what needs more of them is better given up and said


def keep(
    work: Callable[[int], int],
    alive: Callable[[], None],
    heard: Callable[[], float],
    hangs: float,
    replaced: Callable[[int], None],
) -> int:
    """Have `work` done by a process of its own, and by another one whenever that fails; returns its exit code.

    `work` gets how many there were before it; `alive` leaves a sign of life, and `heard` says when the last one was
    left (s, monotonic); none for `hangs` s is the end of that worker. `replaced` gets how many were, before each new
    one.
    Call it in a process of one thread. When this process is gone, so is the worker.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})  # waited for, below
    for number in range(MOST + 1):
        if number:
            replaced(number)
        alive()
        begun = time.monotonic()
        worker = _start(work, number)
        code = _watched(worker, heard, hangs)
        if code == 0:
            return 0
        time.sleep(max(0.0, begun + REST - time.monotonic()))
    return 1


def _start(work: Callable[[int], int], number: int) -> int:
    keeper = os.getpid()
    worker = os.fork()
    if worker:
        return worker
    code = 1
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
        end_with_parent(signal.SIGKILL)
        if os.getppid() == keeper:
            code = work(number)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _watched(worker: int, heard: Callable[[], float], hangs: float) -> int:
    """Until it is gone; its exit code, not 0 for one that was killed."""
    killed = False
    while True:
        done, status = os.waitpid(worker, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if not killed and time.monotonic() - heard() > hangs:
            os.kill(worker, signal.SIGKILL)  # one that waits for a dead disk is gone only when the disk answers
            killed = True
        signal.sigtimedwait({signal.SIGCHLD}, LOOK)  # at once when it ends: the end of a run waits for it
