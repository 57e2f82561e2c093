"""Read a vendor's EDS file (CiA 306), and compare its entries with the planned writes before anything is written.

EDS files are often broken. Only the entries of planned writes are interpreted, so an error elsewhere does no harm.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from tsa_ctrl.bus.canopen.objects import Object, Type, Write
from tsa_ctrl.errors import UsageError

_HEADING = re.compile(r"\s*\[\s*(?:0x)?([0-9a-f]{4})(?:sub(?:0x)?([0-9a-f]{1,2}))?\s*\]", re.IGNORECASE)
_BYTES = {kind.number: kind.size for kind in Type}

Section = dict[str, str]  # lower-case key -> value
Sections = Mapping[tuple[int, int], Section]  # (index, subindex) -> section; the heading of a record is its subindex 0


def read_eds(path: str | Path) -> Sections:
    """Return the sections of all objects in an EDS file; raise UsageError if there is none."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: EDS file cannot be read ({error.strerror}); correct eds in the profile") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # the encoding of vendors' editors
    sections: dict[tuple[int, int], Section] = {}
    values: Section = {}
    for line in text.splitlines():
        heading = _HEADING.match(line)
        if heading is not None:
            values = sections.setdefault((int(heading[1], 16), int(heading[2] or "0", 16)), {})
        elif line.lstrip().startswith("["):
            values = {}  # of no object
        else:
            name, _, value = line.partition("=")
            values[name.strip().lower()] = re.split(";|//", value, maxsplit=1)[0].strip()
    if not sections:
        raise UsageError(f"{path}: EDS file describes no object; repair it, or work without one")
    return sections


def check_plan(path: str | Path | None, plan: Iterable[Write]) -> list[str]:
    """Compare the planned writes with the EDS (type, access, limits) and return notes on tolerated deviations.

    Args:
        path: EDS file; None without one, which has nothing to compare.
        plan: writes in order.

    Raises:
        UsageError: the file cannot be read, or a write contradicts it.
    """
    if path is None:
        return []
    sections = read_eds(path)
    notes: dict[str, None] = {}
    for write in plan:
        entry = write.entry
        section = _section(sections, entry)
        if section is None:
            if not write.optional:
                notes[f"its EDS lacks {entry}"] = None
            continue
        where = f"{path}: section [{entry.index:04X}{f'sub{entry.subindex:X}' if entry.subindex else ''}]"
        data_type = _number(section["datatype"], Type.U32)
        if data_type != entry.type.number:
            if _BYTES.get(data_type or 0) != entry.type.size:
                raise UsageError(
                    f"{where}: DataType is {section['datatype']}, but {entry} has "
                    f"0x{entry.type.number:04X} ({entry.type.name.lower()}); repair the EDS, or work without one"
                )
            notes[f"its EDS gives {entry} another signedness (DataType {section['datatype']})"] = None
        low, high, default = (
            None if entry.type.real else _number(section.get(key, ""), entry.type)  # raw bits have no limits
            for key in ("lowlimit", "highlimit", "defaultvalue")
        )
        access = section.get("accesstype", "rw").lower()
        if "w" not in access:
            if default is not None and default not in (write.value, *write.fine) and not write.kept:
                raise UsageError(
                    f"{where}: {entry} is '{access}' with {default}, but must "
                    f"be {write.value}; repair the EDS, or work without one"
                )
            notes[f"its EDS states that {entry} cannot be written"] = None
            continue
        if low is not None and high is not None and low > high:
            continue  # an empty range is not a limit
        if write.rated is None and not write.kept and not (_above(write.value, low) and _above(high, write.value)):
            allowed = (
                f"{low} to {high}" if None not in (low, high) else f"at most {high}" if low is None else f"from {low}"
            )
            raise UsageError(
                f"{where}: {entry} must be {write.value}, but the EDS allows {allowed}; "
                "correct the setting that determines it"
            )
    return list(notes)


def _section(sections: Sections, entry: Object) -> Section | None:
    """Return the section of an object, or None without one. The section of a compact array holds for its entries."""
    found = sections.get(entry.key)
    if found is None and "compactsubobj" in sections.get((entry.index, 0), {}):
        found = sections[entry.index, 0]
    return found if found is not None and "datatype" in found else None


def _number(text: str, type_: Type) -> int | None:
    """Return the number in a value, or None if it is no plain number or depends on the node id."""
    sign, digits = (-1, text[1:]) if text.startswith("-") else (1, text)
    try:
        number = sign * int(digits, 16 if digits[:2].lower() == "0x" else 10)
    except ValueError:
        return None
    return number - (1 << 8 * type_.size) if type_.signed and number > type_.high else number


def _above(value: int | None, low: int | None) -> bool:
    return value is None or low is None or value >= low
