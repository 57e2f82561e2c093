"""The EDS of a simulated node (CiA 306): what its dictionary holds, for the tools that want such a file.

Every section and key that CANopenEditor asks for is there; the same node gives the same file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from tsa_ctrl.plant.dictionary import Access, Entry, ObjectDictionary, Type

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
_DATE, _TIME = "01-01-2000", "12:00AM"  # of no meaning: the same node gives the same file
_AXIS_OFFSET = 0x800


def eds(dictionary: ObjectDictionary, file_name: str) -> str:
    """The file's text for a node with this dictionary."""
    return "\r\n".join(_lines(dictionary, file_name)) + "\r\n"


def file_names(path: Path, node_ids: Iterable[int]) -> dict[int, Path]:
    """Where the EDS of each node goes: to `path`, or next to it with the node id if there are several."""
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
        yield from _object(dictionary, index, members)


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


def _object(dictionary: ObjectDictionary, index: int, members: list[Entry]) -> Iterator[str]:
    name = _name(index)
    yield f"[{index:04X}]"
    yield f"ParameterName={name}"
    if len(members) == 1 and members[0].sub == 0:
        yield f"ObjectType=0x{_VARIABLE:X}"
        yield from _value(dictionary, members[0])
        yield ""
        return
    yield f"ObjectType=0x{_ARRAY if index in _ARRAYS else _RECORD:X}"
    yield f"SubNumber=0x{len(members):X}"
    yield ""
    for entry in members:
        yield f"[{index:04X}sub{entry.sub:X}]"
        yield f"ParameterName={'Highest sub-index supported' if entry.sub == 0 else f'{name} {entry.sub}'}"
        yield f"ObjectType=0x{_VARIABLE:X}"
        yield from _value(dictionary, entry)
        yield ""


def _value(dictionary: ObjectDictionary, entry: Entry) -> Iterator[str]:
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
