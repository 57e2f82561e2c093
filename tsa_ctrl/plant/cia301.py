"""Simulate communication services of a node (CiA 301): SYNC, supervision, EMCY, identity and stored parameters.

SYNC: COB-ID 0x1005, period 0x1006, window 0x1007, counter 0x1019. Supervision: 0x1016, 0x100C, 0x100D. EMCY: error
register 0x1001, history 0x1003, COB-ID 0x1014, inhibit time 0x1015. Stored parameters: 0x1010, 0x1011.
The plant has its own definitions, so that it can check those of the controller.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, Key, ObjectDictionary, SdoAbort, Type, is_restricted
from tsa_ctrl.plant.settings import Quirks

PRODUCES = 0x40000000  # bit 30 of 0x1005
OWN_PERIOD = 10_000  # us, SYNC period of a node that produces SYNC at power-on
_LATE = 1.5  # periods without a SYNC after which it is overdue


def sync_entries(producer: bool) -> list[Entry]:
    """Return the objects of SYNC; a `producer` has its own period at power-on."""
    return [
        Entry(0x1005, 0, Type.U32, default=0x80 | (PRODUCES if producer else 0)),
        Entry(0x1006, 0, Type.U32, default=OWN_PERIOD if producer else 0),  # us
        Entry(0x1007, 0, Type.U32),  # us
        Entry(0x1019, 0, Type.U8, high=240),
    ]


class SyncPort:
    """Receive, supervise and produce the SYNC of one node; times are in s."""

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

    def hear(self, data: bytes, now: float) -> bool:
        """Receive a SYNC. Return False for a wrong length: it is 1 with a configured counter, and otherwise 0."""
        if (self._values.get((0x1019, 0), 0) != 0) != (len(data) == 1):
            return False
        self._last = now
        return True

    def closed(self, now: float) -> bool:
        """Return True if the window for synchronous PDOs after the last SYNC has closed."""
        window = self._values.get((0x1007, 0), 0) * 1e-6
        return window > 0.0 and self._last is not None and now - self._last > window

    def overdue(self, now: float) -> bool:
        """Return True, once, if a SYNC is overdue."""
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


class NmtState(IntEnum):
    """List the NMT states (CiA 301) with their values in the heartbeat.

    The plant has its own definitions, so that it can check those of the controller.
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
    """Hold one entry of 0x1016. Supervision begins with the first received heartbeat."""

    node_id: int = 0
    timeout: float = 0.0  # s
    last: float | None = None


class Consumers:
    """Supervise the heartbeats of other nodes; `overdue` reports each missing heartbeat once."""

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
        """Read the entries from the dictionary."""
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
    """Answer remote frames, and detect if none arrives for guard time 0x100C (ms) times life time factor 0x100D."""

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
        """Return the state with the toggle bit; life guarding begins with the first request."""
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


REGISTER_GENERIC = 0x01
REGISTER_COMMUNICATION = 0x10
_FRAME = struct.Struct("<HB5s")
_HISTORY = 8  # entries of 0x1003
_INVALID = 0x80000000


class EmcyCode(IntEnum):
    """List the error codes of CiA 301 and 402 that a simulated node sends without an injected fault."""

    NO_ERROR = 0x0000
    COMMUNICATION = 0x8100  # SYNC overdue
    HEARTBEAT = 0x8130  # life guard or heartbeat error
    PDO_TOO_SHORT = 0x8210
    PDO_TOO_LONG = 0x8220
    SYNC_LENGTH = 0x8240
    RPDO_TIMEOUT = 0x8250


def emcy_entries() -> list[Entry]:
    """Return the objects of the error register, the history and EMCY."""
    return [
        Entry(0x1001, 0, Type.U8, Access.RO, mappable=True),
        Entry(0x1003, 0, Type.U8),
        *(Entry(0x1003, place, Type.U32, Access.RO) for place in range(1, _HISTORY + 1)),
        Entry(0x1014, 0, Type.U32, default=0x80, plus_node=True),
        Entry(0x1015, 0, Type.U16),
    ]


class ErrorLog:
    """Hold the errors of one node, and send them as EMCY frames."""

    def __init__(self, dictionary: ObjectDictionary, send: Callable[[int, bytes], bool]) -> None:
        self._dictionary = dictionary
        self._values = dictionary.values
        self._send = send
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._next = 0.0  # s, earliest time of the next frame
        dictionary.on_write[0x1003, 0] = self._write_history
        dictionary.on_write[0x1014, 0] = self._write_identifier

    def report(self, code: int, register: int, vendor: bytes, heard: bool, now: float) -> None:
        """Store an error in 0x1001 and 0x1003, and send it if the node's state permits this.

        Args:
            code: error code; 0 reports that all errors are gone.
            register: bits of the error register.
            vendor: five manufacturer-specific bytes.
            heard: True if the node may send emergencies in its present state.
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
        """Send the waiting frames, one per inhibit time 0x1015 (unit 100 us)."""
        while self._waiting and now >= self._next:
            self._send(*self._waiting.popleft())
            self._next = now + 1e-4 * self._values.get((0x1015, 0), 0)

    def clear(self) -> None:
        """Delete the errors, the history and the waiting frames, as at power-on."""
        self._values[0x1001, 0] = 0
        self._waiting.clear()
        self._next = 0.0
        self._clear_history()

    def communication_restored(self) -> None:
        """Clear communication errors after a restart; other errors stay in the error register."""
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
        """Accept 11-bit identifiers. A valid one cannot be replaced directly by another one (CiA 301, 7.5.2.17)."""
        before = self._values[0x1014, 0]
        if value & 0x7FFFF800 or (not value & _INVALID and is_restricted(value)):
            raise SdoAbort(AbortCode.INVALID_VALUE)
        if not (before | value) & _INVALID and before != value:
            raise SdoAbort(AbortCode.INVALID_VALUE)


SAVE = 0x65766173  # "save", least significant byte first
LOAD = 0x64616F6C  # "load"
_ON_COMMAND = 1  # value of both objects when read; bit 0: parameters are saved on command
_PASSING: frozenset[Key] = frozenset({(0x1003, 0), (0x6040, 0), (0x6071, 0)})  # commands, which are not saved


class Storage:
    """Save and restore the parameters of one node (CiA 301: 0x1010 "save", 0x1011 "load").

    `saves` is the number of saves since the plant's start, because each save wears the memory of a real node.
    """

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self.saves = 0
        dictionary.on_write[0x1010, 1] = self._save
        dictionary.on_write[0x1011, 1] = self._load

    def _save(self, value: int) -> None:
        if value != SAVE:
            raise SdoAbort(AbortCode.CANNOT_STORE)
        dictionary = self._dictionary
        self.saves += 1
        for key, entry in dictionary.entries.items():
            if entry.access is Access.RW and isinstance(entry.default, int) and key not in _PASSING:
                dictionary.stored[key] = dictionary.values[key]
        self._forget_commands()

    def _load(self, value: int) -> None:
        """Discard the saved parameters, so that the defaults apply from the next reset."""
        if value != LOAD:
            raise SdoAbort(AbortCode.CANNOT_STORE)
        self._dictionary.stored.clear()
        self._forget_commands()

    def _forget_commands(self) -> None:
        for place in (0x1010, 0x1011):
            self._dictionary.stored.pop((place, 1), None)


@dataclass(frozen=True, slots=True)
class Identity:
    """Hold 0x1000, 0x1008 and 0x1018 of a node."""

    device_type: int
    name: str
    vendor: int = 0x00000F0F
    product: int = 0
    revision: int = 0x00010000
    serial: int = 1

    @property
    def numbers(self) -> tuple[int, int, int, int]:
        """Return 0x1018:1 to :4."""
        return self.vendor, self.product, self.revision, self.serial


def communication_objects(identity: Identity, quirks: Quirks) -> Iterator[Entry]:
    """Yield the entries 0x1000 to 0x1029 of a node, according to its identity and quirks."""
    yield Entry(0x1000, 0, Type.U32, Access.CONST, identity.device_type)
    yield from emcy_entries()
    yield from sync_entries(quirks.sync_producer)
    yield Entry(0x1008, 0, Type.TEXT, Access.CONST, identity.name)
    yield Entry(0x1009, 0, Type.TEXT, Access.CONST, "simulated")
    yield Entry(0x100A, 0, Type.TEXT, Access.CONST, "1")
    for index in (0x1010, 0x1011):  # one group of parameters, which is saved on command
        yield Entry(index, 0, Type.U8, Access.CONST, 1)
        yield Entry(index, 1, Type.U32, Access.RW, _ON_COMMAND)
    if quirks.node_guarding:
        yield from Guarding.objects()
    else:
        yield from Consumers.objects(quirks.heartbeat_consumers)
        yield Entry(0x1017, 0, Type.U16)
    yield Entry(0x1018, 0, Type.U8, Access.CONST, 4)
    for sub, value in enumerate(identity.numbers, 1):
        yield Entry(0x1018, sub, Type.U32, Access.CONST, value)
    yield Entry(0x1029, 0, Type.U8, Access.CONST, 1)
    yield Entry(0x1029, 1, Type.U8, default=0, high=2)
