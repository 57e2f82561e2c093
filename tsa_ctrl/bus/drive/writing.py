"""Write a plan to a node, reading each object before and after."""

from __future__ import annotations

from collections.abc import Sequence

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.objects import Write
from tsa_ctrl.bus.drive.report import Row
from tsa_ctrl.bus.drive.scale import PER_MILLE
from tsa_ctrl.bus.drive.session import ABSENT, SdoRefusedError, Session
from tsa_ctrl.errors import BusError


def write_all(session: Session, node_id: int, name: str, plan: Sequence[Write]) -> list[Row]:
    """Write a plan in order, each object read before and after; one row per object. Raises BusError."""
    rows: dict[tuple[int, int], Row] = {}
    for write in plan:
        entry = write.entry
        try:
            before = session.read(node_id, entry)
            wanted = write.value | before & write.kept
            if write.rated is not None:
                wanted = write.value * session.read(node_id, write.rated) // PER_MILLE
            if before != wanted or write.entry is objects.MODE:
                session.write(node_id, entry, wanted)
            after = session.read(node_id, entry)
        except SdoRefusedError as error:
            if error.code in ABSENT and write.optional:
                rows[entry.key] = Row(entry, None, None)
                continue
            raise BusError(f"{name}: {error}; the drive's profile does not fit, or the drive is locked") from None
        if after != wanted:
            raise BusError(
                f"{name}: {entry}: wrote {wanted:#x}, read back {after:#x}; "
                "the node does not take this value: check its limits and its profile"
            )
        first = rows.get(entry.key)
        rows[entry.key] = Row(entry, before if first is None else first.before, after)
    return list(rows.values())
