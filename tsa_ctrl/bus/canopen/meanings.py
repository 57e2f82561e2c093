"""Explain a number of a CANopen device: an EMCY error code, an SDO abort code, an object or a statusword."""

from __future__ import annotations

import re
from typing import NamedTuple

from tsa_ctrl.bus.canopen import cia301, cia402, objects

_OWN = range(0xFF00, 0x10000)  # error codes that the manufacturer defines
_AREAS = (  # areas of the object dictionary (CiA 301, table 41)
    (range(0x1000, 0x1400), "a communication object"),
    (range(0x1400, 0x1600), "communication parameters of RPDO {pdo}"),
    (range(0x1600, 0x1800), "mapping of RPDO {pdo}"),
    (range(0x1800, 0x1A00), "communication parameters of TPDO {pdo}"),
    (range(0x1A00, 0x1C00), "mapping of TPDO {pdo}"),
    (range(0x2000, 0x6000), "an object of the manufacturer"),
    (range(0x6000, 0xA000), "an object of a device profile"),
)


class Code(NamedTuple):
    """A number of a CANopen device."""

    value: int
    subindex: int | None  # of an object, None if it is not given

    def __str__(self) -> str:
        return f"0x{self.value:0{8 if self.value > 0xFFFF else 4}X}"


def code_in(text: str) -> Code | None:
    """Return the number in a text such as `0x8250`, `6072h`, `0x6040:0`, `EMCY 0x8130` or `06090030`, or None."""
    number = r"(?:(?:0x|\$|#x?)([0-9a-f]{1,8})|([0-9][0-9a-f]{0,7})h|([0-9][0-9a-f]{3}|[0-9][0-9a-f]{7}))"
    found = re.search(rf"(?<![\w.]){number}(?:(?::|\.|sub|/)(?:0x)?(\d{{1,3}}))?(?![\w.])", text.lower())
    if found is None:
        return None
    *forms, subindex = found.groups()
    return Code(int(next(filter(None, forms)), 16), None if subindex is None else int(subindex))


def meanings(code: Code, text: str = "") -> list[str]:
    """Return a line for each meaning of a number.

    Args:
        code: number.
        text: words of the user; "emcy", "abort", "object" or "statusword" excludes the other meanings.

    Returns:
        Lines, none if the number has no known meaning.
    """
    words = text.lower()
    kinds = {
        "EMCY error code": ("emcy", "emergency", "error code", "603f"),
        "SDO abort code": ("abort", "sdo"),
        "object": ("object",),
        "statusword": ("statusword", "status word"),
    }
    asked = {kind for kind, names in kinds.items() if any(name in words for name in names)} or set(kinds)
    found = {
        "SDO abort code": _abort(code),
        "object": _object(code),
        "EMCY error code": _emergency(code),
        "statusword": _statusword(code),
    }
    exact = {kind: lines for kind, (lines, is_exact) in found.items() if lines and is_exact and kind in asked}
    chosen = exact or {kind: lines for kind, (lines, _) in found.items() if lines and kind in asked}
    return [f"{code} as {kind}: {line}" for kind, lines in chosen.items() for line in lines]


# Each of these functions returns its lines, and True if the number is in a table itself, not only in a range.


def _emergency(code: Code) -> tuple[list[str], bool]:
    if code.value > 0xFFFF or code.subindex is not None or 0 < code.value < 0x1000:
        return [], False
    if code.value in _OWN:
        return ["device specific; the manual of the drive has it in its list of error codes"], code.value == _OWN[0]
    exact = code.value in cia301.ERROR_CODES
    group = "" if exact else " (the group; the manual of the drive has the code itself)"
    return [f"{cia301.text(code.value)}{group}"], exact


def _abort(code: Code) -> tuple[list[str], bool]:
    if code.value <= 0xFFFF:
        return [], False
    from canopen.sdo.exceptions import SdoAbortedError  # slow to load

    reason = SdoAbortedError.CODES.get(code.value)
    return ([f"the node rejected an SDO access: {reason}"], True) if reason else ([], False)


def _object(code: Code) -> tuple[list[str], bool]:
    known = [(slot, entry) for slot in range(1, 9) for entry in {each.of(slot) for each in objects.TABLE}]
    lines = {
        entry.subindex: f"{entry}, {entry.type.name}{f', of slot {slot}' if slot > 1 else ''}"
        for slot, entry in reversed(known)
        if entry.index == code.value and code.subindex in (None, entry.subindex)
    }
    if lines:
        return [lines[key] for key in sorted(lines)], True
    for area, name in _AREAS:
        if code.value in area:
            where = name.format(pdo=(code.value & 0x1FF) + 1)
            return [f"{where}, not used by name; tsa drive dump shows its value"], code.subindex is not None
    return [], False


def _statusword(code: Code) -> tuple[list[str], bool]:
    if code.value > 0xFFFF or code.subindex is not None:
        return [], False
    state = cia402.decode(code.value)
    if state is cia402.PowerState.UNKNOWN:
        return [], False
    bits = ", ".join(f"{bit} {name}" for bit, name in _STATUS_BITS.items() if code.value >> bit & 1)
    return [f"state {state.value}{f'; bits set: {bits}' if bits else ''}"], 0 < code.value < 0x1000


_STATUS_BITS = {  # of the statusword in cyclic synchronous torque mode (CiA 402)
    4: "voltage enabled",
    7: "warning",
    9: "remote",
    10: "target reached",
    11: "internal limit active",
    12: "drive follows the command value",
}
