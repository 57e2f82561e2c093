"""A process beside the loop in two: a worker, and its parent, which replaces it when it is gone or hangs.

The worker leaves a sign of life where both can read it. One that leaves none is killed first, and waited for: never are
there two. The loop's process has no part in it, as a fork there would cost it cycles.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections.abc import Callable

from tsa_ctrl.system.parent import end_with_parent

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
