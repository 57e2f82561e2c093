"""Simulate the heartbeat consumers (0x1016) and the node guarding (0x100C, 0x100D) of one node, CiA 301."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, ObjectDictionary, SdoAbort, Type


class NmtState(IntEnum):
    """List the NMT states (CiA 301), with the values in the heartbeat.

    The plant does not use the controller's definitions, so that it checks them.
    """

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """List the command specifiers of NMT (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


_TOGGLE = 0x80


@dataclass(slots=True)
class _Consumer:
    """One entry of 0x1016: supervision begins with the first heartbeat seen."""

    node_id: int = 0
    timeout: float = 0.0  # s
    last: float | None = None


class Consumers:
    """Heartbeats of others; `overdue` reports once that one is missed."""

    def __init__(self, dictionary: ObjectDictionary, count: int, changed: Callable[[], None]) -> None:
        self._values = dictionary.values
        self._changed = changed
        self._entries = [_Consumer() for _ in range(count)]
        for place in range(count):
            dictionary.on_write[0x1016, place + 1] = self._hook(place)

    @staticmethod
    def objects(count: int) -> list[Entry]:
        return [
            Entry(0x1016, 0, Type.U8, Access.CONST, count),
            *(Entry(0x1016, place, Type.U32) for place in range(1, count + 1)),
        ]

    def restore(self) -> None:
        """Take the values of the dictionary."""
        self._entries = [
            _consumer(self._values.get((0x1016, place + 1), 0)) or _Consumer() for place in range(len(self._entries))
        ]

    def handlers(self) -> dict[int, Callable[[bytes, float], None]]:
        """Return the callback of each identifier."""
        return {0x700 + entry.node_id: self._handler(entry) for entry in self._entries if entry.node_id}

    def overdue(self, now: float) -> bool:
        found = False
        for entry in self._entries:
            if entry.last is not None and now - entry.last > entry.timeout:
                entry.last = None
                found = True
        return found

    def _handler(self, entry: _Consumer) -> Callable[[bytes, float], None]:
        def handle(data: bytes, now: float) -> None:
            entry.last = now

        return handle

    def _hook(self, place: int) -> Callable[[int], None]:
        def write(value: int) -> None:
            entry = _consumer(value)
            if entry is None:
                raise SdoAbort(AbortCode.INVALID_VALUE)
            others = (other for number, other in enumerate(self._entries) if number != place)
            if entry.node_id and any(entry.node_id == other.node_id for other in others):
                raise SdoAbort(AbortCode.INCOMPATIBLE)  # CiA 301, 7.5.2.19: one node, one entry
            self._entries[place] = entry
            self._changed()

        return write


def _consumer(value: int) -> _Consumer | None:
    node_id, timeout = value >> 16 & 0xFF, (value & 0xFFFF) * 1e-3
    if node_id > 127:
        return None
    return _Consumer(node_id, timeout) if node_id and timeout > 0.0 else _Consumer()


class Guarding:
    """Answers remote frames, and notices when they stop: guard time 0x100C (ms) times life time factor 0x100D."""

    def __init__(self, dictionary: ObjectDictionary, toggles: bool = True) -> None:
        self._values = dictionary.values
        self.toggles = toggles
        self._toggle = 0
        self._asked: float | None = None

    @staticmethod
    def objects() -> list[Entry]:
        return [Entry(0x100C, 0, Type.U16), Entry(0x100D, 0, Type.U8)]

    def restore(self) -> None:
        self._toggle, self._asked = 0, None

    def answer(self, state: NmtState, now: float) -> bytes:
        """The state with the toggle bit; life guarding begins with the first request."""
        self._asked = now
        data = bytes((state | self._toggle,))
        self._toggle ^= _TOGGLE if self.toggles else 0
        return data

    def overdue(self, now: float) -> bool:
        life = self._values.get((0x100C, 0), 0) * self._values.get((0x100D, 0), 0) * 1e-3
        if self._asked is None or life <= 0.0 or now - self._asked <= life:
            return False
        self._asked = None
        return True
