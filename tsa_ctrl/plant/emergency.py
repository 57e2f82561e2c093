"""EMCY (CiA 301): error register 0x1001, history 0x1003, and the frame by its COB-ID 0x1014."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from enum import IntEnum

from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, ObjectDictionary, SdoAbort, Type, is_restricted

REGISTER_GENERIC = 0x01
REGISTER_COMMUNICATION = 0x10
_FRAME = struct.Struct("<HB5s")
_HISTORY = 8  # entries of 0x1003
_INVALID = 0x80000000


class EmcyCode(IntEnum):
    """Emergency error codes of CiA 301 and 402 that the simulated nodes raise by themselves."""

    NO_ERROR = 0x0000
    COMMUNICATION = 0x8100  # a SYNC that is overdue
    HEARTBEAT = 0x8130  # life guard or heartbeat error
    PDO_TOO_SHORT = 0x8210
    PDO_TOO_LONG = 0x8220
    SYNC_LENGTH = 0x8240
    RPDO_TIMEOUT = 0x8250


def entries() -> list[Entry]:
    """The objects that errors are kept in."""
    return [
        Entry(0x1001, 0, Type.U8, Access.RO, mappable=True),
        Entry(0x1003, 0, Type.U8),
        *(Entry(0x1003, place, Type.U32, Access.RO) for place in range(1, _HISTORY + 1)),
        Entry(0x1014, 0, Type.U32, default=0x80, plus_node=True),
        Entry(0x1015, 0, Type.U16),
    ]


class ErrorLog:
    """Hold the errors of one node; `report` sends one error, `clear_*` forget."""

    def __init__(self, dictionary: ObjectDictionary, send: Callable[[int, bytes], bool]) -> None:
        self._dictionary = dictionary
        self._values = dictionary.values
        self._send = send
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._next = 0.0  # s, before which none is sent
        dictionary.on_write[0x1003, 0] = self._write_history
        dictionary.on_write[0x1014, 0] = self._write_identifier

    def report(self, code: int, register: int, vendor: bytes, heard: bool, now: float) -> None:
        """Keep an error in 0x1001 and 0x1003, and send it if it can be heard.

        Args:
            code: error code; 0 reports that all errors are gone.
            register: bits of the error register.
            vendor: five bytes of the maker.
            heard: whether the node may send emergencies in its present state.
            now: time, s.
        """
        values = self._values
        if code:
            values[0x1001, 0] |= register | REGISTER_GENERIC
            for place in range(_HISTORY, 1, -1):
                values[0x1003, place] = values[0x1003, place - 1]
            values[0x1003, 1] = code
            values[0x1003, 0] = min(_HISTORY, values[0x1003, 0] + 1)
        else:
            values[0x1001, 0] = 0
        identifier = values.get((0x1014, 0), 0x80 + self._dictionary.node_id)
        if heard and not identifier & _INVALID:
            self._waiting.append((identifier & 0x7FF, _FRAME.pack(code, values[0x1001, 0], vendor)))
            self.release(now)

    def release(self, now: float) -> None:
        """Send what waits, one frame in each inhibit time 0x1015 (100 us)."""
        while self._waiting and now >= self._next:
            self._send(*self._waiting.popleft())
            self._next = now + 1e-4 * self._values.get((0x1015, 0), 0)

    def clear(self) -> None:
        """Power-on: nothing is remembered."""
        self._values[0x1001, 0] = 0
        self._waiting.clear()
        self._next = 0.0
        self._clear_history()

    def communication_restored(self) -> None:
        """A new start ends communication errors; other errors stay in the error register."""
        others = self._values[0x1001, 0] & ~(REGISTER_COMMUNICATION | REGISTER_GENERIC)
        self._values[0x1001, 0] = others | REGISTER_GENERIC if others else 0

    def _clear_history(self) -> None:
        for place in range(_HISTORY + 1):
            self._values[0x1003, place] = 0

    def _write_history(self, value: int) -> None:
        if value:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        self._clear_history()

    def _write_identifier(self, value: int) -> None:
        """Valid identifiers of 11 bits; a valid one cannot be exchanged for another one (CiA 301, 7.5.2.17)."""
        before = self._values[0x1014, 0]
        if value & 0x7FFFF800 or (not value & _INVALID and is_restricted(value)):
            raise SdoAbort(AbortCode.INVALID_VALUE)
        if not (before | value) & _INVALID and before != value:
            raise SdoAbort(AbortCode.INVALID_VALUE)
