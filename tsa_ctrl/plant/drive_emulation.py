"""Define the objects of a simulated CiA 402 drive, its PDOs at power-on, and the deviations of several makers' drives.

Identity, units and deviations come from the makers' public documentation. They are written here independently of the
controller's profiles, so that each can be tested against the other.

epos4      maxon EPOS4 Firmware Specification (rel8234): 0x6076 in uN*m, computed from the nominal current 0x3001:1 and
           read-only; no 0x6072, the output current limit 0x3001:2 (mA) limits the torque instead; 0x60A9 accepts only
           prefixes of rpm, and only while the power stage is off; 0x60C2:2 is -3; 0x605A is 6; no RPDO event
           timer. Vendor 0xFB; product code of an EPOS4 Micro 24/5 from its published device descriptions.
elmo_gold  Elmo DSP 402 Implementation Guide MAN-CAN402IG: 0x6076 in mN*m; velocities in counts/s, no 0x60A9; 0x605E is
           0; 0x6502 is 0x3ED. Vendor 0x9A, product code 0x30924 as reported by its drives.
technosoft_ipos  Technosoft iPOS CANopen Programming User Manual P091.063.iPOS.STO.UM: velocities and torques in
           internal units (2^-16 counts per loop; 65520/2 at the peak current, here twice the rated current); 0x6061
           shows the mode only while enabled. Its EDS iPOS.D.v1.04 (github.com/ros-industrial/ros_canopen,
           canopen_402_driver): vendor 0x1A3; 0x100C and 0x100D, no 0x1016 and no RPDO timer; no 0x603F, 0x6072, 0x6076,
           0x6080, 0x60A9. The current limit 0x207F is 32767 minus the current
           (github.com/roboticslab-uc3m/yarp-devices).
ingenia    The EDS of the EVE-XCR-C 1.8.1 (github.com/ingeniamc/ingenialink-python): vendor 0x29C, product 46342145;
           0x100C, 0x100D and 0x1400:5, no 0x1016; 0x6073 = 40, no 0x6072, 0x603F, 0x6080, 0x60A9, 0x605B, 0x605C,
           0x605E; 0x6502 is 0x301A5, without cyclic synchronous torque.
kinco      Kinco FD5 user manual: velocities in DEC = rpm * 512 * resolution / 1875; the mode is 0 while disabled.
nanotec    Nanotec PD4-E CANopen manual: 0x60C2:2 is -3; the rated current 0x203B:1 defines the rated torque,
           and there is no 0x6076.
copley     Copley CANopen Programmer's Manual 16-01195: velocities in 0.1 counts/s, no 0x60A9.
Elmo's EDS "CANeds Gold V002" (github.com/ipa320/cob_robots): no RPDO event timer, no 0x1007, no 0x1019.
kinco, nanotec and copley use the vendor and product of the settings, because no available document states theirs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field
from typing import Any

from tsa_ctrl.plant.dictionary import Access, Entry, Key, Type
from tsa_ctrl.plant.pdo import INVALID, PdoDefault
from tsa_ctrl.plant.settings import DriveSettings

RPM = 0x00B44700  # 0x60A9: revolutions per minute, prefix 10^0
CURRENT, LIMIT = (0x3001, 1), (0x3001, 2)  # mA: nominal, and maximum output
_NOMINAL = 5000  # mA
_PEAK = 2  # times nominal, at power-on
_RPM_PREFIXES = frozenset(prefix << 24 | RPM for prefix in (0x00, 0xFF, 0xFE, 0xFD))


@dataclass(frozen=True)
class Clamp:
    """Define an object that limits the torque: the value `zero` permits none, `rated` permits the rated torque.

    `rated` may also be the key of an object that holds this value.
    """

    key: Key
    rated: int | Key
    zero: int = 0


@dataclass(frozen=True)
class DriveEmulation:
    """Describe the deviations of one make of drive.

    `settings`: keys of `[axis.drive]` that this make determines. `fixed`: objects that accept only one value or a few.
    `added`: manufacturer-specific objects. `read_only`: objects that cannot be written. `off_only`: objects that can be
    written only while the power stage is off. `clamp`: object that limits the torque instead of 0x6072.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    velocity_digits: float | None = None  # digits of 0x606C per count/s; None: defined by 0x60A9
    torque_digits: float = 1000.0  # digits of 0x6071 and 0x6077 at rated torque
    clamp: Clamp | None = None  # None: 0x6072
    absent: tuple[tuple[int, int | None], ...] = ()  # index and sub-index, None for all
    added: tuple[Entry, ...] = ()
    fixed: Mapping[Key, frozenset[int]] = field(default_factory=dict)
    defaults: Mapping[Key, int] = field(default_factory=dict)
    read_only: frozenset[Key] = frozenset()
    off_only: frozenset[Key] = frozenset()


_NO_TIMER = tuple((0x1400 + number, 5) for number in range(4))
_NO_SYNC_SETTINGS = ((0x1007, None), (0x1019, None))

_EPOS4 = DriveEmulation(
    {"name": "EPOS4", "vendor": 0x000000FB, "product": 0x69500000, "rated_torque_unit": 1e-6},
    clamp=Clamp(LIMIT, CURRENT),
    absent=((0x6072, None), *_NO_TIMER),
    added=(
        Entry(0x3001, 0, Type.U8, Access.CONST, 5),
        Entry(*CURRENT, Type.U32, Access.RW, _NOMINAL),
        Entry(*LIMIT, Type.U32, Access.RW, _PEAK * _NOMINAL),
    ),
    fixed={
        (0x60A9, 0): _RPM_PREFIXES,
        (0x60C2, 2): frozenset({-3}),
        (0x605A, 0): frozenset({6}),
    },
    defaults={(0x60A9, 0): RPM, (0x605A, 0): 6},
    read_only=frozenset({(0x6076, 0)}),
    off_only=frozenset({(0x60A9, 0)}),
)
_ELMO_GOLD = DriveEmulation(
    {"name": "Gold drive", "vendor": 0x0000009A, "product": 0x00030924, "rated_torque_unit": 1e-3},
    velocity_digits=1.0,
    absent=((0x60A9, None), *_NO_TIMER, *_NO_SYNC_SETTINGS),
    fixed={(0x605E, 0): frozenset({0})},
    defaults={(0x605E, 0): 0, (0x6502, 0): 0x3ED},
)

_IPOS = DriveEmulation(
    {"name": "iPOS", "vendor": 0x000001A3, "product": 27014101, "mode_shows": "enabled", "node_guarding": True},
    velocity_digits=65.536,
    torque_digits=16380.0,
    clamp=Clamp((0x207F, 0), 32767 - 16380, 32767),
    absent=(
        *((index, None) for index in (0x1016, 0x1029, 0x603F, 0x6072, 0x6076, 0x6080, 0x60A9)),
        *_NO_TIMER,
        *_NO_SYNC_SETTINGS,
    ),
    added=(Entry(0x207F, 0, Type.U16, Access.RW, 32767 - 2 * 16380),),
)
_KINCO = DriveEmulation(
    {"mode_shows": "enabled"},
    velocity_digits=16.384,
    absent=((0x60A9, None), (0x6076, None)),
)
_NANOTEC = DriveEmulation(
    absent=((0x6076, None),),
    fixed={(0x60C2, 2): frozenset({-3})},
)
_COPLEY = DriveEmulation(
    velocity_digits=10.0,
    absent=((0x60A9, None),),
)
_INGENIA = DriveEmulation(
    {"name": "EVE-XCR-C", "vendor": 0x0000029C, "product": 46342145, "node_guarding": True},
    velocity_digits=1.0,
    clamp=Clamp((0x6073, 0), 1000),
    absent=(
        *((index, None) for index in (0x1006, 0x1016, 0x1029, 0x603F, 0x605B, 0x605C, 0x605E, 0x6072, 0x6080, 0x60A9)),
        *_NO_SYNC_SETTINGS,
    ),
    added=(Entry(0x6073, 0, Type.U16, Access.RW, 40),),
    defaults={(0x6502, 0): 0x301A5, (0x605A, 0): 5, (0x60C2, 2): 0},
)

DRIVE_EMULATIONS: Mapping[str, DriveEmulation] = {
    "generic": DriveEmulation(),
    "epos4": _EPOS4,
    "elmo_gold": _ELMO_GOLD,
    "technosoft_ipos": _IPOS,
    "kinco": _KINCO,
    "nanotec": _NANOTEC,
    "copley": _COPLEY,
    "ingenia": _INGENIA,
}


AXIS_OFFSET = 0x800  # between the objects of two axes of one device (CiA 301, 7.5.1.1)
PDO_OFFSET = 0x40  # between their PDOs
_PROFILE = range(0x6000, 0xA000)
_MODES = {"pp": 1, "pv": 3, "tq": 4, "csp": 8, "csv": 9, "cst": 10}  # values of 0x6060
# The PDO layout that this controller requires, for drives whose mapping cannot be written.
_COMMAND: tuple[Key, ...] = ((0x6040, 0), (0x6071, 0))
_MOTION: tuple[Key, ...] = ((0x6041, 0), (0x6077, 0), (0x606C, 0))
_POSITION: tuple[Key, ...] = ((0x6064, 0), (0x6061, 0), (0x603F, 0))


def mode_numbers(settings: DriveSettings) -> frozenset[int]:
    """Return the values that 0x6060 accepts."""
    return frozenset(_MODES[name] for name in settings.modes) | {0}


def shifted(key: Key, offset: int) -> Key:
    """Return the key that an object of the first axis has on the axis at this offset."""
    return (key[0] + offset, key[1]) if key[0] in _PROFILE else key


class AxisValues(MutableMapping[Key, int]):
    """Give access to the values of a further axis of a node by the keys of the first axis."""

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
    """Return the value of 0x60A9 for 10^exponent revolutions per minute."""
    return (settings.velocity_exponent & 0xFF) << 24 | RPM


def objects(settings: DriveSettings) -> list[Entry]:
    """Return the objects of CiA 402 for the first axis of a device."""
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
    """Return TPDOs and RPDOs with their numbers. Only the first axis has identifiers of the predefined set."""
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
