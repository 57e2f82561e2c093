"""Object dictionary of a simulated node (CiA 301): typed entries, access rights, bounds, SDO abort codes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum

Key = tuple[int, int]  # index, sub-index


class AbortCode(IntEnum):
    """SDO abort codes of CiA 301."""

    TOGGLE_BIT = 0x05030000
    TIMED_OUT = 0x05040000
    UNKNOWN_COMMAND = 0x05040001
    OUT_OF_MEMORY = 0x05040005
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    INCOMPATIBLE = 0x06040043
    LENGTH = 0x06070010
    TOO_LONG = 0x06070012
    TOO_SHORT = 0x06070013
    NO_SUBINDEX = 0x06090011
    INVALID_VALUE = 0x06090030
    TOO_HIGH = 0x06090031
    TOO_LOW = 0x06090032
    CANNOT_STORE = 0x08000020
    DEVICE_STATE = 0x08000022


_RESTRICTED = (  # first and last identifier that no communication object may be given (CiA 301, 7.3.5)
    (0x000, 0x07F),
    (0x101, 0x180),
    (0x581, 0x5FF),
    (0x601, 0x67F),
    (0x6E0, 0x7FF),
)


def is_restricted(can_id: int) -> bool:
    """Return True if an identifier belongs to NMT, SDO, heartbeat or LSS, or is reserved."""
    return any(first <= can_id <= last for first, last in _RESTRICTED)


class SdoAbort(Exception):  # noqa: N818, the standard's word
    """An SDO request that the node refuses, with its code."""

    def __init__(self, code: AbortCode) -> None:
        super().__init__(f"{code.name} 0x{code:08X}")
        self.code = code


class Type(Enum):
    """Basic data types: CiA 301 number, struct format, bytes, bounds. TEXT is VISIBLE_STRING.

    Reals are held as their bits. Types without a struct format cannot be mapped into a PDO.
    """

    BOOL = (0x01, "B", 1, 0, 1)
    I8 = (0x02, "b", 1, -(1 << 7), (1 << 7) - 1)
    I16 = (0x03, "h", 2, -(1 << 15), (1 << 15) - 1)
    I32 = (0x04, "i", 4, -(1 << 31), (1 << 31) - 1)
    U8 = (0x05, "B", 1, 0, (1 << 8) - 1)
    U16 = (0x06, "H", 2, 0, (1 << 16) - 1)
    U32 = (0x07, "I", 4, 0, (1 << 32) - 1)
    F32 = (0x08, "I", 4, 0, (1 << 32) - 1)
    TEXT = (0x09, "", 0, 0, 0)
    I24 = (0x10, "", 3, -(1 << 23), (1 << 23) - 1)
    F64 = (0x11, "Q", 8, 0, (1 << 64) - 1)
    I40 = (0x12, "", 5, -(1 << 39), (1 << 39) - 1)
    I48 = (0x13, "", 6, -(1 << 47), (1 << 47) - 1)
    I56 = (0x14, "", 7, -(1 << 55), (1 << 55) - 1)
    I64 = (0x15, "q", 8, -(1 << 63), (1 << 63) - 1)
    U24 = (0x16, "", 3, 0, (1 << 24) - 1)
    U40 = (0x18, "", 5, 0, (1 << 40) - 1)
    U48 = (0x19, "", 6, 0, (1 << 48) - 1)
    U56 = (0x1A, "", 7, 0, (1 << 56) - 1)
    U64 = (0x1B, "Q", 8, 0, (1 << 64) - 1)

    def __init__(self, number: int, code: str, size: int, low: int, high: int) -> None:
        self.number = number
        self.code = code
        self.size = size
        self.low = low
        self.high = high


class Access(Enum):
    """List the access rights of an object over SDO."""

    CONST = "const"
    RO = "ro"
    RW = "rw"
    WO = "wo"


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the dictionary; `low`/`high` narrow the type, `mappable` allows it in a PDO.

    `plus_node`: the node id is added to the default, as to the identifiers of the predefined connection set.
    """

    index: int
    sub: int
    type: Type
    access: Access = Access.RW
    default: int | str = 0
    mappable: bool = False
    low: int | None = None
    high: int | None = None
    plus_node: bool = False

    @property
    def key(self) -> Key:
        return self.index, self.sub


class ObjectDictionary:
    """Values by (index, sub-index). `values` holds the numbers; the node itself writes there without checks.

    A hook of `on_write` is called with the new value after all checks and before it is stored; it may raise SdoAbort.
    `stored`: values kept through a power cycle, in place of the defaults.
    """

    def __init__(self, entries: Iterable[Entry], node_id: int = 0) -> None:
        self.node_id = node_id
        self.stored: dict[Key, int] = {}
        self.entries: dict[Key, Entry] = {}
        self.values: dict[Key, int] = {}
        self.texts: dict[Key, str] = {}
        self.on_write: dict[Key, Callable[[int], None]] = {}
        for entry in entries:
            self.add(entry)

    def add(self, entry: Entry) -> None:
        self.entries[entry.key] = entry
        if isinstance(entry.default, str):
            self.texts[entry.key] = entry.default
        else:
            self.values[entry.key] = self.power_on_value(entry)

    def power_on_value(self, entry: Entry) -> int:
        """Return the value of a numeric object after power-on."""
        assert isinstance(entry.default, int)
        return self.stored.get(entry.key, entry.default + (self.node_id if entry.plus_node else 0))

    def remove(self, index: int, sub: int | None = None) -> None:
        """Take an object away, or one sub-index of it, as on a drive that does not have it."""
        if sub is not None:  # the node itself may still look at its value
            self.entries.pop((index, sub), None)
            return
        for key in [key for key in self.entries if key[0] == index]:
            del self.entries[key]
            self.values.pop(key, None)

    def restore(self, first: int = 0, last: int = 0xFFFF) -> None:
        """Power-on values of the objects with an index in [first, last]."""
        for key, entry in self.entries.items():
            if first <= key[0] <= last and isinstance(entry.default, int):
                self.values[key] = self.power_on_value(entry)

    def find(self, key: Key) -> Entry:
        entry = self.entries.get(key)
        if entry is None:
            known = any(index == key[0] for index, _ in self.entries)
            raise SdoAbort(AbortCode.NO_SUBINDEX if known else AbortCode.NO_OBJECT)
        return entry

    def read(self, key: Key) -> bytes:
        """SDO upload: little-endian bytes; raises SdoAbort."""
        entry = self.find(key)
        if entry.access is Access.WO:
            raise SdoAbort(AbortCode.WRITE_ONLY)
        if entry.type is Type.TEXT:
            return self.texts[key].encode("latin-1")
        return self.values[key].to_bytes(entry.type.size, "little", signed=entry.type.low < 0)

    def write(self, key: Key, data: bytes) -> None:
        """SDO download with access, length and bounds checked; raises SdoAbort and changes nothing."""
        entry = self.find(key)
        if entry.access in (Access.RO, Access.CONST):
            raise SdoAbort(AbortCode.READ_ONLY)
        if entry.type is Type.TEXT:
            self.texts[key] = data.decode("latin-1")
            return
        if len(data) != entry.type.size:
            raise SdoAbort(AbortCode.TOO_LONG if len(data) > entry.type.size else AbortCode.TOO_SHORT)
        value = int.from_bytes(data, "little", signed=entry.type.low < 0)
        if value > (entry.type.high if entry.high is None else entry.high):
            raise SdoAbort(AbortCode.TOO_HIGH)
        if entry.low is not None and value < entry.low:
            raise SdoAbort(AbortCode.TOO_LOW)
        hook = self.on_write.get(key)
        if hook is not None:
            hook(value)
        self.values[key] = value
