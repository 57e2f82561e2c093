"""Run a worker process and replace it when it ends or hangs.

The worker periodically leaves a sign of life that its parent, the keeper, can read. The keeper kills a worker that
hangs and waits for its end before it starts another, so there are never two. The keeper runs in a separate process,
because a fork in the loop's process would cost the loop cycles.
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

# A child process ends with its parent (Linux: prctl(2), PR_SET_PDEATHSIG), not by a signal of the terminal.
_PARENT = "TSA_PARENT"  # environment variable with the parent's process id
_PR_SET_PDEATHSIG = 1


def environment() -> dict[str, str]:
    """Return the environment for a child that shall receive SIGTERM however this process ends."""
    return {**os.environ, _PARENT: str(os.getpid())}


@contextlib.contextmanager
def terminal_blocked() -> Iterator[None]:
    """Block SIGINT and SIGHUP, so that a process started in the block inherits the mask and ignores the terminal.

    The parent ends such a process. In this process, both signals are delivered at the end of the block.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def child(module: str, *arguments: object, stdout: int = subprocess.PIPE, fd: int | None = None) -> Popen[bytes]:
    """Start `python -m MODULE ARGUMENTS` with a pipe to its stdin; the file descriptor `fd` is passed on to it.

    Call this before real-time scheduling is requested, so that the child does not inherit it.
    """
    with terminal_blocked():
        return subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=stdout,
            pass_fds=() if fd is None else (fd,),
        )


def follow() -> None:
    """Bind the started process to its parent; exit at once if the parent has already ended.

    The started process calls this function itself.
    """
    parent = os.environ.pop(_PARENT, "")
    if not parent or not sys.platform.startswith("linux"):
        return
    end_with_parent()
    if str(os.getppid()) != parent:
        sys.exit(1)


def end_with_parent(number: signal.Signals = signal.SIGTERM) -> None:
    """Request the signal `number` for this process as soon as its parent ends, for whatever reason."""
    with contextlib.suppress(OSError, AttributeError):  # not Linux
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)


LOOK = 0.1  # s between two checks of the worker
REST = 1.0  # s between two starts, so that a worker that fails at once takes no processor time from the loop
LONGEST_REST = 10.0  # s; REST doubles up to it while workers fail: a start takes 0.1 s of a processor, so 1 % of it
MOST = 10  # replacements in a row once the keeper's parent has ended: the worker still has to store what is left


def keep(
    work: Callable[[int], int],
    alive: Callable[[], None],
    heard: Callable[[], float],
    hangs: float,
    replaced: Callable[[int], None],
) -> int:
    """Run `work` in a child process and start another one whenever it fails.

    Call this in a process with one thread. If this process ends, the worker ends as well. As long as the parent of
    this process lives, a failed worker is always replaced.

    Args:
        work: the worker's function; receives the number of earlier workers and returns an exit code.
        alive: records a sign of life; called before each start.
        heard: returns the time of the last sign of life, s of the monotonic clock.
        hangs: s without a sign of life after which the worker is killed.
        replaced: called before each replacement with the number of earlier workers.

    Returns:
        0 when a worker ends with 0, or 1 after `MOST` replacements since the end of this process's parent.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})  # waited for, below
    parent, number, orphaned, rest = os.getppid(), 0, 0, REST
    while orphaned <= MOST:
        if number:
            replaced(number)
        alive()
        begun = time.monotonic()
        worker = _start(work, number)
        if _watched(worker, heard, hangs) == 0:
            return 0
        worked = time.monotonic() - begun
        time.sleep(max(0.0, rest - worked))
        rest = REST if worked > LONGEST_REST else min(2.0 * rest, LONGEST_REST)
        number += 1
        orphaned += os.getppid() != parent
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
    """Wait for the worker's end and return its exit code, which is not 0 for a killed worker."""
    killed = False
    while True:
        done, status = os.waitpid(worker, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if not killed and time.monotonic() - heard() > hangs:
            os.kill(worker, signal.SIGKILL)  # a worker blocked by a disk ends only when the disk responds
            killed = True
        signal.sigtimedwait({signal.SIGCHLD}, LOOK)  # returns at once when the worker ends, as the run's end waits
