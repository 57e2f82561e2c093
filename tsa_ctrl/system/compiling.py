"""Announce compilation by numba, so that the first use on a machine does not look like a hang."""

from __future__ import annotations

import sys
from functools import cache

from numba.core import event

NOTICE = "tsa: compiling for the first use on this machine; once, up to a minute"


class _Announcer(event.Listener):  # type: ignore[misc]  # numba has no types
    """Print the notice at the first compilation. Loading from the cache does not count."""

    def __init__(self) -> None:
        self._announced = False

    def on_start(self, event: event.Event) -> None:
        if not self._announced:
            self._announced = True
            print(NOTICE, file=sys.stderr, flush=True)

    def on_end(self, event: event.Event) -> None:
        """Do nothing."""


@cache
def announce() -> None:
    """Print one line per process when something is compiled; call it before a module defines compiled functions."""
    event.register("numba:compile", _Announcer())
