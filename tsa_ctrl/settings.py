"""Read TOML files strictly. An unknown, missing, out-of-range or mistyped key raises an error of one line.

A settings class is a `msgspec.Struct` with `forbid_unknown_fields=True` and with its bounds in `msgspec.Meta`.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import math
import os
import re
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from tsa_ctrl.arguments import path_of
from tsa_ctrl.errors import UsageError

T = TypeVar("T")


MOST_BYTES = 20_000_000  # of a file; a device such as /dev/zero has no end


def read_toml(path: str | Path) -> dict[str, Any]:
    """Parse a TOML file. Raise UsageError with the place of the error, also for a number that is not finite."""
    path = path_of(path, "TOML file", "the path of a TOML file")
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise UsageError(f"{path}: is larger than {MOST_BYTES // 10**6} MB; give the path of a TOML file")
        data = tomllib.loads(content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n"))
        check_finite(data, path)
        return data
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file; give the path of an existing TOML file") from None
    except IsADirectoryError:
        raise UsageError(f"{path}: is a folder; give the path of a TOML file") from None
    except PermissionError:
        raise UsageError(f"{path}: cannot be read; allow reading it (chmod +r)") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); give the path of a TOML file") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: is not UTF-8 text; give a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: not valid TOML: {error}; correct that line") from None
    except ValueError as error:
        raise UsageError(f"{str(path)!r}: is not a path ({error}); give the path of a TOML file") from None
    except RecursionError:
        raise UsageError(f"{path}: tables or lists are nested too deeply; give one of the documented files") from None


def check_finite(data: dict[str, Any], where: str | Path) -> None:
    """Raise UsageError with the key of a number in parsed TOML that is not finite."""
    for place, value in _numbers(data, ""):
        if not math.isfinite(value):
            raise UsageError(f"{where}: {named(place, data)}: found {value}; give a finite number")


MOST_TEXT = 1_000_000  # bytes, longest file that `referenced` returns; a longer file is a table of data


def referenced(path: str | Path) -> dict[str, str]:
    """Return the text of a TOML file and of all files that it names, by their names relative to its folder.

    A string in a TOML file names a file if that file exists, or a drive profile if `drives/STRING.toml` exists. Files
    that are longer than `MOST_TEXT` or not text are left out.
    """
    start = Path(path)
    found: dict[str, str] = {}
    waiting = [start]
    while waiting:
        file = waiting.pop()
        name = os.path.relpath(file, start.parent)
        if name in found:
            continue
        try:
            if file.stat().st_size > MOST_TEXT:
                continue
            found[name] = text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            continue
        if file.suffix == ".toml":
            with contextlib.suppress(tomllib.TOMLDecodeError, RecursionError):
                for word in _strings(tomllib.loads(text)):
                    places = (file.parent / word, file.parent / "drives" / f"{word}.toml")
                    waiting += [place for place in places if _is_file(place)]
    return found


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # not a valid path, or too long
        return False


def _strings(value: object) -> Iterator[str]:
    """Yield every string in a parsed file that may name another file."""
    if isinstance(value, str) and value:
        yield value
    elif isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _strings(inner)


def _numbers(value: object, key: str) -> Iterator[tuple[str, float]]:
    """Yield every float in a parsed file with its place."""
    if isinstance(value, float):
        yield key, value
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _numbers(inner, f"{key}.{name}")
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _numbers(inner, f"{key}[{index}]")


def convert(data: dict[str, Any], kind: type[T], where: str | Path) -> T:
    """Convert parsed TOML to `kind`. Raise UsageError with a wrong key, or with the nearest key to an unknown one."""
    try:
        return msgspec.convert(data, kind, strict=True)
    except msgspec.ValidationError as error:
        check_filled([(where, data, kind)])
        found, wanted = file_kind(data), FILES.get(kind.__name__)
        if found is not None and wanted is not None and found != wanted:
            raise UsageError(f"{where}: this is {found}; {wanted} is required here") from None
        raise UsageError(f"{where}: {explain(str(error), kind, data)}") from None


def check_filled(files: Iterable[tuple[str | Path, dict[str, Any], type]]) -> None:
    """Report all empty values of several files in one message.

    Args:
        files: place, parsed TOML and settings class of each file.

    Raises:
        UsageError: A key has the value "", the placeholder for a value that the user must provide.
    """
    found = [
        (where, [named(place, data) for place in empty])
        for where, data, kind in files
        if (empty := list(_empty(data, kind, "")))
    ]
    if found:
        number = sum(len(keys) for _, keys in found)
        lists = "; ".join(f"{where}: {', '.join(keys)}" for where, keys in found)
        raise UsageError(f"{number} value{'s are' if number > 1 else ' is'} empty; fill in every one. {lists}")


def _empty(value: object, kind: type, place: str) -> Iterator[str]:
    """Yield the keys that have an empty text although their type is not text."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _empty(inner, kind, f"{place}.{name}")
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _empty(inner, kind, f"{place}[{index}]")
    elif value == "" and str not in _parts(_hint(kind, place)):
        yield place


# Names of the project's files by the class that reads each.
FILES = {
    "ControllerFile": "a controller file",
    "PlantSettings": "a plant file",
    "ActuatorFile": "an actuator model",
    "RigidDriveFile": "an actuator model",
    "DriveProfile": "a drive profile",
    "Backup": "a drive's backup",
}


def file_kind(data: dict[str, Any]) -> str | None:
    """Return the kind of a parsed TOML file by the tables that only this kind has, or None if it is unknown."""
    axis = data.get("axis")
    first = axis[0] if isinstance(axis, list) and axis and isinstance(axis[0], dict) else {}
    if data.keys() & {"actuator", "tendon", "sheath", "pretension"}:
        return FILES["ActuatorFile"]
    if "physics" in data or first.keys() & {"actuator", "perturbation", "motor", "joint", "motion"}:
        return FILES["PlantSettings"]
    if data.keys() & {"controller", "realtime"} or first.keys() & {"model", "limits", "setpoint"}:
        return FILES["ControllerFile"]
    if data.keys() & {"reactions", "identity", "units"}:
        return FILES["DriveProfile"]
    return FILES["Backup"] if "object" in data else None


def load(path: str | Path, kind: type[T]) -> T:
    """Read and convert one settings file."""
    return convert(read_toml(path), kind, path)


def explain(message: str, kind: type, data: object = None) -> str:
    """Return a msgspec message in the form `section.key: expected RANGE UNIT, found VALUE UNIT; REMEDY (meaning)`.

    Args:
        message: message of msgspec.
        kind: settings class.
        data: parsed TOML, from which the found value is taken.
    """
    text, _, at = message.partition(" - at ")
    place = at.strip("` ")
    key = named(place, data) or "top level"
    unknown = re.match(r"Object contains unknown field `(.+)`", text)
    if unknown:
        return f"{key}: unknown key '{unknown.group(1)}'; {_advice(unknown.group(1), place, kind)}"
    missing = re.match(r"Object missing required field `(.+)`", text)
    if missing:
        meaning = _meaning(kind, f"{place}.{missing.group(1)}")
        return f"{key}: key '{missing.group(1)}' is missing; add it{_in_brackets(meaning)}"
    wrong = re.fullmatch(r"Expected `(.+?)`(?:, got `(\w+)`| ([<>]=? \S+))", text)
    types, got, bound = (group or "" for group in wrong.groups()) if wrong else ("", "", "")
    value, meaning = _value_at(data, place), _meaning(kind, place)
    choices = [choice for part in _parts(_hint(kind, place)) for choice in _choices(part)]
    if text.startswith("Invalid enum value") or (choices and types in ("str", "int")):
        found = f"{text[:1].lower()}{text[1:]}" if wrong is None else f"invalid value {_shown(value, got)}"
        return f"{key}: {found}; allowed are {', '.join(map(str, choices))}"
    if wrong is None:
        return f"{key}: {text[:1].lower()}{text[1:]}{_in_brackets(meaning)}"
    wanted = " or ".join(TYPES.get(name, name) for name in types.split(" | ") if name != "null")
    if value is None:  # inside a table with keys of its own
        return f"{key}: expected {wanted} {bound or f'but found {TYPES.get(got, got)}'}{_in_brackets(meaning)}"
    if "number" not in wanted:
        return f"{key}: expected {wanted}, found {_shown(value, got)}; write {wanted}{_in_brackets(meaning)}"
    unit, meaning = _split_unit(meaning)
    spaced = f" {unit}" if unit not in ("", "1") else ""
    expected = f"{wanted}{_range(kind, place, bound) or (spaced and ' in')}{spaced}"
    if got:
        found, remedy = _shown(value, got), f"write {wanted}{spaced and ' in'}{spaced}"
    elif bound.startswith(">"):
        found, remedy = f"{value:g}{spaced}", "raise it"
    else:
        mistaken = "" if _description(kind, place) else MISTAKEN.get(unit, "")  # a description includes the mistake
        found, remedy = f"{value:g}{spaced}", f"lower it{mistaken and ', or '}{mistaken}"
    return f"{key}: expected {expected}, found {found}; {remedy}{_in_brackets(meaning)}"


TYPES = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text in quotes",
    "bool": "true or false",
    "object": "a table",
    "array": "a list",
}
# Remedies for a number that is probably in another unit than the one of the key
MISTAKEN = {
    "s": "divide it by 1000 if it is in milliseconds",
    "m": "divide it by 1000 if it is in millimetres",
    "rad": "multiply it by 0.01745 if it is in degrees",
    "rad/s": "multiply it by 0.1047 if it is in rpm, by 0.01745 if it is in degrees per second",
    "N*m": "divide it by 1000 if it is in N*mm",
    "kg*m^2": "multiply it by 1e-7 if it is in g*cm^2",
    "1": "divide it by 100 if it is in per cent",
}
UNIT = re.compile(r"(?!1 (?:or|to) )(?:1|Hz|MB|bit/s|deg C|kg|rad|[sJmN])(?:[*/^](?:Hz|rad|[smK2]))*(?=[ ,;:]|$)")


def _split_unit(meaning: str) -> tuple[str, str]:
    """Return the unit at the start of a description, "" without one, and the rest."""
    unit = UNIT.match(meaning)
    return (unit.group(), re.sub(r"^[ ,;:]+", "", meaning[unit.end() :])) if unit else ("", meaning)


def _in_brackets(meaning: str) -> str:
    return f" ({meaning})" if meaning else ""


def _meaning(kind: type, place: str) -> str:
    """Return unit and meaning of the field at a place, from the description of its range or the shipped file."""
    text = _description(kind, place)
    if text or kind.__name__ not in SHIPPED:
        return text
    name, section = SHIPPED[kind.__name__]
    path = ".".join((*filter(None, [section]), *re.findall(r"\.(\w+)", place)))
    comments = _comments(name)
    # The nodes of an axis share keys, which the file shows once, at the drive.
    return comments.get(path) or comments.get(re.sub(r"^axis\.(encoder|torque_sensor)\.", "axis.drive.", path), "")


# Shipped files whose comments document the keys of a settings class, with the section of that class in the file.
SHIPPED = {
    "ControllerFile": ("controller.toml", ""),
    "BusSettings": ("controller.toml", "bus"),
    "PlantSettings": ("plant.toml", ""),
    "FaultSettings": ("plant.toml", "axis.fault"),
    "ActuatorFile": ("actuator.toml", ""),
    "DriveProfile": ("drives/generic.toml", ""),
}


@functools.cache
def _comments(name: str) -> dict[str, str]:
    """Return the comment of each key of a shipped file up to its first semicolon, by the path of the key."""
    found: dict[str, str] = {}
    section = key = ""
    for line in (Path(__file__).parent / "shipped" / name).read_text(encoding="utf-8").splitlines():
        if header := re.match(r"#?\s*\[+([\w.]+)\]+\s*(?:#|$)", line):
            section, key = f"{header.group(1)}.", ""
        elif entry := re.match(r"#?\s*([\w.]+)\s*=\s.*?\s#\s(.+)", line):
            key = f"{section}{entry.group(1)}"
            found[key] = entry.group(2)
        elif key and (more := re.match(r"#?\s+#\s+(.+)", line)):
            found[key] += f" {more.group(1)}"
        else:
            key = ""
    return {key: comment.split(";")[0] for key, comment in found.items()}


def named(place: str, data: object) -> str:
    """Return a key path such as `$.axis[0].drive` with the names of the tables of its lists: `axis 'knee' drive`.

    An index remains if the table has no name, or if another table of the list has the same one.
    """
    text = separator = ""
    for key, index in re.findall(r"([^.\[\]]+)|\[(\d+|\.\.\.)\]", place.removeprefix("$")):
        if key:
            text, separator = f"{text}{separator}{key}", "."
            data = data.get(key) if isinstance(data, dict) else None
            continue
        listed = data if isinstance(data, list) and index != "..." else []
        names = [table.get("name") if isinstance(table, dict) else None for table in listed]
        name, data = (names[int(index)], listed[int(index)]) if listed else (None, None)
        has_name = isinstance(name, str) and name and names.count(name) == 1
        text, separator = (f"{text} '{name}'", " ") if has_name else (f"{text}[{index}]", ".")
    return text


def _value_at(data: object, place: str) -> object:
    """Return the value at a key path of parsed TOML, or None if it is not there."""
    for name, index in re.findall(r"\.(\w+)|\[(.+?)\]", place):
        try:
            data = data[name] if isinstance(data, dict) and name else data[int(index)]  # type: ignore[index]
        except (KeyError, IndexError, TypeError, ValueError):
            return None
    return data


def _shown(value: object, got: str = "") -> str:
    """Return a value as it is written in a file; of a table or a list only that it is one."""
    if isinstance(value, str):
        return repr(value if len(value) <= MOST_SHOWN else value[:MOST_SHOWN] + "...")
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int | float) else TYPES.get(got, type(value).__name__)


MOST_SHOWN = 40  # characters of a text in a message


def _range(kind: type, place: str, violated: str) -> str:
    """Return the permitted range of the number at a place, or the violated bound if the place has several ranges."""
    metas = [part for part in _parts(_hint(kind, place)) if isinstance(part, msgspec.Meta)]
    bounds = {(part.ge, part.gt, part.le, part.lt) for part in metas} - {(None,) * 4}
    if len(bounds) != 1:
        return f" {violated}" if violated else ""
    ge, gt, le, lt = bounds.pop()
    if ge is not None and le is not None:
        return f" from {ge:.10g} to {le:.10g}"
    words = (("of at least", ge), ("above", gt), ("of at most", le), ("below", lt))
    return " " + " and ".join(f"{word} {bound:.10g}" for word, bound in words if bound is not None)


def _description(kind: object, place: str) -> str:
    """Return the description of the range of the field at a place, or "" if it has none."""
    parts = _parts(_hint(kind, place))
    return next((part.description for part in parts if isinstance(part, msgspec.Meta) and part.description), "")


def _hint(kind: object, place: str) -> object:
    """Return the type of the field at a place of a settings class, or of the last table without known fields."""
    hint = kind
    for name in re.findall(r"\.(\w+)", place):
        struct = next(
            (part for part in _parts(hint) if isinstance(part, type) and issubclass(part, msgspec.Struct)), None
        )
        if struct is None:
            break
        hints = get_type_hints(struct, include_extras=True)
        hint = next((hints[f.name] for f in msgspec.structs.fields(struct) if f.encode_name == name), None)
    return hint


def _choices(hint: object) -> tuple[object, ...]:
    """Return the values of a Literal or an Enum; () of another type hint."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    return tuple(member.value for member in hint) if isinstance(hint, type) and issubclass(hint, Enum) else ()


def _parts(hint: object) -> Iterator[object]:
    """Yield a type hint and all of its parts."""
    yield hint
    for part in (*get_args(hint), *getattr(hint, "__metadata__", ())):
        yield from _parts(part)


def _advice(name: str, place: str, kind: type) -> str:
    """Return the advice for an unknown key at `place`: the nearest known key, or the table to which it belongs."""
    tables = list(tables_of(kind))
    path = tuple(re.findall(r"\.(\w+)", place))
    here = next((table for table in tables if table.path == path), tables[0])
    near = difflib.get_close_matches(name, here.keys, n=1, cutoff=0.5)
    homes = sorted({table.header for table in tables if name in table.keys and table is not here})
    if homes:
        *others, last = homes
        instead = f", or did you mean '{near[0]}'?" if near else ""
        return f"it belongs in {', '.join(others)}{' or ' if others else ''}{last}{instead}"
    if near:
        return f"did you mean '{near[0]}'?"
    for table in tables:
        near = difflib.get_close_matches(name, table.keys, n=1, cutoff=0.6)
        if near:
            return f"did you mean '{near[0]}' of {table.header}?"
    return f"known keys are {', '.join(here.keys)}"


class Table(NamedTuple):
    """A table of a settings class."""

    path: tuple[str, ...]  # keys from the top level to the table
    header: str  # header as written in a file
    keys: list[str]  # permitted keys, sorted


def tables_of(
    kind: object, path: tuple[str, ...] = (), listed: bool = False, above: tuple[object, ...] = ()
) -> Iterator[Table]:
    """Yield every table of a settings class, starting with the top level.

    Args:
        kind: settings class, or a type hint that contains one.
        path: keys from the top level to the table.
        listed: True if the table may occur several times.
        above: settings classes that contain the table.
    """
    if kind in above:
        return
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        fields = msgspec.structs.fields(kind)
        header = f"[{'.'.join(path)}]" if path else "the top level"
        yield Table(path, f"[{header}]" if listed else header, sorted(field.encode_name for field in fields))
        for field in fields:
            if field.encode_name.startswith("["):
                continue  # the other buses, which are written as the first one
            yield from tables_of(field.type, (*path, field.encode_name), False, (*above, kind))
    for argument in get_args(kind):
        yield from tables_of(argument, path, listed or get_origin(kind) in (list, tuple), above)


def write_text(path: str | Path, text: str) -> None:
    """Write a file under another name, sync and rename it, so that a crash leaves either the old or the new file."""
    path = Path(path)
    try:
        mode = path.stat().st_mode & 0o777 if path.exists() else 0o644
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
            Path(name).chmod(mode)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
