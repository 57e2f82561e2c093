"""Two pieces of work at once, one of them in a copy of this process that lives only so long.

A fork has all that the work needs without being sent it, and costs about 10 ms: for work of a tenth of a second and
more. It takes one thread along, and with it the locks that others hold; so what is done in it computes and nothing
else: it opens nothing, says nothing, and ends without any clearing up. Both pieces are the same, in the same order,
where only one core may be used or nobody allowed a second process: what comes out does not depend on it.
"""

from __future__ import annotations

import contextlib
import gc
import io
import os
import pickle
import signal
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextvars import ContextVar
from typing import BinaryIO, NoReturn, TypeVar

from tsa_ctrl.system.parent import end_with_parent

A = TypeVar("A")
B = TypeVar("B")

_WHOLE = b"whole"  # ends an answer that was not cut short
_allowed: ContextVar[bool] = ContextVar("allowed", default=False)


@contextlib.contextmanager
def twins() -> Iterator[None]:
    """Inside, `both` may use a second process, if this one may use a second core."""
    before = _allowed.set(len(os.sched_getaffinity(0)) > 1)
    try:
        yield
    finally:
        _allowed.reset(before)


def both(here: Callable[[], A], there: Callable[[], B], known: Iterable[object] = ()) -> tuple[A, B]:
    """What both return, computed at once inside `twins`, else one after the other.

    What `there` changes is lost, and what it returns is sent back: objects of `known` in it stay the same objects.
    Raises what one of them raises.
    """
    shared = {id(each): each for each in known}
    started = _begin(there, shared.keys()) if _allowed.get() else None
    if started is None:
        return here(), there()
    child, pipe = started
    try:
        mine, answer = here(), pipe.read()
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        pipe.close()
        os.waitpid(child, 0)
    if not answer.endswith(_WHOLE):  # it has failed, or was killed: as if there were one core
        return mine, there()
    unpickler = pickle.Unpickler(io.BytesIO(answer))
    unpickler.persistent_load = shared.__getitem__  # type: ignore[method-assign]
    return mine, unpickler.load()


def at_once(tasks: Sequence[Callable[[], A]], known: Iterable[object] = ()) -> list[A]:
    """What all return, every other one computed by the second process of `both`."""
    if len(tasks) < 2:
        return [task() for task in tasks]
    halves = both(lambda: [task() for task in tasks[::2]], lambda: [task() for task in tasks[1::2]], known)
    return [halves[number % 2][number // 2] for number in range(len(tasks))]


def _begin(work: Callable[[], object], shared: Collection[int]) -> tuple[int, BinaryIO] | None:
    """The process, and where its answer comes from; None when the system has no room for another."""
    reading, writing = os.pipe()
    parent = os.getpid()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # the terminal's Ctrl-C is for this process
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of other threads: see above
            child = os.fork()
        if child == 0:
            _answer(work, shared, parent, writing)
    except OSError:
        os.close(reading)
        return None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        os.close(writing)
    return child, os.fdopen(reading, "rb")


def _answer(work: Callable[[], object], shared: Collection[int], parent: int, writing: int) -> NoReturn:
    """What the copy does: never more than to compute and to send, however it ends."""
    try:
        end_with_parent(signal.SIGKILL)
        if os.getppid() == parent:
            gc.disable()  # it would look through all that the process holds, and have it copied
            _allowed.set(False)
            sent = io.BytesIO()
            pickler = pickle.Pickler(sent, pickle.HIGHEST_PROTOCOL)
            pickler.persistent_id = lambda each: id(each) if id(each) in shared else None  # type: ignore[method-assign]
            pickler.dump(work())
            sent.write(_WHOLE)
            with os.fdopen(writing, "wb", closefd=False) as pipe:
                pipe.write(sent.getbuffer())
    finally:
        os._exit(0)
