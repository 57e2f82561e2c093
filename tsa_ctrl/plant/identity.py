"""Define a node's identity and its communication objects (CiA 301, 0x1000 to 0x1029), except for the PDOs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from tsa_ctrl.plant import cia301
from tsa_ctrl.plant.cia301 import Consumers, Guarding
from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, Key, ObjectDictionary, SdoAbort, Type

NonNegative = Annotated[float, Meta(ge=0.0)]
Code = Annotated[int, Meta(ge=0, le=0xFFFF)]
ObjectName = Annotated[str, Meta(pattern=r"^0x[0-9A-Fa-f]{4}(:[0-9]{1,3})?$")]
ModeName = Literal["pp", "pv", "tq", "csp", "csv", "cst"]


class Quirks(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Describe how one drive deviates from CiA 301 and 402; the fields are keys of `[axis.drive]`.

    Each deviation was found on a real stack, and each default follows the standard. `absent`, `objects` and
    `read_only` imitate further deviations.
    """

    # object dictionary
    objects: dict[str, int] = {}  # other values at power-on, for example "0x6072:0" = 500
    absent: list[int | ObjectName] = []  # objects that this drive lacks, for example 0x60A9 or "0x1400:5"
    read_only: list[ObjectName] = []  # objects that cannot be written, for example "0x6007"
    fixed_mapping: bool = False  # true: the PDO mapping is the one that this controller requires, and is read-only
    heartbeat_consumers: Annotated[int, Meta(ge=1, le=8)] = 4  # number of entries of 0x1016
    modes: tuple[ModeName, ...] = ("cst",)  # modes that 0x6502 reports and 0x6060 accepts

    # startup
    boot_time: NonNegative = 0.0  # time from reset or power-on to the boot-up message, s
    starts_itself: bool = False  # true: the drive enters the state operational after the boot-up without a command
    emcy_at_boot: Code = 0  # error code of an EMCY that follows the boot-up message; 0: no EMCY
    answer_time: NonNegative = 0.0  # time from an SDO request to its response, s
    node_id_unset: bool = False  # true: the drive has no node id until LSS assigns one
    sync_producer: bool = False  # true: bit 30 of 0x1005 is set at power-on, and the drive sends a SYNC every 10 ms

    # watchdogs
    watchdogs: bool = True  # false: the drive accepts time-outs and reports when one expires, but keeps its torque
    watches_always: bool = False  # true: with 0x6007 = 1, a lost heartbeat is a fault even if the drive is disabled
    rpdo_timer_on_sync: bool = False  # true: the drive checks the RPDO event timer only at a SYNC
    node_guarding: bool = False  # true: node guarding (0x100C, 0x100D, remote frames) replaces the heartbeat
    guarding_toggles: bool = True  # false: the toggle bit of node guarding is constant

    # commands
    delay_periods: Annotated[int, Meta(ge=0, le=8)] = 0  # delay of a command in addition to the standard's, SYNCs

    # state machine
    mode_shows: Literal["written", "operational", "enabled"] = "written"  # when 0x6061 reports the mode, otherwise 0
    step_time: NonNegative = 0.0  # least time between two transitions towards operation enabled, s
    statusword_bits: Code = 0  # bits of the statusword that are always set, for example the maker's bits 8, 14 and 15
    reports_following: bool = True  # false: bit 12 of the statusword is always 0
    safe_torque_off: bool = False  # true: safe torque off is active; the drive stays in switch on disabled, bit 4 is 0
    warns_when_enabled: Code = 0  # error code of an EMCY without a fault at every enable; 0: no EMCY


SAVE = 0x65766173  # "save", least significant byte first
LOAD = 0x64616F6C  # "load"
_ON_COMMAND = 1  # value of both objects when read; bit 0: parameters are saved on command
_PASSING: frozenset[Key] = frozenset({(0x1003, 0), (0x6040, 0), (0x6071, 0)})  # commands, which are not saved


def entries() -> list[Entry]:
    """Return the entries of 0x1010 and 0x1011, with one group of parameters that is saved on command."""
    return [
        Entry(0x1010, 0, Type.U8, Access.CONST, 1),
        Entry(0x1010, 1, Type.U32, Access.RW, _ON_COMMAND),
        Entry(0x1011, 0, Type.U8, Access.CONST, 1),
        Entry(0x1011, 1, Type.U32, Access.RW, _ON_COMMAND),
    ]


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
    yield from cia301.emcy_entries()
    yield from cia301.sync_entries(quirks.sync_producer)
    yield Entry(0x1008, 0, Type.TEXT, Access.CONST, identity.name)
    yield Entry(0x1009, 0, Type.TEXT, Access.CONST, "simulated")
    yield Entry(0x100A, 0, Type.TEXT, Access.CONST, "1")
    yield from entries()
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
