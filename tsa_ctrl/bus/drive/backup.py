"""Back up and restore a drive: read the objects that this master writes, write them back, and compare them.

The file is TOML. It holds the identity of the drive, and one `[[object]]` with type and value per entry.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import tomlkit
import tomlkit.items
from msgspec import Meta

from tsa_ctrl import settings
from tsa_ctrl.bus.canopen import cia402, objects
from tsa_ctrl.bus.canopen.cia301 import COB_ID_INVALID, NmtCommand
from tsa_ctrl.bus.canopen.cia402 import PowerState
from tsa_ctrl.bus.canopen.objects import Object, Type, Write
from tsa_ctrl.bus.canopen.pdo import MAPPING_OFFSET, communication_of
from tsa_ctrl.bus.drive.bring_up import write_all
from tsa_ctrl.bus.drive.checks import Row
from tsa_ctrl.bus.drive.profile import PER_MILLE, ExtraWrite, NumberType
from tsa_ctrl.bus.drive.session import RELEASED, Session
from tsa_ctrl.bus.settings import NodeId, Word
from tsa_ctrl.errors import BusError, UsageError

_MAPPABLE = 8  # maximum number of objects in a PDO, because each takes at least one byte
_COMMANDS = frozenset({objects.CONTROLWORD.key, objects.TARGET_TORQUE.key})


class StoredObject(ExtraWrite, frozen=True, kw_only=True):
    """One object of a backup: its index, type and value."""

    name: str = ""


class Backup(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The identity and the objects of one drive. `unreadable` lists the objects that the drive has and did not send."""

    format: Literal[1] = 1
    node_id: NodeId
    vendor_id: Word
    product_code: Word
    revision: Word = 0
    serial_number: Word = 0
    unreadable: list[str] = []
    object: Annotated[list[StoredObject], Meta(min_length=1)]

    def text(self) -> str:
        """Return the text of the file; integers are hexadecimal unless they are negative."""
        document = tomlkit.document()
        head = "Objects of a drive, as read by `tsa drive dump`; `tsa drive restore` writes them back."
        document.add(tomlkit.comment(head))
        document["format"] = self.format
        document["node_id"] = self.node_id
        for name in ("vendor_id", "product_code", "revision", "serial_number"):
            document[name] = _hexadecimal(getattr(self, name), 8)
        if self.unreadable:
            document["unreadable"] = self.unreadable
        objects = tomlkit.aot()
        for stored in self.object:
            table = tomlkit.table()
            table["index"] = _hexadecimal(stored.index, 4)
            table["subindex"] = stored.subindex
            table["type"] = stored.type
            table["value"] = _hexadecimal(stored.value, 1)
            table["name"] = stored.name
            objects.append(table)
        document["object"] = objects
        return str(tomlkit.dumps(document))


def _hexadecimal(value: float, digits: int) -> tomlkit.items.Integer | float:
    return (
        value
        if value < 0 or not isinstance(value, int)
        else tomlkit.items.Integer(value, tomlkit.items.Trivia(), f"0x{value:0{digits}X}")
    )


@dataclass(frozen=True)
class Difference:
    """An object whose value differs from the required one. `found` is None if the drive lacks the object."""

    entry: Object
    wanted: int
    found: int | None

    def __str__(self) -> str:
        found = "absent" if self.found is None else self.entry.shown(self.found)
        return f"{self.entry}: drive {found}, required {self.entry.shown(self.wanted)}"


def load_backup(path: str | Path) -> Backup:
    """Return the backup in a file; raise UsageError if it is invalid, for instance if a value does not fit its type."""
    backup = settings.load(path, Backup)
    for stored in backup.object:
        try:
            _ = stored.raw
        except ValueError as error:
            raise UsageError(f"{path}: {stored.entry}: value {stored.value} does not fit {error}; correct it") from None
    return backup


def entries_of(plan: Iterable[Write], slot: int = 1) -> list[Object]:
    """Return the objects that a plan writes, all mapping entries of its PDOs, and the objects of the torque path.

    Args:
        plan: writes of one drive.
        slot: place of the axis in its device.
    """
    entries: dict[tuple[int, int], Object] = {}
    for write in plan:
        entries.setdefault(write.entry.key, write.entry)
        index, subindex = write.entry.key
        communication = communication_of(index)
        if communication is not None and communication != index and subindex == 0:
            for number in range(1, _MAPPABLE + 1):
                entry = Object(index, number, Type.U32, f"mapped object {number}")
                entries.setdefault(entry.key, entry)
    for influence in cia402.TORQUE_PATH:
        entry = influence.entry.of(slot)
        entries.setdefault(entry.key, entry)
    return list(entries.values())


def dump(session: Session, node_id: int, entries: Iterable[Object]) -> Backup:
    """Return a backup of these objects and of the identity, without the objects that the drive lacks or refuses."""
    stored = []
    unreadable: list[Object] = []
    mapped: dict[int, int] = {}  # mapping parameter -> number of valid entries; further entries are ignored
    for entry in entries:
        index, subindex = entry.key
        if entry.key in _COMMANDS or subindex > mapped.get(index, subindex):
            continue
        value = session.read_if_readable(node_id, entry, unreadable)
        if communication_of(index) not in (None, index) and subindex == 0:
            mapped[index] = value or 0
        if value is not None:
            type_ = msgspec.convert(entry.type.name.lower(), NumberType)
            number = entry.type.number_of(value)
            stored.append(StoredObject(index=index, subindex=subindex, type=type_, value=number, name=entry.name))
    vendor, product, revision, serial = (
        session.read_if_readable(node_id, entry, unreadable) or 0
        for entry in (objects.VENDOR_ID, objects.PRODUCT_CODE, objects.REVISION, objects.SERIAL_NUMBER)
    )
    return Backup(
        node_id=node_id,
        vendor_id=vendor,
        product_code=product,
        revision=revision,
        serial_number=serial,
        unreadable=[str(entry) for entry in unreadable],
        object=stored,
    )


def restore(session: Session, node_id: int, backup: Backup) -> list[Row]:
    """Write a backup to a disabled drive and read each object back. The drive stays pre-operational.

    Raises:
        UsageError: the backup is of another node. This drive would get its identifiers, and two drives would follow one
            command.
        BusError: the drive is enabled, is another model, or rejects a value.
    """
    name = f"node {node_id}"
    if backup.node_id != node_id:
        raise UsageError(
            f"{name}: the backup is of node {backup.node_id} and contains that node's PDO identifiers; "
            "restore a backup of this node, or give the drive the node id of the backup"
        )
    for entry, wanted in ((objects.VENDOR_ID, backup.vendor_id), (objects.PRODUCT_CODE, backup.product_code)):
        found = session.read_if_there(node_id, entry) or 0
        if found != wanted:
            raise BusError(
                f"{name}: {entry.name} is 0x{found:08X}, the backup is of 0x{wanted:08X}; "
                "a backup fits only the same model: use another file or node"
            )
    state = cia402.decode(session.read(node_id, objects.STATUSWORD))
    if state in (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE):
        raise BusError(f"{name}: the drive is enabled ({state.value}); stop the program that controls it, then restore")
    session.nmt(NmtCommand.PRE_OPERATIONAL, node_id)
    return write_all(session, node_id, name, restore_plan(backup.object), _cure)


def _cure(entry: Object, code: int | None) -> str:
    return (
        "the drive rejects its earlier value: it may be locked or have other firmware; unlock it or correct the backup"
    )


def restore_plan(stored: Sequence[StoredObject]) -> list[Write]:
    """Return the writes of a backup in an order that a drive accepts; PDOs follow the mapping procedure."""
    values = {(item.index, item.subindex): item for item in stored}
    plan = []
    done: set[tuple[int, int]] = set()
    for item in stored:
        if (item.index, item.subindex) in done:
            continue
        communication = communication_of(item.index)
        if communication is None:
            plan.append(Write(item.entry, item.raw))
            continue
        members = [key for key in values if key[0] in (communication, communication + MAPPING_OFFSET)]
        done.update(members)
        plan += _pdo_plan([values[key] for key in members], communication)
    return plan


def wanted_by(
    session: Session, node_id: int, plan: Iterable[Write], unreadable: list[Object]
) -> list[tuple[Object, int]]:
    """Return the value of each object after a plan, without the optional objects that the drive lacks.

    A value that the startup accepts instead, or that a shutdown leaves, counts as the planned one. `unreadable`
    receives the objects that the drive refuses to send.
    """
    wanted: dict[tuple[int, int], tuple[Object, int]] = {}
    for write in plan:
        entry, value = write.entry, write.value
        if write.rated is not None:
            value = value * session.read(node_id, write.rated) // PER_MILLE
        if write.optional or write.kept:
            before = session.read_if_readable(node_id, entry, unreadable)
            if before is None and write.optional:
                continue
            before = before or 0
            accepted = before in write.fine or (before == 0 and entry.index in RELEASED)
            value = before if accepted else value | before & write.kept
        wanted[entry.key] = entry, value
    return [pair for key, pair in wanted.items() if key not in _COMMANDS]


def compare(
    session: Session, node_id: int, wanted: Iterable[tuple[Object, int]], unreadable: list[Object]
) -> list[Difference]:
    """Return the objects whose value at the drive differs from the required value; `unreadable` as in `wanted_by`."""
    differences = []
    for entry, value in wanted:
        found = session.read_if_readable(node_id, entry, unreadable)
        if found != value and entry not in unreadable:
            differences.append(Difference(entry, value, found))
    return differences


def _pdo_plan(members: Sequence[StoredObject], communication: int) -> list[Write]:
    """Return the writes of one PDO in order: disable, clear the mapping, map, count, other parameters, enable."""
    mapping = communication + MAPPING_OFFSET
    cob_id = [item for item in members if (item.index, item.subindex) == (communication, 1)]
    count = [item for item in members if (item.index, item.subindex) == (mapping, 0)]
    used = count[0].raw if count else 0
    entries = [item for item in members if item.index == mapping and 0 < item.subindex <= used]
    others = [item for item in members if item.index == communication and item.subindex > 1]
    return [
        *(Write(item.entry, item.raw | COB_ID_INVALID) for item in cob_id),
        *(Write(item.entry, 0) for item in count),
        *(Write(item.entry, item.raw) for item in entries),
        *(Write(item.entry, item.raw) for item in count),
        *(Write(item.entry, item.raw) for item in others),
        *(Write(item.entry, item.raw) for item in cob_id),
    ]
