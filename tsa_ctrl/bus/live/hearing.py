"""Which command a drive heard last: what its 0x6071 holds, asked for now and then, against what was sent to it.

A command that is lost on its way, or in a drive that looks at its PDOs too seldom, tells nothing: the RPDO timer counts
only those that are lost in a row. How far behind its question an answer may lie is the drive's own, a SYNC or a cycle
of its firmware, and is learned as the least that was ever seen; a little more (JITTER) is no loss. What rests, or comes
back to a value that it had, shows nothing, and does no harm either.
"""

from __future__ import annotations

from collections import deque

# commands beyond its usual that a drive may show late: its PDOs and its SDO server are often two tasks, neither in step
# with SYNC; two periods are no danger either, and a drive that hears each fifth command passes them half the time
JITTER = 2
HISTORY = 64  # commands that are remembered: more than a drive may miss before its RPDO timer ends, at 1 kHz


class Hearing:
    """One drive's. Digits of 0x6071, as they are sent.

    Attributes: `sent` (those since the last question, the newest last; whoever sends appends), `asked` (answers since
    the start), `unheard` (of them those that held a command older than they may), `too_many` (of these within a
    second).
    """

    def __init__(self) -> None:
        self.sent: deque[int] = deque(maxlen=HISTORY)
        self.asked = 0
        self.unheard = 0
        self.too_many = 1
        self._known: list[int] = []
        self._usual = HISTORY

    def begin(self, too_many: int) -> None:
        """The drive was configured anew, and may be another one."""
        self.too_many = too_many
        self._usual = HISTORY

    def ask(self) -> None:
        """A question goes out now."""
        self._known = [*self._known, *self.sent][-HISTORY:]
        self.sent.clear()

    def answered(self, value: int) -> None:
        """The answer to the last question."""
        self.asked += 1
        since = list(self.sent)
        everything = [*self._known, *since]
        ages = [age for age, digits in enumerate(reversed(everything)) if digits == value]
        if not ages:  # never sent: rounded or clamped there
            return
        if ages[-1] < len(everything) - 1:  # else it may be of a command before these
            self._usual = min(self._usual, ages[-1])
        self.unheard += ages[0] - len(since) > self._usual + JITTER
