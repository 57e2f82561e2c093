"""SYNC at a node (CiA 301): COB-ID 0x1005, period 0x1006, window 0x1007, counter 0x1019; heard, watched, or made."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from tsa_ctrl.plant.dictionary import AbortCode, Entry, ObjectDictionary, SdoAbort, Type, is_restricted

PRODUCES = 0x40000000  # bit 30 of 0x1005
OWN_PERIOD = 10_000  # us, of a node that produces SYNC at power-on
_LATE = 1.5  # periods without a SYNC that are an error


class Heard(Enum):
    """Define the effect of a SYNC frame on the node."""

    GOOD = "good"
    WRONG_LENGTH = "wrong length"


def entries(producer: bool) -> list[Entry]:
    """The objects; of a `producer` with its own period."""
    return [
        Entry(0x1005, 0, Type.U32, default=0x80 | (PRODUCES if producer else 0)),
        Entry(0x1006, 0, Type.U32, default=OWN_PERIOD if producer else 0),  # us
        Entry(0x1007, 0, Type.U32),  # us
        Entry(0x1019, 0, Type.U8, high=240),
    ]


class SyncPort:
    """See the module; times in s."""

    def __init__(self, dictionary: ObjectDictionary, changed: Callable[[], None]) -> None:
        self._values = dictionary.values
        self._changed = changed
        self._last: float | None = None
        self._due = 0.0
        dictionary.on_write[0x1005, 0] = self._write_identifier
        dictionary.on_write[0x1019, 0] = self._write_counter

    @property
    def identifier(self) -> int:
        return self._values.get((0x1005, 0), 0x80) & 0x7FF

    def restore(self, now: float) -> None:
        self._last, self._due = None, now

    def hear(self, data: bytes, now: float) -> Heard:
        """One SYNC: with a counter it has a byte, without one it may have none."""
        if (self._values.get((0x1019, 0), 0) != 0) != (len(data) == 1):
            return Heard.WRONG_LENGTH
        self._last = now
        return Heard.GOOD

    def closed(self, now: float) -> bool:
        """Return True if synchronous PDOs come too late after the last SYNC."""
        window = self._values.get((0x1007, 0), 0) * 1e-6
        return window > 0.0 and self._last is not None and now - self._last > window

    def overdue(self, now: float) -> bool:
        """Return True if a SYNC is missed; reported once."""
        period = self._values.get((0x1006, 0), 0) * 1e-6
        if period <= 0.0 or self._last is None or now - self._last <= _LATE * period or self._produces:
            return False
        self._last = None
        return True

    def made(self, now: float) -> bool:
        """Return True if this node must send a SYNC now."""
        if now < self._due or not self._produces:
            return False
        period = self._values.get((0x1006, 0), 0) * 1e-6
        if period <= 0.0:
            return False
        self._due = max(self._due + period, now)
        return True

    @property
    def _produces(self) -> bool:
        return self._values.get((0x1005, 0), 0) & PRODUCES != 0

    def _write_identifier(self, value: int) -> None:
        if value & ~(PRODUCES | 0x7FF) or is_restricted(value & 0x7FF):
            raise SdoAbort(AbortCode.INVALID_VALUE)
        if value & self._values[0x1005, 0] & PRODUCES and value != self._values[0x1005, 0]:
            raise SdoAbort(AbortCode.DEVICE_STATE)  # CiA 301, 7.5.2.5
        self._values[0x1005, 0] = value
        self._changed()

    def _write_counter(self, value: int) -> None:
        if value == 1:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        if self._values.get((0x1006, 0), 0):
            raise SdoAbort(AbortCode.DEVICE_STATE)  # CiA 301, 7.5.2.22
