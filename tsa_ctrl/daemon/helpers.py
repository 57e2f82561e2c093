"""Looks after the processes beside the loop, and says it when one of them hangs, was replaced, or is gone for good."""

from __future__ import annotations

from collections.abc import Callable

from tsa_ctrl.daemon.events import Events

SILENT = 1.0  # s without a sign of life until that is said: each leaves five a second and more


class Helper:
    """One of them; two looks at shared memory, so that the loop may ask with every status."""

    def __init__(
        self, name: str, heard: Callable[[], float], replaced: Callable[[], int], words: tuple[str, str]
    ) -> None:
        """`heard`: of its last sign of life, s, monotonic, 0 before the first; `replaced`: how many of it were, by now;
        `words`: what it means that it hangs, and that another one took over.
        """
        self.silent = 0.0  # s for which nothing was heard of it, once that is too long
        self._name = name
        self._heard = heard
        self._replaced = replaced
        self._hangs, self._goes_on = words
        self._known = 0

    def look(self, t: float, now: float, events: Events) -> None:
        """`t` in s of the log, `now` in s, monotonic."""
        heard, replaced = self._heard(), self._replaced()
        if heard == 0.0:  # it has not begun
            return
        if replaced > self._known:
            self._known = replaced
            events.add(t, "", f"{self._name}: its process hung or was gone, and another one took over; {self._goes_on}")
        age = now - heard
        if age > SILENT and self.silent == 0.0:
            events.add(
                t, "", f"{self._name}: its process hangs, nothing was heard of it for {age:.1f} s; {self._hangs}"
            )
        elif age <= SILENT and self.silent:
            events.add(t, "", f"{self._name}: its process answers again")
        self.silent = age if age > SILENT else 0.0


def socket_server(heard: Callable[[], float], replaced: Callable[[], int]) -> Helper:
    """Of the socket's."""
    return Helper(
        "socket",
        heard,
        replaced,
        (
            "the loop goes on, a signal (SIGTERM) ends it; a process in its place follows",
            "the loop went on; clients connect anew",
        ),
    )


def log_writer(heard: Callable[[], float], replaced: Callable[[], int]) -> Helper:
    """Of the log."""
    return Helper(
        "log",
        heard,
        replaced,
        (
            "the loop goes on, records wait in memory for some seconds",
            "the loop went on; the log goes on in another file (-2, -3 and so on in its name)",
        ),
    )
