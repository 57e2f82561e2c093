"""PDO plan as a table of the objects in each PDO. Byte layout, mapping entries and COB-IDs are derived from it."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from enum import IntEnum

from tsa_ctrl.bus.canopen import cia301, objects
from tsa_ctrl.bus.canopen.objects import Object, Type

PDO_OFFSET = 64  # between the PDOs of two axes of one device
MAPPING_OFFSET = 0x200  # from the communication to the mapping parameters of a PDO
_MOST = 0x200  # PDOs in each direction


def communication_of(index: int) -> int | None:
    """Return the index of a PDO's communication parameters for any index of its record; None for other objects."""
    for first in (0x1400, 0x1800):  # RPDO, TPDO
        if first <= index < first + _MOST:
            return index
        if first + MAPPING_OFFSET <= index < first + MAPPING_OFFSET + _MOST:
            return index - MAPPING_OFFSET
    return None


class Transmission(IntEnum):
    """Transmission types of CiA 301, object 0x14xx:2 and 0x18xx:2."""

    EVERY_SYNC = 1
    ON_ARRIVAL = 255


@dataclass(frozen=True)
class Pdo:
    """A PDO and its objects.

    Attributes:
        number: from 1.
        received: True if the node receives it (RPDO), False if the node sends it (TPDO).
        objects: mapped objects in order.
        place: place of its identifier in the predefined connection set, 1 to 4; 0 means `number`.
        every: number of SYNCs from one transmission to the next (transmission type of a TPDO).
    """

    number: int
    received: bool
    objects: tuple[Object, ...]
    place: int = 0
    every: int = 1

    @property
    def name(self) -> str:
        return f"{'R' if self.received else 'T'}PDO{self.number}"

    @property
    def struct(self) -> struct.Struct:
        return struct.Struct("<" + "".join(entry.type.code for entry in self.objects))

    @property
    def length(self) -> int:
        """Return the length in bytes."""
        return self.struct.size

    def cob_id(self, node_id: int) -> int:
        """Return the COB-ID of the predefined connection set."""
        bases = cia301.RPDO if self.received else cia301.TPDO
        return bases[(self.place or self.number) - 1] + node_id

    def of(self, slot: int, place: int = 0) -> Pdo:
        """Return this PDO for another axis: its number is 64 per slot higher (CiA 402-3), `place` its identifier."""
        entries = tuple(entry.of(slot) for entry in self.objects)
        return replace(self, number=self.number + PDO_OFFSET * (slot - 1), objects=entries, place=place or self.place)

    def communication(self, subindex: int, type_: Type, name: str) -> Object:
        """Return an entry of the communication parameters 0x1400.. or 0x1800.."""
        return Object((0x1400 if self.received else 0x1800) + self.number - 1, subindex, type_, f"{self.name} {name}")

    def mapping(self, subindex: int) -> Object:
        """Return an entry of the mapping parameters 0x1600.. or 0x1A00..; subindex 0 is the number of entries."""
        index = (0x1600 if self.received else 0x1A00) + self.number - 1
        if subindex == 0:
            return Object(index, 0, Type.U8, f"{self.name} number of mapped objects")
        return Object(index, subindex, Type.U32, f"{self.name} mapped object {subindex}")


COMMAND = Pdo(1, True, (objects.CONTROLWORD, objects.TARGET_TORQUE))
MOTION = Pdo(1, False, (objects.STATUSWORD, objects.TORQUE_ACTUAL, objects.VELOCITY_ACTUAL))
POSITION = Pdo(2, False, (objects.POSITION_ACTUAL, objects.MODE_DISPLAY, objects.ERROR_CODE))
# The lean layout sends one frame of 8 bytes per SYNC instead of two. The mode and the error code change only with the
# state. Bits 3 and 12 of 0x6041 report a fault or an ignored command on every SYNC.
LEAN_MOTION = Pdo(1, False, (objects.STATUSWORD, objects.TORQUE_ACTUAL, objects.POSITION_ACTUAL))
LEAN_STATE = Pdo(2, False, (objects.MODE_DISPLAY, objects.ERROR_CODE), every=50)
ENCODER = Pdo(1, False, (objects.ENCODER_POSITION,))
TORQUE_SENSOR = Pdo(1, False, (objects.PROCESS_VALUE,))


@dataclass(frozen=True)
class DriveLayout:
    """The three PDOs of one drive, and the node id in their identifiers.

    In a lean layout, `position` carries only the mode and the error code, and `motion` carries the position.
    """

    command: Pdo
    motion: Pdo
    position: Pdo
    node_id: int

    @property
    def rpdo_id(self) -> int:
        return self.command.cob_id(self.node_id)

    @property
    def tpdo_ids(self) -> tuple[int, int]:
        return self.motion.cob_id(self.node_id), self.position.cob_id(self.node_id)

    def without(self, entry: Object) -> DriveLayout:
        """Return this layout with `entry` removed from `position`, because the drive lacks the object."""
        left = tuple(kept for kept in self.position.objects if kept.name != entry.name)
        return replace(self, position=replace(self.position, objects=left))


def drive_layout(node_id: int, slot: int = 1, identifiers_of: int | None = None, lean: bool = False) -> DriveLayout:
    """Return the PDOs of the axis in this slot of a device.

    A node has identifiers for two axes: the second axis uses the identifiers of RPDO 2, TPDO 3 and TPDO 4. Any axis may
    use the identifiers of an unused node id (`identifiers_of`).
    """
    motion, position = (LEAN_MOTION, LEAN_STATE) if lean else (MOTION, POSITION)
    if slot == 2 and identifiers_of is None:
        return DriveLayout(COMMAND.of(2, 2), motion.of(2, 3), position.of(2, 4), node_id)
    first = DriveLayout(COMMAND, motion, position, node_id if identifiers_of is None else identifiers_of)
    if slot == 1:
        return first
    return replace(first, command=COMMAND.of(slot, 1), motion=motion.of(slot, 1), position=position.of(slot, 2))
