"""A foreign text table to columns of text: encoding, separator, header line and decimal sign as the file shows them."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.foreign import formats

LARGEST = 1 << 30  # bytes of text; a foreign table is held in memory, and ours is not meant to be exhausted by one
SEPARATORS = ";\t,|"  # in the order of trust: a comma may be a decimal sign
LOOKED_AT = 200  # lines from which header and separator are determined
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$")


@dataclass(frozen=True)
class Shape:
    """How to read the text: `separator` is one character or " " for any white space; `header` is from 1, 0: none."""

    encoding: str
    separator: str
    decimal: str
    header: int


NO_TEXT = Shape("", "", "", 0)  # of a file that a library reads


@dataclass(frozen=True)
class ForeignTable:
    """Columns of text as in the file, all of one length; `first` is the line of the first row, counted from 1."""

    path: Path
    shape: Shape
    names: tuple[str, ...]
    cells: dict[str, list[str]]
    first: int
    ignored: int  # lines below the header that have another number of fields (units, a last torn line)
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # columns of a binary file

    def numbers(self, name: str) -> NDArray[np.float64]:
        """One column as doubles, empty cells as nan.

        Raises UsageError with the line of a value that is not a number.
        """
        if name in self.arrays:
            return np.asarray(self.arrays[name], dtype=np.float64)
        decimal = self.shape.decimal
        out = np.empty(len(self.cells[name]))
        for row, cell in enumerate(self.cells[name]):
            text = cell.strip().strip('"')
            if text.lower() in _EMPTY:
                out[row] = math.nan
                continue
            try:
                out[row] = float(text.replace(",", ".") if decimal == "," else text)
            except ValueError:
                raise UsageError(
                    f"{self.path}: column '{name}', line {self.first + row}: '{cell}' is not a number with the decimal "
                    f"sign '{decimal}'; correct it, or give [table] decimal in a mapping file"
                ) from None
        return out

    def times(self, name: str) -> NDArray[np.float64]:
        """A column of dates and times as seconds from the first.

        Raises UsageError with the line of a value that is not one.
        """
        if name in self.arrays:
            stamps = self.arrays[name].astype("datetime64[ns]")
            return np.asarray((stamps - stamps[0]).astype(np.float64) * 1e-9, dtype=np.float64)
        found = []
        for row, cell in enumerate(self.cells[name]):
            try:
                found.append(datetime.fromisoformat(cell.strip().strip('"').replace(",", ".")).timestamp())
            except ValueError:
                raise UsageError(
                    f"{self.path}: column '{name}', line {self.first + row}: '{cell}' is not a date and time as in "
                    "2025-01-31 14:25:01.5; convert it"
                ) from None
        return np.array(found) - (found[0] if found else 0.0)

    def is_date(self, name: str) -> bool:
        """Return True if the column begins with a date and time."""
        if name in self.arrays:
            return bool(self.arrays[name].dtype.kind == "M")
        first = next((cell.strip().strip('"') for cell in self.cells[name] if cell.strip()), "")
        return re.match(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d", first) is not None


_EMPTY = frozenset({"", "nan", "-nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "#nv"})


def read_foreign(path: Path, shape: Shape | None = None) -> ForeignTable:
    """Read a text table as the file itself suggests, or by `shape`. Raises UsageError in one line."""
    suffix = path.suffix.lower()
    if suffix in formats.ARRAYS and (suffix or path.is_dir()):
        arrays = formats.read_with(formats.ARRAYS[suffix], path)
        return ForeignTable(path, NO_TEXT, tuple(arrays), {}, 1, 0, arrays)
    if suffix in formats.TEXTS:
        text, encoding = formats.read_with(formats.TEXTS[suffix], path), "utf-8"
    else:
        text, encoding = _text(path, None if shape is None else shape.encoding)
    lines = _recorded(text.splitlines())
    if not any(line.strip() for line in lines):
        raise UsageError(f"{path}: is empty; give a table with a line of names and rows of numbers")
    told = _told(path, lines, encoding) if shape is None else shape
    rows = _rows(lines[max(0, told.header - 1) :], told.separator)
    if told.header == 0:
        width = Counter(len(row) for row in rows).most_common(1)[0][0]
        rows.insert(0, [f"column {i}" for i in range(1, width + 1)])
    names = _unique([name.strip().strip('"').strip() for name in rows[0]])
    body: list[list[str]] = []
    ignored, first = 0, told.header + 1
    if len(rows) > 1 and _is_units(rows[1], names):
        units = [cell.strip().strip('"[]()') for cell in rows[1]]
        names = tuple(f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True))
    for number, row in enumerate(rows[1:], start=told.header + 1):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(names) or (not body and not any(_is_number(cell) for cell in row)):
            ignored += 1
            continue
        if not body:
            first = number
        body.append(row)
    if not body:
        raise UsageError(f"{path}: no row of {len(names)} fields below line {told.header}; is that the line of names?")
    cells = {name: [row[i] for row in body] for i, name in enumerate(names)}
    return ForeignTable(path, told, names, cells, first, ignored)


def _recorded(lines: list[str]) -> list[str]:
    """Return the table of a recorder of dSPACE ControlDesk as plain text: names, units, rows; other lines as they are.

    Such a file has a section for each raster. The first field of a line is a keyword: `trace_names`, `unit`, or
    `trace_values` for the first row of numbers. It is empty in the rows below. The longest section counts.
    """
    sections: list[list[str]] = []
    for line in lines:
        key = re.match(r'"?(trace_names|units?|trace_values|)"?([;,\t])', line)
        kind = "" if key is None else key.group(1)
        if kind == "trace_names":
            sections.append([])
        if key is not None and sections and (kind or len(sections[-1]) > 1):
            if kind.startswith("unit") and len(sections[-1]) != 1:
                continue
            sections[-1].append(line[key.end() :])
    return max(sections, key=len) if sections else lines


def _text(path: Path, encoding: str | None) -> tuple[str, str]:
    try:
        data = path.read_bytes()
        if path.suffix.lower() == ".gz":
            with gzip.open(io.BytesIO(data)) as stream:
                data = stream.read(LARGEST + 1)
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file; give the path of a text table") from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise UsageError(f"{path}: the compressed file is damaged ({error}); copy it again") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); give the path of a text table") from None
    if len(data) > LARGEST:
        raise UsageError(f"{path}: has more than {LARGEST >> 30} GiB of text; split it")
    if encoding is None:
        encoding = _encoding(data)
    if b"\0" in data[:4096] and not encoding.startswith("utf-16"):
        raise UsageError(f"{path}: is not text; export it as CSV from the program that wrote it")
    try:
        return data.decode(encoding), encoding
    except (UnicodeDecodeError, LookupError):
        raise UsageError(f"{path}: is not {encoding} text; give [table] encoding in a mapping file") from None


def _encoding(data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        data.decode("utf-8-sig")
        return "utf-8-sig"
    except UnicodeDecodeError:
        return "cp1252"  # what western Windows programs write where it is not UTF-8


def _told(path: Path, lines: Sequence[str], encoding: str) -> Shape:
    """Separator, header and decimal sign from the first lines: that with which most lines have equally many fields."""
    some = lines[:LOOKED_AT]
    best: tuple[int, int, str] | None = None  # rows of equal width, width, separator
    for separator in (*SEPARATORS, " "):
        widths = Counter(len(row) for row in _rows(some, separator) if len(row) > 1)
        if widths:
            width, count = max(widths.items(), key=lambda item: (item[1], item[0]))
            if best is None or (count, -len(separator.strip())) > (best[0] * 1.1, 0):
                best = (count, width, separator)
    if best is None:
        raise UsageError(f"{path}: one column only; give a table with at least a time and a torque")
    _, width, separator = best
    rows = _rows(some, separator)
    numeric = next((i for i, row in enumerate(rows) if len(row) == width and _mostly_numbers(row)), None)
    if numeric is None:
        raise UsageError(f"{path}: no row of numbers in the first {len(some)} lines; give a table of numbers")
    named = [i for i in range(numeric) if len(rows[i]) == width and any(re.search("[^\\W\\d]", c) for c in rows[i])]
    header = (named[0] if len(named) < 3 else named[-1]) if named else -1  # a line of units may follow the names
    cells = [cell.strip().strip('"') for row in rows[numeric:] for cell in row]
    commas = sum("," in cell and _is_number(cell) for cell in cells)
    points = sum("." in cell and _is_number(cell) for cell in cells)
    return Shape(encoding, separator, "," if separator != "," and commas > points else ".", header + 1)


def _rows(lines: Sequence[str], separator: str) -> list[list[str]]:
    if separator == " ":
        return [line.split() for line in lines]
    return list(csv.reader(lines, delimiter=separator))


def _is_number(cell: str) -> bool:
    text = cell.strip().strip('"')
    return bool(_NUMBER.match(text)) or bool(re.match(r"\d{4}-\d\d-\d\d[T ]", text))


def _mostly_numbers(row: Sequence[str]) -> bool:
    return sum(_is_number(cell) for cell in row) > len(row) / 2


def _is_units(row: Sequence[str], names: Sequence[str]) -> bool:
    """Return True if the line below the names has units: as many short cells, none of them a number."""
    cells = [cell.strip() for cell in row]
    few = len(cells) == len(names) and any(cells) and all(len(cell) <= 10 for cell in cells)
    return few and not any(_is_number(cell) for cell in cells) and not any("[" in name for name in names)


def _unique(names: Sequence[str]) -> tuple[str, ...]:
    seen: Counter[str] = Counter()
    out = []
    for i, name in enumerate(names, start=1):
        name = name or f"column {i}"
        seen[name] += 1
        out.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return tuple(out)
