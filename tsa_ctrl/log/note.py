"""What happened, as one line in the log: a fault with its cause, a loss, an end."""

from __future__ import annotations

import json
from dataclasses import dataclass

from tsa_ctrl.log.ring import NOTE_BYTES


@dataclass(frozen=True)
class Note:
    """`t` in s since the log's start; `axis` is empty for all; `fault`: it stopped the torque."""

    t: float
    axis: str
    text: str
    fault: bool

    def __str__(self) -> str:
        return f"{self.t:9.3f} s  {'FAULT  ' if self.fault else ''}{self.axis + ': ' if self.axis else ''}{self.text}"

    def encoded(self) -> bytes:
        """JSON for the ring, the text cut where it is too long for it."""
        text = self.text
        while len(data := json.dumps({**vars(self), "text": text}).encode()) > NOTE_BYTES:
            text = text[: len(text) * 3 // 4]
        return data

    @staticmethod
    def decoded(data: bytes) -> Note | None:
        """None for what is no note: it was overwritten while it was read."""
        try:
            found = json.loads(data)
            return Note(float(found["t"]), str(found["axis"]), str(found["text"]), bool(found["fault"]))
        except (ValueError, TypeError, KeyError):
            return None
