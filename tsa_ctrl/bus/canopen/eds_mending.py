"""Slips of vendors' EDS files that do not touch what they mean: numbers, headings, doubled and stray lines.

What is mended is told. What cannot be is left out, unless this controller uses that object.
"""

from __future__ import annotations

import configparser
import re

from tsa_ctrl.bus.canopen import objects

_BIT_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)  # kbit/s
_NUMBERS = frozenset(f"BaudRate_{rate}" for rate in _BIT_RATES) | {
    "VendorNumber",
    "ProductNumber",
    "RevisionNumber",
    "NrOfRXPDO",
    "NrOfTXPDO",
    "Granularity",
    "SimpleBootUpMaster",
    "SimpleBootUpSlave",
    "DynamicChannelsSupported",
    "GroupMessaging",
    "LSS_Supported",
    "CompactPDO",
    "ObjectType",
    "DataType",
    "SubNumber",
    "PDOMapping",
    "LowLimit",
    "HighLimit",
    "SupportedObjects",
    "NrOfEntries",
    "CompactSubObj",
    "ObjFlags",
}
_OPTIONAL = _NUMBERS - {"DataType"}  # a missing one means what the standard says
_SECTION = re.compile(r"^\s*\[([^\]]*)\]\s*$")
_OBJECT = re.compile(r"^(?:0x)?([0-9A-Fa-f]{4})(?:sub(?:0x)?([0-9A-Fa-f]{1,2}))?$", re.IGNORECASE)
_PDO_PARAMETERS = (range(0x1400, 0x1404), range(0x1600, 0x1604), range(0x1800, 0x1804), range(0x1A00, 0x1A04))
_USED = frozenset(
    {entry.index for entry in objects.TABLE} | {index for indices in _PDO_PARAMETERS for index in indices}
)


def read(text: str) -> tuple[configparser.RawConfigParser, list[str]]:
    """The sections of an EDS, mended, and what was."""
    notes: list[str] = []
    lines = _lines(text, notes)
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";",), strict=False)
    parser.optionxform = str  # type: ignore[assignment, method-assign]  # keys are case sensitive, as canopen has them
    parser.read_string("\n".join(lines))
    mended = configparser.RawConfigParser(strict=False)
    mended.optionxform = str  # type: ignore[assignment, method-assign]
    for section in parser.sections():
        mended[_name(section)] = _values(section, dict(parser[section]), notes)
    _comments(mended)
    return mended, notes


def is_used(section: str) -> bool:
    """Return True if this controller reads or writes the object of a section."""
    match = _OBJECT.match(section)
    return match is not None and int(match[1], 16) in _USED


def _lines(text: str, notes: list[str]) -> list[str]:
    """Without lines that are neither section, assignment nor comment; a section that comes twice is told."""
    kept: list[str] = []
    seen: set[str] = set()
    for number, line in enumerate(text.splitlines(), 1):
        heading = _SECTION.match(line.split(";", 1)[0])
        if heading:
            name = _name(heading[1])
            if name in seen:
                notes.append(f"its EDS has section [{name}] twice; the later values count")
            seen.add(name)
            kept.append(f"[{heading[1].strip()}]")
        elif not line.strip() or line.lstrip().startswith((";", "#")):
            continue
        elif "=" in line and seen:
            kept.append(line.strip())
        else:
            notes.append(f"its EDS has a stray line {number}")
    return kept


def _name(section: str) -> str:
    """`[0x1018Sub1]` and `[1018sub1]` are one object."""
    match = _OBJECT.match(section.strip())
    if match is None:
        return section.strip()
    return match[1].upper() + ("" if match[2] is None else f"sub{int(match[2], 16):X}")


def _values(section: str, values: dict[str, str], notes: list[str]) -> dict[str, str]:
    known = {name.lower(): name for name in _NUMBERS}
    mended = {}
    for key, value in values.items():
        name = known.get(key.lower())
        number = None if name is None else _number(value)
        if name is None:
            mended[key] = value.strip()
        elif number is not None:
            mended[name] = number
        elif name not in _OPTIONAL:
            mended[name] = value
        if name is not None and number is None and value.strip():
            notes.append(f"its EDS says {key} = {value.strip()} in [{section}], which is no number")
    if _OBJECT.match(section.strip()):
        mended.setdefault("ParameterName", _name(section))
        if "AccessType" not in mended and "DataType" in mended:
            notes.append(f"its EDS does not say who may write [{_name(section)}]")
            mended["AccessType"] = "rw"
    return mended


def _number(text: str) -> str | None:
    """A number as canopen reads it; None for none. Leading zeros, comments of C and identifiers are forgiven."""
    plain = text.split("//", 1)[0].strip().replace(" ", "")
    if "$NODEID" in plain.upper():
        return plain.upper()
    sign = "-" if plain.startswith("-") else ""
    digits = plain.lstrip("+-")
    if re.fullmatch(r"0[xX][0-9A-Fa-f]+", digits):
        return sign + digits.lower()
    if re.fullmatch(r"[0-9]+", digits):
        return sign + (digits.lstrip("0") or "0")
    if re.fullmatch(r"[0-9]+\.0*", digits):
        return sign + (digits.split(".", 1)[0].lstrip("0") or "0")
    return None


def _comments(parser: configparser.RawConfigParser) -> None:
    """Comments are for people: one that is miscounted is no reason to refuse a file."""
    if parser.has_section("Comments"):
        parser.remove_section("Comments")
