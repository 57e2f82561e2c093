"""Report compilation by numba and its progress, so that the first use on a machine does not look like a hang."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import cache

from numba.core import event

NOTICE = "tsa: compiling for the first use on this machine; once, up to a minute"
EVERY = 5.0  # s between two lines of progress


class _Announcer(event.Listener):  # type: ignore[misc]  # numba has no types
    """Print a notice at the first compilation, and then the progress. Loading from the cache prints nothing."""

    def __init__(self) -> None:
        self.tell: Callable[[str], None] | None = None
        self._began: float | None = None
        self._depth = 0  # nesting of compilations
        self._functions = 0
        self._printed = 0.0  # s between the start of compilation and the last printed line

    def on_start(self, event: event.Event) -> None:
        if self._began is None:
            self._began = time.monotonic()
            print(NOTICE, file=sys.stderr, flush=True)
            self._report(0.0)
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth or self._began is None:
            return
        self._functions += 1
        self._report(time.monotonic() - self._began)

    def _report(self, seconds: float) -> None:
        text = f"compiling for the first use on this machine: {self._functions} functions in {seconds:.0f} s"
        if self.tell is not None:
            self.tell(text)
        if seconds - self._printed >= EVERY:
            self._printed = seconds
            print(f"tsa: {text}", file=sys.stderr, flush=True)


_ANNOUNCER = _Announcer()


@cache
def announce() -> None:
    """Print the progress of this process's compilations. Call this before a module defines compiled functions."""
    event.register("numba:compile", _ANNOUNCER)


def on_compile(tell: Callable[[str], None] | None) -> None:
    """Set the function that also receives the progress of compilations. None removes it."""
    _ANNOUNCER.tell = tell
