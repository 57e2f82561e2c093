"""Read a vendor's EDS file, and compare its entries with the planned writes before anything is written.

EDS files are often broken. `read` corrects errors whose meaning is clear (formats of numbers and headings, repeated
and stray lines) and adds a note for each. canopen parses the result. A section that canopen cannot read is left out,
unless this controller uses its object: then the error names the section.
"""

from __future__ import annotations

import configparser
import io
import logging
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from canopen.objectdictionary import ObjectDictionary, ODVariable
from canopen.objectdictionary.eds import import_eds

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.objects import Type, Write
from tsa_ctrl.errors import UsageError

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
_OPTIONAL = _NUMBERS - {"DataType"}  # a missing value has the default of CiA 306
_SECTION = re.compile(r"^\s*\[([^\]]*)\]\s*$")
_OBJECT = re.compile(r"^(?:0x)?([0-9A-Fa-f]{4})(?:sub(?:0x)?([0-9A-Fa-f]{1,2}))?$", re.IGNORECASE)
_PDO_PARAMETERS = (range(0x1400, 0x1404), range(0x1600, 0x1604), range(0x1800, 0x1804), range(0x1A00, 0x1A04))
_USED = frozenset(
    {entry.index for entry in objects.TABLE} | {index for indices in _PDO_PARAMETERS for index in indices}
)


def read(text: str) -> tuple[configparser.RawConfigParser, list[str]]:
    """Return the corrected sections of an EDS, and a note for each correction."""
    notes: list[str] = []
    lines = _lines(text, notes)
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";",), strict=False)
    parser.optionxform = str  # type: ignore[assignment, method-assign]  # keys are case-sensitive, as canopen requires
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
    """Return only the headings and assignments; add a note for each repeated section and each stray line."""
    kept: list[str] = []
    seen: set[str] = set()
    for number, line in enumerate(text.splitlines(), 1):
        heading = _SECTION.match(line.split(";", 1)[0])
        if heading:
            name = _name(heading[1])
            if name in seen:
                notes.append(f"its EDS has section [{name}] twice; the later values apply")
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
    """Return the normal form of a section name: `[0x1018Sub1]` and `[1018sub1]` are the same object."""
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
            notes.append(f"its EDS has {key} = {value.strip()} in [{section}], which is not a number")
    if _OBJECT.match(section.strip()):
        mended.setdefault("ParameterName", _name(section))
        if "AccessType" not in mended and "DataType" in mended:
            notes.append(f"its EDS has no AccessType in [{_name(section)}]; rw is assumed")
            mended["AccessType"] = "rw"
    return mended


def _number(text: str) -> str | None:
    """Return a number in the form that canopen reads, or None. Accepts leading zeros, // comments and $NODEID."""
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
    """Remove the section of comments, because a wrong count of its lines would make the file unreadable."""
    if parser.has_section("Comments"):
        parser.remove_section("Comments")


_BYTES = {kind.number: kind.size for kind in Type}
_MOST_NOTES = 200  # a file with more errors is probably no EDS file

logging.getLogger("canopen").addHandler(logging.NullHandler())  # its log messages on an EDS are not for the user


def load_eds(path: str | Path) -> ObjectDictionary:
    """Return the dictionary of an EDS file; raise UsageError with the name of the broken section."""
    return read_eds(path)[0]


def read_eds(path: str | Path) -> tuple[ObjectDictionary, list[str]]:
    """Return the dictionary of an EDS file, and notes on its corrections and omissions.

    A section that canopen cannot read is left out if this controller does not use its object.

    Raises:
        UsageError: the file, or a section that this controller uses, cannot be read; the message names it.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: EDS file cannot be read ({error.strerror}); correct eds in the profile") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # the encoding of vendors' editors
    try:
        parser, notes = read(text)
    except configparser.Error as error:
        raise UsageError(f"{path}: EDS file: {_one_line(error)}; repair it, or work without an EDS") from None
    if not any(is_used(section) for section in parser.sections()):
        raise UsageError(
            f"{path}: EDS file describes no object that this controller uses; repair it, or work without one"
        )
    while True:
        dictionary, error_text = _try(parser, parser.sections())
        if dictionary is not None:
            return dictionary, notes
        section = _first_broken(parser)
        if is_used(section) or len(notes) > _MOST_NOTES:
            raise UsageError(f"{path}: EDS file: section [{section}]: {error_text}; repair it, or work without an EDS")
        notes.append(f"section [{section}] of its EDS cannot be read ({error_text}) and is ignored")
        parser.remove_section(section)


def check_plan(dictionary: ObjectDictionary, path: str | Path, plan: Iterable[Write]) -> list[str]:
    """Compare the planned writes with the EDS (type, access, limits) and return notes on tolerated deviations.

    Raises:
        UsageError: a write contradicts the EDS.
    """
    notes: dict[str, None] = {}
    for write in plan:
        entry = write.entry
        variable = _variable(dictionary, entry.index, entry.subindex)
        section = f"[{entry.index:04X}]" if entry.subindex == 0 else f"[{entry.index:04X}sub{entry.subindex:X}]"
        if variable is None:
            if not write.optional:
                notes[f"its EDS lacks {entry}"] = None
            continue
        if variable.data_type != entry.type.number:
            if _BYTES.get(variable.data_type) != entry.type.size:
                raise UsageError(
                    f"{path}: section {section}: DataType is 0x{variable.data_type:04X}, but {entry} has "
                    f"0x{entry.type.number:04X} ({entry.type.name.lower()}); repair the EDS, or work without one"
                )
            notes[f"its EDS gives {entry} another signedness (DataType 0x{variable.data_type:04X})"] = None
        if not variable.writable:
            default = None if entry.type.real else variable.default
            if default is not None and default not in (write.value, *write.fine) and not write.kept:
                raise UsageError(
                    f"{path}: section {section}: {entry} is '{variable.access_type}' with {variable.default}, but must "
                    f"be {write.value}; repair the EDS, or work without one"
                )
            notes[f"its EDS states that {entry} cannot be written"] = None
            continue
        low, high = (None, None) if entry.type.real else (variable.min, variable.max)  # raw bits have no limits
        if low is not None and high is not None and low > high:
            continue  # an empty range is not a limit
        if write.rated is None and not write.kept and not (_above(write.value, low) and _above(high, write.value)):
            allowed = (
                f"{low} to {high}" if None not in (low, high) else f"at most {high}" if low is None else f"from {low}"
            )
            raise UsageError(
                f"{path}: section {section}: {entry} must be {write.value}, but the EDS allows {allowed}; "
                "correct the setting that determines it"
            )
    return list(notes)


def _above(value: int | None, low: int | None) -> bool:
    return value is None or low is None or value >= low


def _variable(dictionary: ObjectDictionary, index: int, subindex: int) -> ODVariable | None:
    found: Any = dictionary.get(index)
    if found is None or isinstance(found, ODVariable):
        return found if subindex == 0 else None
    return found.get(subindex)


def _try(parser: configparser.RawConfigParser, sections: list[str]) -> tuple[ObjectDictionary | None, str]:
    """Parse these sections with canopen; return the dictionary, or None and the error text."""
    part = configparser.RawConfigParser()
    part.optionxform = str  # type: ignore[assignment, method-assign]
    for section in sections:
        part[section] = dict(parser[section])
    text = io.StringIO()
    part.write(text)
    text.seek(0)
    try:
        return import_eds(text, None), ""
    except Exception as error:  # canopen raises exceptions of any type
        return None, _one_line(error)


def _first_broken(parser: configparser.RawConfigParser) -> str:
    """Return the first section that makes the file unreadable, found by bisection."""
    sections = parser.sections()
    good, bad = 0, len(sections)
    while bad - good > 1:
        middle = (good + bad) // 2
        if _try(parser, sections[:middle])[0] is None:
            bad = middle
        else:
            good = middle
    return sections[bad - 1]


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if isinstance(error, (KeyError, ValueError, TypeError)) else text
