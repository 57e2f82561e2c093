"""The same work in two processes that go in step, so that each has to do only half of what can be done at once.

A copy of this process (a fork, about 10 ms) runs the same code with the same data. Both compute all that is small;
where the work says `both`, each computes one of two pieces and gets the other's result, so that they go on alike. One
fork for all of it: memory that is written after a fork is copied page by page, by both, and a fork for each of the
pieces cost as much as the second core gained. The copy opens nothing, says nothing, and ends without clearing up.
Where only one core may be used, or nobody allowed a second process, or the copy fails, one process does all pieces, in
the same order: what comes out does not depend on it.
"""

from __future__ import annotations

import gc
import io
import os
import pickle
import signal
import time
import warnings
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe
from typing import Any, NoReturn, TypeVar

from tsa_ctrl.system.keeper import end_with_parent

A = TypeVar("A")
B = TypeVar("B")

PATIENCE = 2.0  # s, and LONGER times the time of the own piece, for the other's: a stall here takes tenths of a second
LONGER = 5.0
# The other failed or was killed, hangs, is elsewhere; or a result cannot be sent
GONE = (EOFError, OSError, LookupError, pickle.PicklingError, AttributeError, TypeError)


@dataclass
class _Other:
    """The other process, as one of the two sees it."""

    line: Connection
    is_copy: bool  # whether this process is the copy
    met: int = 0  # pieces so far: both count alike, or they are no longer in step

    def swapped(self, mine: object, where: str, known: Sequence[object], patience: float | None = None) -> Any:
        """The other's result for mine.

        Raises EOFError or OSError when it is gone or silent for `patience` seconds, LookupError when it is elsewhere.
        """
        self.met += 1
        numbers = {id(each): number for number, each in enumerate(known)}
        message = io.BytesIO()
        pickler = pickle.Pickler(message, pickle.HIGHEST_PROTOCOL)
        pickler.persistent_id = lambda each: numbers.get(id(each))  # type: ignore[method-assign]
        pickler.dump((self.met, where))
        pickler.dump(mine)
        if self.is_copy:  # one sends first: a line that is full takes no more until the other reads
            self.line.send_bytes(message.getbuffer())
            answer = io.BytesIO(self.line.recv_bytes())
        else:
            if not self.line.poll(patience):
                raise TimeoutError
            answer = io.BytesIO(self.line.recv_bytes())
            self.line.send_bytes(message.getbuffer())
        unpickler = pickle.Unpickler(answer)
        unpickler.persistent_load = known.__getitem__  # type: ignore[method-assign]
        if unpickler.load() != (self.met, where):
            raise LookupError("not in step")
        return unpickler.load()


_other: ContextVar[_Other | None] = ContextVar("other", default=None)


def in_step(work: Callable[[bool], A]) -> A:
    """What `work` returns, done with a copy of this process beside it, if this one may use a second core.

    `work` is told whether it is done by this process or (False) by the copy, which may neither write nor take a lock
    that another thread can hold.
    """
    started = _begin(work) if len(os.sched_getaffinity(0)) > 1 and _other.get() is None else None
    if started is None:
        return work(True)
    copy, line = started
    before = _other.set(_Other(line, is_copy=False))
    try:
        return work(True)
    finally:
        _other.reset(before)
        line.close()
        os.kill(copy, signal.SIGKILL)  # not yet waited for, so the number is still its own
        os.waitpid(copy, 0)


def both(here: Callable[[], A], there: Callable[[], B], known: Sequence[object] = ()) -> tuple[A, B]:
    """What both return: computed at once inside `in_step`, else one after the other.

    `known`: objects that both processes have; where a result holds one of them it is that same object afterwards.
    Raises what one of them raises.
    """
    return _both(here, there, known, f"{here.__qualname__} {there.__qualname__}")


def at_once(tasks: Sequence[Callable[[], A]], known: Sequence[object] = ()) -> list[A]:
    """What all return, every other one computed by the copy."""
    if len(tasks) < 2:
        return [task() for task in tasks]
    halves = _both(
        lambda: [task() for task in tasks[::2]], lambda: [task() for task in tasks[1::2]], known, f"{len(tasks)} tasks"
    )
    return [halves[number % 2][number // 2] for number in range(len(tasks))]


def _both(here: Callable[[], A], there: Callable[[], B], known: Sequence[object], where: str) -> tuple[A, B]:
    other = _other.get()
    if other is None:
        return here(), there()
    _other.set(None)  # whose pieces have pieces does them all; and who fails is alone from here on
    started = time.monotonic()
    first: A
    second: B
    if other.is_copy:
        try:
            second = there()
        except BaseException:
            os._exit(1)
        first = other.swapped(second, where, known)
    else:
        first = here()
        try:
            second = other.swapped(first, where, known, PATIENCE + LONGER * (time.monotonic() - started))
        except GONE:  # as if there were one core
            other.line.close()
            return first, there()
    _other.set(other)
    return first, second


def _begin(work: Callable[[bool], object]) -> tuple[int, Connection] | None:
    """The copy and the line to it; None when the system has no room for another process."""
    mine, its = Pipe()
    parent = os.getpid()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # the terminal's Ctrl-C is for this process
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of other threads: the copy needs nothing of theirs
            copy = os.fork()
        if copy == 0:
            mine.close()
            _follow(work, its, parent)
    except OSError:
        mine.close()
        return None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        its.close()
    return copy, mine


def _follow(work: Callable[[bool], object], line: Connection, parent: int) -> NoReturn:
    """What the copy does: never more than to compute and to send, however it ends."""
    try:
        end_with_parent(signal.SIGKILL)
        if os.getppid() == parent:
            silence = os.open(os.devnull, os.O_RDWR)
            for number in (0, 1, 2):
                os.dup2(silence, number)
            gc.freeze()  # what the process held before is never looked through, and so not copied
            _other.set(_Other(line, is_copy=True))
            work(False)
    finally:
        os._exit(0)
