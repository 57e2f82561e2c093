"""The end of supervision: a drive that is off no longer watches for us, or it would call our leaving an error."""

from __future__ import annotations

from dataclasses import replace

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.errors import BusError


def release_heartbeat(session: Session, node_id: int, host: int) -> None:
    """Switch off the heartbeat consumer (0x1016) that names `host`, and life guarding (0x100D), and read both back.

    While our heartbeat still goes on; raises BusError when the node does not answer or keeps watching.
    """
    for entry in _armed(session, node_id, host):
        session.write(node_id, entry, 0)
        found = session.read(node_id, entry)
        if found:
            raise BusError(
                f"node {node_id}: {entry} stays {found:#x} although 0 was written; the drive will report "
                "that we are gone: start with --reset-faults next time"
            )


def _armed(session: Session, node_id: int, host: int) -> list[objects.Object]:
    armed = []
    for number in range(1, (session.read_if_there(node_id, objects.HEARTBEAT_CONSUMERS) or 0) + 1):
        entry = replace(objects.HEARTBEAT_CONSUMER, subindex=number)
        value = session.read_if_there(node_id, entry) or 0
        if value >> 16 & 0x7F == host and value & 0xFFFF:
            armed.append(entry)
    if session.read_if_there(node_id, objects.LIFE_TIME_FACTOR):
        armed.append(objects.LIFE_TIME_FACTOR)
    return armed
