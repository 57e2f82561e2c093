"""CiA 301: identifiers of the predefined connection set, NMT, SYNC and heartbeat, as bytes."""

from __future__ import annotations

from enum import Enum, IntEnum

NMT = 0x000
SYNC = 0x080
EMCY = 0x080  # + node
TIME = 0x100
TPDO = (0x180, 0x280, 0x380, 0x480)  # + node
RPDO = (0x200, 0x300, 0x400, 0x500)  # + node
SDO_ANSWER = 0x580  # + node, server to client
SDO_REQUEST = 0x600  # + node, client to server
HEARTBEAT = 0x700  # + node
LSS_REQUEST, LSS_ANSWER = 0x7E5, 0x7E4
COB_ID_INVALID = 0x80000000  # bit 31 of a PDO's COB-ID: this PDO does not exist
PRODUCES_SYNC = 0x40000000  # bit 30 of 0x1005: this node makes SYNC
ALL_NODES = 0


class NmtCommand(IntEnum):
    """Command specifier of NMT (CiA 301, 7.2.8.3.1)."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """State byte of a heartbeat (bit 7, the toggle bit of node guarding, removed)."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class Profile(Enum):
    """Device profile in the low word of the device type, object 0x1000."""

    DRIVE = 0x0192  # CiA 402
    TRANSDUCER = 0x0194  # CiA 404
    ENCODER = 0x0196  # CiA 406


def nmt(command: NmtCommand, node_id: int = ALL_NODES) -> bytes:
    """Data of an NMT frame (identifier 0)."""
    return bytes((command, node_id))


def heartbeat(state: NmtState) -> bytes:
    """Data of a heartbeat (identifier 0x700 + node)."""
    return bytes((state,))


TOGGLE = 0x80  # bit of an answer to node guarding, which alternates from answer to answer


def heartbeat_state(data: bytes) -> int | None:
    """The NMT state that a heartbeat reports (`NmtState` where the standard names it); None when malformed."""
    return data[0] & 0x7F if len(data) == 1 else None
