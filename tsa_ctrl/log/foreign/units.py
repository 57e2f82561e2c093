"""Units of foreign columns, and the unit that a foreign name states."""

from __future__ import annotations

import math
import re

DATE = "date"  # the unit of a column of dates and times

# SI per unit, by the unit of our column. Units that depend on the device (A, %, counts) are missing and need `scale`.
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, DATE: 1.0},
    "N*m": {
        "N*m": 1.0, "Nm": 1.0, "N·m": 1.0, "N m": 1.0, "N.m": 1.0, "mNm": 1e-3, "mN*m": 1e-3, "mN·m": 1e-3,
        "Ncm": 1e-2, "N*cm": 1e-2, "Nmm": 1e-3, "N*mm": 1e-3, "kNm": 1e3, "kgcm": 9.80665e-2, "ozin": 7.0615518e-3,
        "lbin": 0.1129848, "lbft": 1.3558179,
    },
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180, "grad": math.pi / 180,
            "rev": 2 * math.pi, "turn": 2 * math.pi, "U": 2 * math.pi},
    "rad/s": {
        "rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.pi / 180, "°/s": math.pi / 180, "dps": math.pi / 180,
        "rpm": math.pi / 30, "1/min": math.pi / 30, "U/min": math.pi / 30, "min^-1": math.pi / 30,
        "rev/s": 2 * math.pi, "Hz": 2 * math.pi, "mrpm": math.pi / 30e3,
    },
    "rad/s^2": {"rad/s^2": 1.0, "rad/s²": 1.0, "deg/s^2": math.pi / 180, "°/s²": math.pi / 180},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665, "lbf": 4.4482216},
    "degC": {"degC": 1.0, "°C": 1.0, "C": 1.0, "K": 1.0, "°F": 5 / 9, "degF": 5 / 9, "F": 5 / 9},
}  # fmt: skip
SHIFT = {"K": -273.15, "°F": -160 / 9, "degF": -160 / 9, "F": -160 / 9}  # degC, added after the scale
LEVER_ARM = {"N", "N*m"}  # units of quantities between which a lever arm or a pulley radius converts, as scale
DEVICE_UNITS = {"a": "N*m per A", "ma": "N*m per mA", "%": "SI per %", "permille": "SI per mille",
                "‰": "SI per mille", "counts": "rad per count", "cnt": "rad per count", "inc": "rad per increment",
                "v": "SI per V", "mv": "SI per mV", "digits": "SI per digit"}  # fmt: skip


def quantities_of(unit: str) -> frozenset[str]:
    """Return the SI units of the quantities that `unit` can measure; empty for a device unit or an unknown unit."""
    return frozenset(si for si, known in UNITS.items() if unit in known)


def is_known(unit: str) -> bool:
    """Return True if `unit` converts to SI, or converts with a scale that depends on the device."""
    return bool(quantities_of(unit)) or unit.lower() in DEVICE_UNITS


def needs_scale(unit: str, si: str) -> bool:
    """Return True if a scale of the device is required to convert `unit` to the SI unit `si`."""
    return unit not in UNITS.get(si, {})


_BRACKETS = re.compile(r"[\[(<{]\s*([^\[\](){}<>]+?)\s*[\])>}]")
_TAIL = re.compile(r"[ _/]([^ _]+)$")


def brackets_in(source: str) -> list[tuple[str, tuple[int, int]]]:
    """Return the content and the position of each pair of brackets in a name, except numbers such as "(2)"."""
    return [(found[1], found.span()) for found in _BRACKETS.finditer(source) if not found[1].isdigit()]


def tail_of(source: str) -> tuple[str, str] | None:
    """Return a name without the known unit after its last space, slash or underscore, and the unit, or None."""
    found = _TAIL.search(source.strip())
    if found is None or not is_known(found[1]):
        return None
    return source.strip()[: found.start()], found[1]
