"""Simulate process data objects (CiA 301): communication and mapping parameters, packing and unpacking.

Mapping procedure of the master: disable (bit 31 of the COB-ID), count 0, map, count, enable. Any other order is
rejected.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, Key, ObjectDictionary, SdoAbort, Type

INVALID = 0x80000000  # COB-ID bit 31: the PDO does not exist
NO_REMOTE = 0x40000000  # COB-ID bit 30 of a TPDO: no remote frames allowed
_DUMMIES = {entry.number: entry for entry in Type if 0x0002 <= entry.number <= 0x0007}  # fill gaps in an RPDO


class Direction(Enum):
    """List the directions as seen from the node, with the first index of communication and mapping parameters."""

    RPDO = (0x1400, 0x1600)
    TPDO = (0x1800, 0x1A00)


@dataclass(frozen=True, slots=True)
class PdoDefault:
    """Define a PDO at power-on: COB-ID without the node id (bit 31 set: off), transmission type, mapped objects."""

    cob_id: int
    transmission: int = 255
    mapping: tuple[Key, ...] = ()


def is_synchronous(transmission: int) -> bool:
    """Return True if a transmission type is synchronous (CiA 301, 7.5.2.36)."""
    return transmission <= 240


class Pdo:
    """Simulate one PDO of a node. Its parameters are in the dictionary; a change of them compiles the packing again."""

    direction: Direction

    def __init__(
        self, dictionary: ObjectDictionary, number: int, default: PdoDefault, changed: Callable[[], None]
    ) -> None:
        self.communication, self.mapping = (base + number for base in self.direction.value)
        self._dictionary = dictionary
        self._changed = changed
        self.keys: tuple[Key, ...] = ()
        self.packing = struct.Struct("<")
        self._add_entries(default)
        self.compile()

    def _add_entries(self, default: PdoDefault) -> None:
        c, m = self.communication, self.mapping
        no_remote = NO_REMOTE if self.direction is Direction.TPDO else 0
        entries = [
            Entry(c, 0, Type.U8, Access.CONST, 5),
            Entry(c, 1, Type.U32, Access.RW, default.cob_id | no_remote, plus_node=bool(default.cob_id & 0x7FF)),
            Entry(c, 2, Type.U8, Access.RW, default.transmission),
            Entry(c, 3, Type.U16, Access.RW, 0),  # inhibit time, 100 us
            Entry(c, 5, Type.U16, Access.RW, 0),  # event timer, ms
            Entry(m, 0, Type.U8, Access.RW, len(default.mapping), high=8),
        ]
        for place in range(8):
            key = default.mapping[place] if place < len(default.mapping) else None
            bits = self._dictionary.find(key).type.size * 8 if key else 0
            value = key[0] << 16 | key[1] << 8 | bits if key else 0
            entries.append(Entry(m, place + 1, Type.U32, Access.RW, value))
        hooks = self._dictionary.on_write
        for entry in entries:
            self._dictionary.add(entry)
            if entry.access is Access.RW:
                hooks[entry.key] = self._hook(entry.key)

    def _hook(self, key: Key) -> Callable[[int], None]:
        index, sub = key

        def check(value: int) -> None:
            if index == self.communication and sub == 1:
                self._check_cob_id(value)
            elif index == self.communication and sub == 2 and 241 <= value <= 253:
                raise SdoAbort(AbortCode.INVALID_VALUE)
            elif index == self.mapping:
                if self.valid:
                    raise SdoAbort(AbortCode.DEVICE_STATE)
                if sub == 0:
                    self._layout(value)
                elif self._dictionary.values[self.mapping, 0]:
                    raise SdoAbort(AbortCode.DEVICE_STATE)
                else:
                    self._mapped(value)
            self._dictionary.values[key] = value
            self.compile()

        return check

    def _check_cob_id(self, value: int) -> None:
        if self.valid and not value & INVALID and (value ^ self.raw_cob_id) & 0x3FFFFFFF:
            raise SdoAbort(AbortCode.DEVICE_STATE)
        if value & 0x3FFFF800 or (not value & INVALID and not 0x180 < value & 0x7FF < 0x580):
            raise SdoAbort(AbortCode.INVALID_VALUE)

    def _mapped(self, value: int) -> tuple[Key, Type]:
        """Return the object of one mapping entry; raises SdoAbort if it cannot be mapped."""
        index, sub, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
        if index in _DUMMIES and sub == 0 and self.direction is Direction.RPDO:
            kind = _DUMMIES[index]
        else:
            entry = self._dictionary.entries.get((index, sub))
            if entry is None:
                raise SdoAbort(AbortCode.NO_OBJECT)
            readable = entry.access is not Access.WO
            writable = entry.access in (Access.RW, Access.WO)
            if (
                not entry.mappable
                or not entry.type.code
                or not (readable if self.direction is Direction.TPDO else writable)
            ):
                raise SdoAbort(AbortCode.NOT_MAPPABLE)
            kind = entry.type
        if bits != kind.size * 8:
            raise SdoAbort(AbortCode.NOT_MAPPABLE)
        return (index, sub), kind

    def _layout(self, count: int) -> tuple[tuple[Key, ...], str]:
        mapped = [self._mapped(self._dictionary.values[self.mapping, place + 1]) for place in range(count)]
        if sum(kind.size for _, kind in mapped) > 8:
            raise SdoAbort(AbortCode.PDO_LENGTH)
        return tuple(key for key, _ in mapped), "<" + "".join(kind.code for _, kind in mapped)

    def compile(self) -> None:
        """Apply the parameters, and notify the node so that it receives the right identifier."""
        values = self._dictionary.values
        self.raw_cob_id = values.get((self.communication, 1), INVALID)
        self.cob_id = self.raw_cob_id & 0x7FF
        self.valid = not self.raw_cob_id & INVALID and (self.mapping, 0) in values
        self.transmission = values.get((self.communication, 2), 255)
        self.synchronous = is_synchronous(self.transmission)
        self.inhibit = values.get((self.communication, 3), 0) * 1e-4  # s
        self.event_timer = values.get((self.communication, 5), 0) * 1e-3  # s
        if self.valid:
            self.keys, code = self._layout(values[self.mapping, 0])
            self.packing = struct.Struct(code)
        self._changed()


class Tpdo(Pdo):
    """Simulate a PDO that the node transmits."""

    direction = Direction.TPDO
    syncs = 0
    sent_at = -1.0e9
    last = b""

    def pack(self) -> bytes:
        return self.packing.pack(*map(self._dictionary.values.__getitem__, self.keys))

    def due_on_sync(self) -> bool:
        """Count one SYNC, and return True if the PDO is sent on it. Type 0 is sent if its data have changed."""
        if not (self.valid and self.synchronous):
            return False
        if self.transmission == 0:
            return self.pack() != self.last
        self.syncs += 1
        if self.syncs < self.transmission:
            return False
        self.syncs = 0
        return True

    def due_on_event(self, now: float) -> bool:
        """Return True if an event-driven PDO (types 254, 255) is due by its timer or by changed data.

        It is never due before the inhibit time.
        """
        if not self.valid or self.synchronous or now - self.sent_at < self.inhibit:
            return False
        if self.event_timer > 0.0 and now - self.sent_at >= self.event_timer:
            return True
        return self.pack() != self.last


class Rpdo(Pdo):
    """Simulate a PDO that the node receives.

    A synchronous PDO acts at the next SYNC. `delay` more SYNCs delay any PDO.
    """

    direction = Direction.RPDO

    def __init__(
        self,
        dictionary: ObjectDictionary,
        number: int,
        default: PdoDefault,
        changed: Callable[[], None],
        delay: int = 0,
    ) -> None:
        self.received_at: float | None = None
        self._delay = delay
        self._pending: bytes | None = None  # last frame since the last SYNC
        self._line: deque[bytes | None] = deque()  # frames before it, the oldest first
        super().__init__(dictionary, number, default, changed)

    def forget(self) -> None:
        """Discard received values."""
        self._pending = self.received_at = None
        self._line.clear()

    def take(self, data: bytes, now: float) -> bytes | None:
        """Accept one frame. Return it if it acts at once; otherwise store it and return None."""
        self.received_at = now
        if not self.synchronous and self._delay == 0:
            return data
        self._pending = data
        return None

    def due(self) -> bytes | None:
        """Return the frame that acts at the current SYNC, or None."""
        pending, self._pending = self._pending, None
        steps = self._delay if self.synchronous else self._delay - 1
        if steps <= 0:
            return pending
        self._line.append(pending)
        return self._line.popleft() if len(self._line) > steps else None

    def unpack(self, data: bytes) -> list[tuple[Key, int]]:
        """Return the values of a frame at least as long as the mapping, without dummies."""
        values = self.packing.unpack(data[: self.packing.size])
        return [(key, value) for key, value in zip(self.keys, values, strict=True) if key[0] > 0x1F]
