"""Signals of a process: those that are not its concern, and those that shall wait."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


def ignore(*numbers: signal.Signals) -> None:
    """These reach the whole group of a terminal; what they mean for this process is decided by another one."""
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def unheard_by_children() -> Iterator[None]:
    """Ctrl-C never reaches a process that this thread starts in the block; its parent, which ends it, has it after it.

    By the mask, which a new program keeps from its first instruction: a handler of its own comes a second too late,
    and until then it would end with a traceback. The tracker of multiprocessing would undo the mask as it starts.
    """
    from multiprocessing import resource_tracker  # most processes have no children

    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def postponed() -> Iterator[None]:
    """SIGINT and SIGTERM are handled when the block is left.

    By handlers: a mask is one thread's own, and a signal takes any thread that lets it through. Beside the main thread
    nothing is to be done, as Python runs handlers in that one alone.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda got, _: caught.append(got)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for waiting in dict.fromkeys(caught):
            signal.raise_signal(waiting)
