"""The loop's events on stderr, told by a process that may wait for a terminal."""

from __future__ import annotations

import sys

import msgspec

from tsa_ctrl.ipc.mailbox import Mailbox


class EventPrinter:
    """Tells events on stderr as they come: the loop itself must not wait for a terminal."""

    def __init__(self, mailbox: Mailbox) -> None:
        self._mailbox = mailbox
        self._sequence = 0
        self._last = -1

    def update(self) -> None:
        """Print what is new."""
        sequence, text = self._mailbox.text()
        if sequence == self._sequence:
            return
        self._sequence = sequence
        for event in msgspec.json.decode(text):
            if event["number"] > self._last:
                self._last = event["number"]
                where = f"{event['axis']}: " if event["axis"] else ""
                print(f"{event['t']:.3f} s: {where}{event['text']}", file=sys.stderr, flush=True)
