"""Simulate the object dictionary of a node (CiA 301), and write its EDS (CiA 306).

The dictionary has typed entries, access rights, bounds and SDO abort codes. The EDS has every section and key that
CANopenEditor requires, and identical nodes have identical files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum, IntEnum
from pathlib import Path

from tsa_ctrl.errors import UsageError

Key = tuple[int, int]  # index, sub-index


class AbortCode(IntEnum):
    """SDO abort codes of CiA 301."""

    TOGGLE_BIT = 0x05030000
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


_RESTRICTED = (  # first and last identifiers of ranges that no communication object may use (CiA 301, 7.3.5)
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
    """Report that the node rejects an SDO request, with the abort code."""

    def __init__(self, code: AbortCode) -> None:
        super().__init__(f"{code.name} 0x{code:08X}")
        self.code = code


class Type(Enum):
    """List the basic data types: CiA 301 number, struct format, size in bytes, bounds. TEXT is VISIBLE_STRING.

    Real numbers are stored as their bit patterns. Types without a struct format cannot be mapped into a PDO.
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
    """Define one object of the dictionary.

    `low` and `high` narrow the bounds of the type. `mappable` allows the object in a PDO. With `plus_node`, the node id
    is added to the default, as for the identifiers of the predefined connection set.
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
    """Hold the values of a node by (index, sub-index).

    The node itself writes the numbers in `values` without checks. A hook in `on_write` is called with the new value,
    after all checks and before the value is stored. It may raise SdoAbort. `stored` holds values that survive a power
    cycle and replace the defaults.
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
            return
        value = self.power_on_value(entry)
        if not entry.type.low <= value <= entry.type.high:
            raise UsageError(
                f"object 0x{entry.index:04X}:{entry.sub} is {value} at power-on; allowed is {entry.type.low} to "
                f"{entry.type.high}; correct the setting that it follows from"
            )
        self.values[entry.key] = value

    def power_on_value(self, entry: Entry) -> int:
        """Return the value of a numeric object after power-on."""
        assert isinstance(entry.default, int)
        return self.stored.get(entry.key, entry.default + (self.node_id if entry.plus_node else 0))

    def remove(self, index: int, sub: int | None = None) -> None:
        """Remove an object or one of its sub-indices, as on a drive that does not have it."""
        if sub is not None:  # the node itself may still read the value
            self.entries.pop((index, sub), None)
            return
        for key in [key for key in self.entries if key[0] == index]:
            del self.entries[key]
            self.values.pop(key, None)

    def restore(self, first: int = 0, last: int = 0xFFFF) -> None:
        """Restore the power-on values of the objects with an index in [first, last]."""
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
        """Return the little-endian bytes of an object for an SDO upload; raises SdoAbort."""
        entry = self.find(key)
        if entry.access is Access.WO:
            raise SdoAbort(AbortCode.WRITE_ONLY)
        if entry.type is Type.TEXT:
            return self.texts[key].encode("latin-1")
        return self.values[key].to_bytes(entry.type.size, "little", signed=entry.type.low < 0)

    def write(self, key: Key, data: bytes) -> None:
        """Write an object by SDO download if access, length and bounds are correct; otherwise raises SdoAbort."""
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


_NAMES = {
    0x1000: "Device type", 0x1001: "Error register", 0x1003: "Pre-defined error field", 0x1005: "COB-ID SYNC message",
    0x1006: "Communication cycle period", 0x1007: "Synchronous window length", 0x1008: "Manufacturer device name",
    0x1009: "Manufacturer hardware version", 0x100A: "Manufacturer software version", 0x100C: "Guard time",
    0x100D: "Life time factor", 0x1010: "Store parameters", 0x1011: "Restore default parameters",
    0x1014: "COB-ID EMCY", 0x1015: "Inhibit time EMCY", 0x1016: "Consumer heartbeat time",
    0x1017: "Producer heartbeat time", 0x1018: "Identity", 0x1019: "Synchronous counter overflow value",
    0x1029: "Error behavior", 0x6000: "Operating parameters", 0x6001: "Measuring units per revolution",
    0x6002: "Total measuring range in measuring units", 0x6004: "Position value",
    0x6007: "Abort connection option code", 0x6030: "Speed value", 0x6031: "Speed parameter", 0x603F: "Error code",
    0x6040: "Controlword", 0x6041: "Statusword", 0x605A: "Quick stop option code", 0x605B: "Shutdown option code",
    0x605C: "Disable operation option code", 0x605D: "Halt option code", 0x605E: "Fault reaction option code",
    0x6060: "Modes of operation", 0x6061: "Modes of operation display", 0x6064: "Position actual value",
    0x606C: "Velocity actual value", 0x6071: "Target torque", 0x6072: "Max torque", 0x6075: "Motor rated current",
    0x6076: "Motor rated torque", 0x6077: "Torque actual value", 0x6080: "Max motor speed", 0x6087: "Torque slope",
    0x60A9: "SI unit velocity", 0x60C2: "Interpolation time period", 0x6131: "AI physical unit process value",
    0x6501: "Single-turn resolution", 0x6502: "Supported drive modes", 0x67FF: "Device type of the axis",
    0x9130: "AI input process value",
}  # fmt: skip
_ARRAYS = frozenset({0x1003, 0x1010, 0x1011, 0x1016})
_VARIABLE, _ARRAY, _RECORD = 7, 8, 9
_MANDATORY = (0x1000, 0x1001, 0x1018)
_RECEIVED, _SENT = range(0x1400, 0x1600), range(0x1800, 0x1A00)
_DATE, _TIME = "01-01-2000", "12:00AM"  # constant, so that identical nodes have identical files
_AXIS_OFFSET = 0x800


def eds(dictionary: ObjectDictionary, file_name: str) -> str:
    """Return the text of the EDS for a node with this dictionary."""
    return "\r\n".join(_lines(dictionary, file_name)) + "\r\n"


def file_names(path: Path, node_ids: Iterable[int]) -> dict[int, Path]:
    """Return the path of each node's EDS by node id: `path`, with the node id appended if there are several nodes."""
    ids = list(node_ids)
    if len(ids) == 1:
        return {ids[0]: path}
    suffix = path.suffix or ".eds"
    return {node_id: path.with_name(f"{path.stem}-{node_id}{suffix}") for node_id in ids}


def _lines(dictionary: ObjectDictionary, file_name: str) -> Iterator[str]:
    entries: dict[int, list[Entry]] = {}
    for key in sorted(dictionary.entries):
        entries.setdefault(key[0], []).append(dictionary.entries[key])
    yield from (
        "[FileInfo]", f"FileName={file_name}", "FileVersion=1", "FileRevision=1", "EDSVersion=4.0",
        "Description=simulated node of tsa plant", f"CreationTime={_TIME}", f"CreationDate={_DATE}",
        "CreatedBy=tsa plant", f"ModificationTime={_TIME}", f"ModificationDate={_DATE}", "ModifiedBy=tsa plant", "",
    )  # fmt: skip
    yield from _device_info(dictionary, entries)
    yield "[DummyUsage]"
    yield from (f"Dummy{number:04X}={int(number != 1)}" for number in range(1, 8))
    yield from ("", "[Comments]", "Lines=1", "Line1=The dictionary of a simulated node at power-on", "")
    optional = [index for index in entries if index not in _MANDATORY and not 0x2000 <= index < 0x6000]
    yield from _list_of("MandatoryObjects", [index for index in _MANDATORY if index in entries])
    yield from _list_of("OptionalObjects", optional)
    yield from _list_of("ManufacturerObjects", [index for index in entries if 0x2000 <= index < 0x6000])
    for index, members in entries.items():
        yield from _object(index, members)


def _device_info(dictionary: ObjectDictionary, entries: dict[int, list[Entry]]) -> Iterator[str]:
    values = dictionary.values
    yield "[DeviceInfo]"
    yield "VendorName=tsa plant"
    yield f"VendorNumber=0x{values.get((0x1018, 1), 0):08X}"
    yield f"ProductName={dictionary.texts.get((0x1008, 0), '')}"
    yield f"ProductNumber=0x{values.get((0x1018, 2), 0):08X}"
    yield f"RevisionNumber=0x{values.get((0x1018, 3), 0):08X}"
    yield "OrderCode="
    yield from (f"BaudRate_{rate}=1" for rate in (10, 20, 50, 125, 250, 500, 800, 1000))
    yield from ("SimpleBootUpMaster=0", "SimpleBootUpSlave=1", "Granularity=8", "DynamicChannelsSupported=0")
    yield from ("CompactPDO=0", "GroupMessaging=0")
    yield f"NrOfRXPDO={sum(index in _RECEIVED for index in entries)}"
    yield f"NrOfTXPDO={sum(index in _SENT for index in entries)}"
    yield from ("LSS_Supported=1", "")


def _list_of(section: str, indices: list[int]) -> Iterator[str]:
    yield f"[{section}]"
    yield f"SupportedObjects={len(indices)}"
    yield from (f"{number}=0x{index:04X}" for number, index in enumerate(indices, 1))
    yield ""


def _object(index: int, members: list[Entry]) -> Iterator[str]:
    name = _name(index)
    yield f"[{index:04X}]"
    yield f"ParameterName={name}"
    if len(members) == 1 and members[0].sub == 0:
        yield f"ObjectType=0x{_VARIABLE:X}"
        yield from _value(members[0])
        yield ""
        return
    yield f"ObjectType=0x{_ARRAY if index in _ARRAYS else _RECORD:X}"
    yield f"SubNumber=0x{len(members):X}"
    yield ""
    for entry in members:
        yield f"[{index:04X}sub{entry.sub:X}]"
        yield f"ParameterName={'Highest sub-index supported' if entry.sub == 0 else f'{name} {entry.sub}'}"
        yield f"ObjectType=0x{_VARIABLE:X}"
        yield from _value(entry)
        yield ""


def _value(entry: Entry) -> Iterator[str]:
    yield f"DataType=0x{entry.type.number:04X}"
    yield f"AccessType={entry.access.value}"
    yield f"DefaultValue={_default(entry)}"
    yield f"PDOMapping={int(entry.mappable)}"
    if entry.type is not Type.TEXT and entry.access in (Access.RW, Access.WO):
        if entry.low is not None:
            yield f"LowLimit={entry.low}"
        if entry.high is not None:
            yield f"HighLimit={entry.high}"


def _default(entry: Entry) -> str:
    if isinstance(entry.default, str):
        return entry.default
    if entry.plus_node:
        return f"$NODEID+0x{entry.default:X}"
    return str(entry.default) if entry.type.low < 0 else f"0x{entry.default:X}"


def _name(index: int) -> str:
    for base, name in (
        (0x1400, "RPDO communication parameter"),
        (0x1600, "RPDO mapping parameter"),
        (0x1800, "TPDO communication parameter"),
        (0x1A00, "TPDO mapping parameter"),
    ):
        if base <= index < base + 0x200:
            return f"{name} {index - base + 1}"
    plain, axis = index, 1
    while plain >= 0x6800 and plain not in _NAMES:
        plain, axis = plain - _AXIS_OFFSET, axis + 1
    name = _NAMES.get(plain, f"Object 0x{index:04X}")
    return name if axis == 1 else f"{name} of axis {axis}"
