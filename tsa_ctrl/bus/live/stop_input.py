"""The emergency stop at a drive's digital inputs (0x60FD), read by SDO while the loop runs.

No PDO has room for it: the two that a drive sends are full. It is a second path. The first one is the drive's own
safe-torque-off input, which needs no software.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tsa_ctrl.bus.canopen.objects import Object
from tsa_ctrl.bus.live.image import Image

UNREAD = 0.25  # s without an answer, after which the state of the stop is unknown; a slow drive answers within 0.05


@dataclass(frozen=True)
class StopBit:
    """Where the stop is wired."""

    bit: int  # of 0x60FD
    level: int  # of that bit while the stop is pressed, 0 or 1


class StopInput:
    """The stop of one axis; writes its state to the axis' image."""

    def __init__(self, node_id: int, entry: Object, wiring: StopBit, image: Image) -> None:
        """`entry`: 0x60FD of the axis."""
        self.node_id = node_id
        self.entry = entry
        self._wiring = wiring
        self._image = image
        self._due = math.inf  # s, when the state becomes unknown

    def asked(self, now: float) -> None:
        """Judge how long no answer has come, at each question; `now` in s."""
        self._due = min(self._due, now + UNREAD)
        if now >= self._due and self._image.pressed is None:
            self._image.pressed = f"{self._image.nodes[0]}: no answer about {self.entry} for {UNREAD:g} s"

    def answered(self, value: int) -> None:
        """Take the value of 0x60FD."""
        self._due = math.inf
        pressed = value >> self._wiring.bit & 1 == self._wiring.level
        self._image.pressed = f"{self._image.nodes[0]}: bit {self._wiring.bit} of {self.entry}" if pressed else None
