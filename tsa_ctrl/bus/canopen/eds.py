"""A vendor's EDS file, where there is one: what it says of the objects that we write is compared before they are.

EDS files are often broken. Slips are mended (`eds_mending`), and canopen judges the rest; when it cannot read one, the
section that it stumbles over is named.
"""

from __future__ import annotations

import configparser
import io
import logging
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from canopen.objectdictionary import ObjectDictionary, ODVariable
from canopen.objectdictionary.eds import import_eds

from tsa_ctrl.bus.canopen import eds_mending
from tsa_ctrl.bus.canopen.objects import Type, Write
from tsa_ctrl.errors import UsageError

_BYTES = {kind.number: kind.size for kind in Type}
_MOST_NOTES = 200  # a file with more slips is another kind of file

logging.getLogger("canopen").addHandler(logging.NullHandler())  # its remarks on an EDS are not the user's concern


def load_eds(path: str | Path) -> ObjectDictionary:
    """Read an EDS file; raises UsageError that names the broken section."""
    return read_eds(path)[0]


def read_eds(path: str | Path) -> tuple[ObjectDictionary, list[str]]:
    """An EDS file, and what had to be mended or left out of it; raises UsageError that names the broken section.

    A section is left out when it cannot be read and this controller has no use for its object.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: EDS file cannot be read ({error.strerror}); correct eds in the profile") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # what the vendors' editors write
    try:
        parser, notes = eds_mending.read(text)
    except configparser.Error as error:
        raise UsageError(f"{path}: EDS file: {_one_line(error)}; repair it, or work without an EDS") from None
    if not any(eds_mending.is_used(section) for section in parser.sections()):
        raise UsageError(f"{path}: EDS file: it describes no object that is used here; repair it, or work without one")
    while True:
        dictionary, error_text = _try(parser, parser.sections())
        if dictionary is not None:
            return dictionary, notes
        section = _first_broken(parser)
        if eds_mending.is_used(section) or len(notes) > _MOST_NOTES:
            raise UsageError(f"{path}: EDS file: section [{section}]: {error_text}; repair it, or work without an EDS")
        notes.append(f"its EDS cannot be read in section [{section}] ({error_text}), which is left out")
        parser.remove_section(section)


def check_plan(dictionary: ObjectDictionary, path: str | Path, plan: Iterable[Write]) -> list[str]:
    """Compare what will be written with the EDS: type, access, limits. Raises UsageError, returns what it lacks."""
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
                    f"{path}: section {section}: DataType is 0x{variable.data_type:04X}, {entry} has "
                    f"0x{entry.type.number:04X} ({entry.type.name.lower()}); repair the EDS, or work without one"
                )
            notes[f"its EDS has {entry} with another sign (DataType 0x{variable.data_type:04X})"] = None
        if not variable.writable:
            default = None if entry.type.real else variable.default
            if default is not None and default not in (write.value, *write.fine) and not write.kept:
                raise UsageError(
                    f"{path}: section {section}: {entry} is '{variable.access_type}' with {variable.default}, but must "
                    f"be {write.value}; repair the EDS, or work without one"
                )
            notes[f"its EDS says that {entry} cannot be written"] = None
            continue
        low, high = (None, None) if entry.type.real else (variable.min, variable.max)  # of the bits they mean nothing
        if low is not None and high is not None and low > high:
            continue  # limits of nothing are no limits
        if write.rated is None and not write.kept and not (_above(write.value, low) and _above(high, write.value)):
            raise UsageError(
                f"{path}: section {section}: {entry} shall be {write.value}, allowed is {low} to {high}; "
                "correct the setting it comes from"
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
    """canopen's opinion of an EDS with these sections: the dictionary, or what is wrong."""
    part = configparser.RawConfigParser()
    part.optionxform = str  # type: ignore[assignment, method-assign]
    for section in sections:
        part[section] = dict(parser[section])
    text = io.StringIO()
    part.write(text)
    text.seek(0)
    try:
        return import_eds(text, None), ""
    except Exception as error:  # canopen lets whatever it meets through
        return None, _one_line(error)


def _first_broken(parser: configparser.RawConfigParser) -> str:
    """The section with which the file becomes unreadable, by bisection."""
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
