"""Write a plan to a node: each object is read first, what differs is written, and everything is read back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.cia301 import COB_ID_INVALID
from tsa_ctrl.bus.canopen.objects import Object, Type, Write
from tsa_ctrl.bus.canopen.pdo import PDO_OFFSET, Pdo
from tsa_ctrl.bus.drive.checks import Row
from tsa_ctrl.bus.drive.profile import PER_MILLE
from tsa_ctrl.bus.drive.session import ABSENT, SdoRefusedError, Session
from tsa_ctrl.errors import BusError

_READ_ONLY = frozenset({0x06010000, 0x06010002})  # abort codes
_MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
_COMMUNICATIONS = (range(0x1400, 0x1600), range(0x1800, 0x1A00))
_MAPPING_OFFSET = 0x200

Cure = Callable[[Object, int | None], str]


def write_all(
    session: Session, node_id: int, name: str, plan: Sequence[Write], cure: Cure, notes: list[str] | None = None
) -> list[Row]:
    """Write a plan in order, each object read before and after; one row per object.

    Objects that must be taken out of service to be changed (PDOs, the identifier of emergencies) are not changed if
    all of them are as required: many nodes cannot write them. `cure` is the remedy for an object that is rejected with
    a code, or (None) does not keep its value; `notes` receives the tolerated deviations. Raises BusError.
    """
    rows: dict[tuple[int, int], Row] = {}
    settled = _settled(session, node_id, plan, rows)
    for write in plan:
        if write.entry.index in settled:
            continue
        entry = write.entry
        before: int | None = None
        try:
            before = session.read(node_id, entry)
            wanted = write.value | before & write.kept
            if write.rated is not None:
                wanted = write.value * session.read(node_id, write.rated) // PER_MILLE
            if before != wanted or write.entry.name == objects.MODE.name:
                session.write(node_id, entry, wanted)
            after = session.read(node_id, entry)
        except SdoRefusedError as error:
            if error.code in ABSENT and write.optional:
                rows[entry.key] = Row(entry, None, None)
                continue
            if error.code in _READ_ONLY and before is not None and before in write.fine:
                rows[entry.key] = Row(entry, before, before)
                if notes is not None:
                    notes.append(f"{entry} cannot be written; its {entry.shown(before)} does as well")
                continue
            holds = "" if before is None else f"; it holds {entry.shown(before)}"
            raise BusError(f"{name}: {error}{holds}; {cure(entry, error.code)}") from None
        if after != wanted:
            shown, kept = entry.shown(wanted), entry.shown(after)
            raise BusError(f"{name}: {entry}: wrote {shown}, read back {kept}; {cure(entry, None)}")
        first = rows.get(entry.key)
        rows[entry.key] = Row(entry, before if first is None else first.before, after)
    return list(rows.values())


def _settled(session: Session, node_id: int, plan: Sequence[Write], rows: dict[tuple[int, int], Row]) -> set[int]:
    """Return the indices whose objects all have the planned values, and add a row for each; PDOs by both records."""
    last: dict[tuple[int, int], Write] = {write.entry.key: write for write in plan}
    settled: set[int] = set()
    for index in sorted({key[0] for key in last}):
        if index == objects.EMCY_COB_ID.index or any(index in known for known in (*_MAPPINGS, *_COMMUNICATIONS)):
            found = _as_wanted(session, node_id, [write for key, write in last.items() if key[0] == index])
            if found is not None:
                settled.add(index)
                rows.update({row.entry.key: row for row in found})
    for index in [index for index in settled if any(index in known for known in _COMMUNICATIONS)]:
        mapping = index + _MAPPING_OFFSET
        if mapping in {key[0] for key in last} and mapping not in settled:
            settled.discard(index)  # it must be switched off for its mapping to be changed
    return settled


def _as_wanted(session: Session, node_id: int, writes: Sequence[Write]) -> list[Row] | None:
    """Return rows if each object has its value or an equivalent one, or may be absent; otherwise None."""
    rows = []
    for write in writes:
        try:
            found = session.read_if_there(node_id, write.entry)
        except SdoRefusedError:
            return None
        if found is None and not write.optional:
            return None
        if found is not None and found != write.value | found & write.kept and found not in write.fine:
            return None
        rows.append(Row(write.entry, found, found))
    return rows


def with_consumer(session: Session, node_id: int, plan: Sequence[Write], host: int) -> list[Write]:
    """Return the plan with a suitable entry of 0x1016: one that already has our id, otherwise an unused one."""
    if not any(write.entry.key == objects.HEARTBEAT_CONSUMER.key for write in plan):
        return list(plan)
    count = session.read_if_there(node_id, objects.HEARTBEAT_CONSUMERS) or 1
    entries = [replace(objects.HEARTBEAT_CONSUMER, subindex=number) for number in range(1, count + 1)]
    held = {entry: session.read_if_there(node_id, entry) for entry in entries}
    ours = [entry for entry, value in held.items() if value is not None and value >> 16 & 0x7F == host]
    free = [entry for entry, value in held.items() if not value or not value & 0xFFFF]
    chosen = [*ours, *free, objects.HEARTBEAT_CONSUMER][0]
    return [
        replace(write, entry=chosen) if write.entry.key == objects.HEARTBEAT_CONSUMER.key else write for write in plan
    ]


def further_rpdos(session: Session, node_id: int, slot: int, first: int = 5) -> list[Write]:
    """Return writes that switch off each RPDO of a drive that the plan does not list.

    Another tool may have mapped a target or an offset of the torque into one of them.

    Args:
        session: an open session; nothing is written here.
        node_id: of the drive.
        slot: place of the axis in its device.
        first: number of the first RPDO that the plan does not cover.
    """
    writes = []
    for number in range(first, PDO_OFFSET + 1):
        entry = Pdo(number, True, ()).of(slot).communication(1, Type.U32, "COB-ID")
        found = session.upload_if_there(node_id, entry)
        if found is None:
            break
        if not entry.decode(found) & COB_ID_INVALID:
            writes.append(Write(entry, entry.decode(found) | COB_ID_INVALID))
    return writes
