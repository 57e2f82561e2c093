"""CiA 301 as bytes: identifiers of the predefined connection set, NMT, SYNC, heartbeat and EMCY.

The table of error codes covers CiA 301 and CiA 402.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
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
COB_ID_INVALID = 0x80000000  # bit 31 of a PDO's COB-ID: the PDO is disabled
PRODUCES_SYNC = 0x40000000  # bit 30 of 0x1005: the node generates SYNC
ALL_NODES = 0


class NmtCommand(IntEnum):
    """NMT command specifiers (CiA 301, 7.2.8.3.1)."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """NMT states in a heartbeat, without bit 7 (the toggle bit of node guarding)."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class Profile(Enum):
    """Device profiles in the low word of the device type (object 0x1000)."""

    DRIVE = 0x0192  # CiA 402
    TRANSDUCER = 0x0194  # CiA 404
    ENCODER = 0x0196  # CiA 406


def nmt(command: NmtCommand, node_id: int = ALL_NODES) -> bytes:
    """Return the data of an NMT frame (identifier 0)."""
    return bytes((command, node_id))


def heartbeat(state: NmtState) -> bytes:
    """Return the data of a heartbeat (identifier 0x700 + node)."""
    return bytes((state,))


TOGGLE = 0x80  # toggle bit: alternates between successive answers to node guarding


def heartbeat_state(data: bytes) -> int | None:
    """Return the NMT state in a heartbeat (`NmtState` if the standard defines it), or None if malformed."""
    return data[0] & 0x7F if len(data) == 1 else None


_EMCY = struct.Struct("<HB5s")

ERROR_CODES: dict[int, str] = {
    0x0000: "error reset or no error",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current on the device's input side",
    0x2110: "short circuit or earth leakage at the input",
    0x2120: "earth leakage at the input",
    0x2130: "short circuit at the input",
    0x2200: "current inside the device",
    0x2211: "over-current inside the device",
    0x2220: "continuous over-current inside the device",
    0x2300: "current on the device's output side",
    0x2310: "continuous over-current at the output",
    0x2320: "short circuit or earth leakage at the output",
    0x2330: "earth leakage at the output",
    0x2340: "short circuit at the output",
    0x2350: "load level fault (I2t, thermal state)",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3200: "voltage inside the device",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x3230: "load error",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4200: "device temperature",
    0x4210: "device temperature too high",
    0x4220: "device temperature too low",
    0x4300: "drive temperature",
    0x4310: "drive temperature too high",
    0x5000: "device hardware",
    0x5100: "supply of the device",
    0x5110: "low voltage supply",
    0x5200: "control electronics",
    0x5300: "operating unit",
    0x5400: "power section",
    0x5441: "safe torque off or external enable missing",
    0x5500: "data storage",
    0x6000: "device software",
    0x6010: "software reset (watchdog)",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data set",
    0x6310: "loss of parameters",
    0x6320: "parameter error",
    0x7000: "additional modules",
    0x7100: "power module",
    0x7110: "brake chopper",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7122: "motor error or wrong commutation",
    0x7200: "measurement circuit",
    0x7300: "sensor",
    0x7303: "resolver 1 fault",
    0x7305: "incremental sensor 1 fault",
    0x7306: "incremental sensor 2 fault",
    0x7310: "speed sensor",
    0x7320: "position sensor",
    0x7400: "computation circuit",
    0x7500: "communication",
    0x8000: "monitoring",
    0x8100: "communication monitoring",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error",
    0x8140: "recovered from bus-off",
    0x8150: "CAN identifier collision",
    0x8200: "protocol error",
    0x8210: "PDO not processed, length error",
    0x8220: "PDO length exceeded",
    0x8230: "destination object not available",
    0x8240: "unexpected SYNC data length",
    0x8250: "RPDO time-out",
    0x8300: "torque control",
    0x8311: "excess torque",
    0x8400: "velocity controller",
    0x8500: "position controller",
    0x8600: "positioning controller",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "SYNC controller",
    0x8800: "winding controller",
    0x8900: "process data monitoring",
    0x8A00: "control deviation",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "device specific",
}

REGISTER_BITS = (  # object 0x1001, and byte 2 of an EMCY
    (0x01, "generic"),
    (0x02, "current"),
    (0x04, "voltage"),
    (0x08, "temperature"),
    (0x10, "communication"),
    (0x20, "device profile"),
    (0x80, "manufacturer"),
)


@dataclass(frozen=True, slots=True)
class Emcy:
    """An emergency message: error code, error register (0x1001) and five vendor bytes."""

    code: int
    register: int
    vendor: bytes

    @property
    def is_reset(self) -> bool:
        """Return True if the node reports an error reset (code 0)."""
        return self.code == 0

    def __str__(self) -> str:
        register = "+".join(name for bit, name in REGISTER_BITS if self.register & bit) or "no"
        return f"EMCY 0x{self.code:04X} ({text(self.code)}; {register} error register; vendor {self.vendor.hex(' ')})"


def decode(data: bytes) -> Emcy | None:
    """Return the emergency in 8 bytes, or None if the length is wrong."""
    return Emcy(*_EMCY.unpack(data)) if len(data) == _EMCY.size else None


def text(code: int) -> str:
    """Return the meaning of an error code by its most specific entry (0x2311, else 0x2310, 0x2300, 0x2000)."""
    for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000):
        found = ERROR_CODES.get(code & mask)
        if found is not None and (code & mask or code == 0):
            return found
    return "error of the generic class" if code else ERROR_CODES[0]
