"""The objects of a simulated CiA 402 drive, and what its PDOs are after power-on."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping

from tsa_ctrl.plant.dictionary import Access, Entry, Key, Type
from tsa_ctrl.plant.drive_emulation import RPM
from tsa_ctrl.plant.pdo import INVALID, PdoDefault
from tsa_ctrl.plant.settings import DriveSettings

AXIS_OFFSET = 0x800  # between the objects of two axes of one device (CiA 301, 7.5.1.1)
PDO_OFFSET = 0x40  # between their PDOs
_PROFILE = range(0x6000, 0xA000)
_MODES = {"pp": 1, "pv": 3, "tq": 4, "csp": 8, "csv": 9, "cst": 10}  # values of 0x6060
# The layout that this controller maps: for drives whose mapping cannot be written.
_COMMAND: tuple[Key, ...] = ((0x6040, 0), (0x6071, 0))
_MOTION: tuple[Key, ...] = ((0x6041, 0), (0x6077, 0), (0x606C, 0))
_POSITION: tuple[Key, ...] = ((0x6064, 0), (0x6061, 0), (0x603F, 0))


def mode_numbers(settings: DriveSettings) -> frozenset[int]:
    """Values that 0x6060 takes."""
    return frozenset(_MODES[name] for name in settings.modes) | {0}


def shifted(key: Key, offset: int) -> Key:
    """Where an object of the first axis lies for an axis `offset` further."""
    return (key[0] + offset, key[1]) if key[0] in _PROFILE else key


class AxisValues(MutableMapping[Key, int]):
    """The values of a node as one of its further axes calls them."""

    def __init__(self, values: MutableMapping[Key, int], offset: int) -> None:
        self._values = values
        self._offset = offset

    def __getitem__(self, key: Key) -> int:
        return self._values[shifted(key, self._offset)]

    def __setitem__(self, key: Key, value: int) -> None:
        self._values[shifted(key, self._offset)] = value

    def __delitem__(self, key: Key) -> None:
        del self._values[shifted(key, self._offset)]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)


def unit_code(settings: DriveSettings) -> int:
    """0x60A9: 10^exponent revolutions per minute."""
    return (settings.velocity_exponent & 0xFF) << 24 | RPM


def objects(settings: DriveSettings) -> list[Entry]:
    """Those of CiA 402, as the first axis of a device has them."""
    ro, rw = Access.RO, Access.RW
    rated = round(settings.rated_torque / settings.rated_torque_unit)
    supported = sum(1 << mode - 1 for mode in mode_numbers(settings) if mode)
    return [
        Entry(0x6007, 0, Type.I16, rw, 1, low=0, high=3),
        Entry(0x603F, 0, Type.U16, ro, mappable=True),
        Entry(0x6040, 0, Type.U16, rw, mappable=True),
        Entry(0x6041, 0, Type.U16, ro, mappable=True),
        Entry(0x605A, 0, Type.I16, rw, 2, low=0, high=7),
        Entry(0x605B, 0, Type.I16, rw, 0, low=0, high=1),
        Entry(0x605C, 0, Type.I16, rw, 1, low=0, high=1),
        Entry(0x605D, 0, Type.I16, rw, 1, low=1, high=4),
        Entry(0x605E, 0, Type.I16, rw, 2, low=0, high=4),
        Entry(0x6060, 0, Type.I8, rw, 0, mappable=True),
        Entry(0x6061, 0, Type.I8, ro, 0, mappable=True),
        Entry(0x6064, 0, Type.I32, ro, mappable=True),
        Entry(0x606C, 0, Type.I32, ro, mappable=True),
        Entry(0x6071, 0, Type.I16, rw, 0, mappable=True),
        Entry(0x6072, 0, Type.U16, rw, 1000, mappable=True, high=5000),
        Entry(0x6073, 0, Type.U16, rw, 5000),  # per mille of the rated current
        Entry(0x6074, 0, Type.I16, ro, mappable=True),
        Entry(0x6075, 0, Type.U32, rw, 5000),  # mA
        Entry(0x6076, 0, Type.U32, rw, rated),
        Entry(0x6077, 0, Type.I16, ro, mappable=True),
        Entry(0x607E, 0, Type.U8, rw, 0),
        Entry(0x6080, 0, Type.U32, rw, 3000),  # rpm of the motor
        Entry(0x6087, 0, Type.U32, rw, 100_000),  # per mille of rated torque per s
        Entry(0x6088, 0, Type.I16, rw, 0, low=0, high=1),
        Entry(0x608F, 0, Type.U8, Access.CONST, 2),
        Entry(0x608F, 1, Type.U32, rw, settings.counts_per_revolution),
        Entry(0x608F, 2, Type.U32, rw, 1),
        Entry(0x6091, 0, Type.U8, Access.CONST, 2),
        Entry(0x6091, 1, Type.U32, rw, 1),
        Entry(0x6091, 2, Type.U32, rw, 1),
        Entry(0x60A9, 0, Type.U32, rw, unit_code(settings)),
        Entry(0x60B0, 0, Type.I32, rw, 0, mappable=True),
        Entry(0x60B1, 0, Type.I32, rw, 0, mappable=True),
        Entry(0x60B2, 0, Type.I16, rw, 0, mappable=True),  # per mille of rated torque
        Entry(0x60C2, 0, Type.U8, Access.CONST, 2),
        Entry(0x60C2, 1, Type.U8, rw, 1, low=1),
        Entry(0x60C2, 2, Type.I8, rw, -3, low=-6, high=0),
        Entry(0x60E0, 0, Type.U16, rw, 5000, mappable=True),  # per mille of rated torque
        Entry(0x60E1, 0, Type.U16, rw, 5000, mappable=True),
        Entry(0x60FD, 0, Type.U32, ro, mappable=True),
        Entry(0x6502, 0, Type.U32, ro, supported),
    ]


def pdos(settings: DriveSettings) -> tuple[list[tuple[int, PdoDefault]], list[tuple[int, PdoDefault]]]:
    """Sent and received, each with its number. Only the first axis has identifiers of the predefined set."""
    place = settings.slot - 1
    offset = place * AXIS_OFFSET

    def default(base: int, number: int, kind: int, mapping: tuple[Key, ...], on: bool = False) -> PdoDefault:
        cob_id = base + number * 0x100 if place == 0 else 0
        return PdoDefault(
            cob_id if on and cob_id else INVALID | cob_id, kind, tuple(shifted(k, offset) for k in mapping)
        )

    fixed = settings.fixed_mapping
    sent = [default(0x180, 0, 255, _MOTION if fixed else ((0x6041, 0),), on=True)]
    sent += [default(0x180, 1, 1, _POSITION if fixed else ())]
    sent += [default(0x180, number, 1, ()) for number in (2, 3)]
    received = [default(0x200, 0, 255, _COMMAND if fixed else ((0x6040, 0),), on=True)]
    received += [PdoDefault(INVALID, 255)] * 3
    first = place * PDO_OFFSET
    return list(enumerate(sent, first)), list(enumerate(received, first))
