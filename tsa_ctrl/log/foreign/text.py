"""Read foreign tables: text files and workbooks, and by `binary` the binary files of other programs.

A text table is read as columns of text. Encoding, separator, header line and decimal sign are determined from the file.
"""

from __future__ import annotations

import csv
import gzip
import io
import itertools
import re
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.foreign.binary import ARRAYS, format_of, library, read_with
from tsa_ctrl.log.foreign.cells import (
    Values,
    bare,
    decimal_of,
    is_date,
    is_number,
    is_text,
    measured,
    numbers,
    overrange,
    times,
)
from tsa_ctrl.log.foreign.clocks import TIME
from tsa_ctrl.log.foreign.names import Name, listed
from tsa_ctrl.log.foreign.units import DATE, are_units


def sheet(path: Path) -> tuple[str, str]:
    """Return the first sheet of a workbook with a table of numbers as text, and a note if it is not the first sheet."""
    book = library("python_calamine", path).CalamineWorkbook.from_path(path)
    texts = []
    for name in book.sheet_names:
        rows = book.get_sheet_by_name(name).to_python()
        texts.append(
            "\n".join("\t".join(str(cell).replace("\t", " ").replace("\n", " ") for cell in row) for row in rows)
        )
        try:
            _told(path, texts[-1].splitlines(), "utf-8")
        except UsageError:
            continue
        skipped = book.sheet_names[: len(texts) - 1]
        return texts[-1], f"the table is sheet '{name}'; no table of numbers in {listed(skipped)}" if skipped else ""
    return (texts[0] if texts else ""), ""


def lvm(path: Path) -> tuple[str, str]:
    """Return the text of a LabVIEW file without its headers and its comment column, and an empty note."""
    lines = path.read_text(encoding="cp1252").splitlines()
    heads = [i for i, line in enumerate(lines) if line.startswith("***End_of_Header***")]
    if not heads:
        raise UsageError(f"{path}: has no line ***End_of_Header***; export it from LabVIEW again")
    table = [line.split("\t") for line in lines[heads[-1] + 1 :] if line.strip()]
    width = len(table[0]) - (table[0][-1].strip() == "Comment") if table else 0
    return "\n".join("\t".join(row[:width]) for row in table).replace("X_Value", TIME, 1), ""


TEXTS: dict[str, Callable[[Path], tuple[str, str]]] = {".xlsx": sheet, ".xls": sheet, ".ods": sheet, ".lvm": lvm}


PACKED = (b"PK\x03\x04", b"\xfd7zXZ", b"BZh", b"7z\xbc\xaf", b"\x28\xb5\x2f\xfd")  # first bytes of an archive
LARGEST = 1 << 30  # bytes of text, because a foreign table is read into memory
SEPARATORS = ";\t,|"  # in order of preference: a comma may be a decimal sign
LONGEST_FOOTER = 10  # lines
LOOKED_AT = 200  # lines from which header and separator are determined
csv.field_size_limit(LARGEST)  # `_rows` reports a field that an open quote makes too long


@dataclass(frozen=True)
class Shape:
    """The format of a text table.

    Attributes:
        encoding: text encoding.
        separator: one character, or " " for any white space.
        decimal: decimal sign, "." or ",", or "" if no number of the table determines it.
        header: line of the names, counted from 1; 0 without such a line.
    """

    encoding: str
    separator: str
    decimal: str
    header: int


NO_TEXT = Shape("", "", "", 0)  # for a binary file


@dataclass(frozen=True)
class ForeignTable:
    """The columns of a foreign table, as text of equal length or as arrays."""

    path: Path
    shape: Shape
    names: tuple[str, ...]
    cells: dict[str, list[str]]
    first: int  # line of the first row, counted from 1
    ignored: int  # lines below the header that are not rows (units, a truncated line, a footer)
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # columns of a binary file
    dropped: tuple[str, ...] = ()  # names of columns that have no place in the table: another length or clock
    note: str = ""  # sheet of a workbook
    rate: float | None = None  # Hz, of a table whose time is the row number
    stated: bool = False  # the user has stated the decimal sign
    _values: dict[tuple[str, bool], Values] = field(default_factory=dict, init=False, compare=False, repr=False)

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.cells.values()))) if self.cells else len(next(iter(self.arrays.values()), ()))

    def with_rate(self, rate: float) -> ForeignTable:
        """Return the table with an additional time column, row / `rate` in s, named by `row_clock`."""
        name = row_clock(rate)
        arrays = {**self.arrays, name: np.arange(self.rows) / rate}
        return replace(self, names=(*self.names, name), arrays=arrays, rate=rate)

    def with_stamps(self) -> ForeignTable:
        """Return the table with one time column in s for each pair of columns of seconds and fractions of a second.

        Source: `builtin_interfaces/Time` of ROS 2 (sec, nanosec), `time` of ROS 1 (secs, nsecs), `timeval` (tv_usec).
        """
        table, parts = self, {name: _time_part(name) for name in self.names}
        for fine, (place, scale) in parts.items():
            whole = next((name for name, part in parts.items() if part == (place, 1.0)), None)
            if whole is None or not 0.0 < scale < 1.0:
                continue
            try:
                seconds, fraction = self.numbers(whole), self.numbers(fine)
            except UsageError:
                continue
            good = np.isfinite(seconds) & np.isfinite(fraction)
            if not good.any() or np.any(seconds[good] % 1.0) or np.any((fraction < 0.0) | (fraction * scale >= 1.0)):
                continue  # two times instead of the parts of one
            name = f"time of {whole} and {fine} [s]"
            names = tuple(each for each in table.names if each not in (whole, fine))
            arrays = {**table.arrays, name: seconds - seconds[good][0] + scale * fraction}
            table = replace(table, names=(name, *names), arrays=arrays)
        return table

    def numbers(self, name: str) -> NDArray[np.float64]:
        """Return one column as doubles, with nan for empty cells and markers.

        Raises:
            UsageError: A value is not a number. The message has its line.
        """
        return self._read(name, False)

    def times(self, name: str) -> NDArray[np.float64]:
        """Return a column of dates and times in s since the first one.

        Raises:
            UsageError: A value is not a date and time. The message has its line.
        """
        t = self._read(name, True)
        good = np.flatnonzero(np.isfinite(t))
        return t - (t[good[0]] if good.size else 0.0)

    def _read(self, name: str, dates: bool) -> NDArray[np.float64]:
        if (name, dates) not in self._values:
            self._values[name, dates] = self._binary(name, dates) if name in self.arrays else self._cells(name, dates)
        return self._values[name, dates].values

    def _binary(self, name: str, dates: bool) -> Values:
        array = self.arrays[name]
        if (array.dtype.kind in "Mm") is not dates:
            kind, remedy = ("dates", f"give the unit {DATE}") if not dates else ("numbers", "give another unit")
            raise UsageError(f"{self.path}: column '{name}' has {kind}; {remedy}")
        if not dates:
            return overrange(array.astype(np.float64))
        stamps = array.astype("datetime64[ns]" if array.dtype.kind == "M" else "timedelta64[ns]")
        since = stamps - stamps[~np.isnat(stamps)][:1]  # doubles do not resolve nanoseconds since 1970
        return Values(np.where(np.isnat(since), np.nan, since.astype(np.float64) * 1e-9))

    def _cells(self, name: str, dates: bool) -> Values:
        cells = self.cells[name]
        found = times(cells) if dates else numbers(cells, self.shape.decimal, self.stated)
        if found.wrong is not None and measured(cells[found.wrong])[1]:
            units = [measured(cell)[1] for cell in cells]
            usual = Counter(units).most_common(1)[0][0]
            row = next((i for i, unit in enumerate(units) if unit != usual and is_number(cells[i])), found.wrong)
            raise UsageError(
                f"{self.path}: column '{name}', line {self.first + row}: '{bare(cells[row])}' is not a number in the "
                "unit of all rows and of the name; export the column in one unit"
            )
        if found.wrong is not None:
            remedy = "convert it" if dates else "correct it, or give [table] decimal in a mapping file"
            raise UsageError(f"{self.path}: column '{name}', line {self.first + found.wrong}: {found.reason}; {remedy}")
        return found

    def markers(self, name: str) -> Counter[str]:
        """Return the number of cells for each text that a column has instead of a number; none before it is read."""
        return sum((found.markers for (read, _), found in self._values.items() if read == name), Counter[str]())

    def is_date(self, name: str) -> bool:
        """Return True if the first value of the column is a date and time, or a time of day."""
        if name in self.arrays:
            return bool(self.arrays[name].dtype.kind in "Mm")
        return is_date(next((cell for cell in self.cells[name] if is_number(cell)), ""))


_SECONDS = dict.fromkeys(["s", "sec", "secs", "second", "seconds"], 1.0)
_FRACTIONS = {
    f"{start}{end}": scale
    for scale, starts in ((1e-3, "m milli"), (1e-6, "u micro"), (1e-9, "n nano"))
    for start in starts.split()
    for end in _SECONDS
} | {"nanos": 1e-9, "micros": 1e-6, "millis": 1e-3}


def _time_part(name: str) -> tuple[str, float]:
    """Return the name in front of its last word, and s per unit if this word is a part of a time, otherwise 0."""
    place, word = re.fullmatch(r"(.*?)([^\W\d_]*)\W*", name.lower()).groups()  # type: ignore[union-attr]
    return place.rstrip(" ([{"), (_SECONDS | _FRACTIONS).get(word, 0.0)


def row_clock(rate: float) -> str:
    """Return the name of the time column of a table with a sampling rate in Hz."""
    return f"row / {rate:.12g} Hz"


def read_foreign(path: Path, given: Mapping[str, Any] | None = None) -> ForeignTable:
    """Read a table in the format that its name and content suggest.

    Args:
        path: file to read.
        given: attributes of the `Shape` of a text, which are otherwise determined from the text.

    Raises:
        UsageError: The file cannot be read. The message is one line.
    """
    suffix = format_of(path)
    if suffix in ARRAYS:
        arrays = read_with(ARRAYS[suffix], path)
        return ForeignTable(
            path, NO_TEXT, tuple(arrays.columns), {}, 1, 0, arrays.columns, arrays.dropped
        ).with_stamps()
    note, given = "", given or {}
    if suffix in TEXTS:
        (text, note), encoding = read_with(TEXTS[suffix], path), "utf-8"
    else:
        text, encoding = _text(path, given.get("encoding"))
    lines = _recorded(text.splitlines())
    if not any(line.strip() for line in lines):
        raise UsageError(f"{path}: is empty; give a table with a header line and rows of numbers")
    complete = given.keys() == vars(NO_TEXT).keys()
    told = Shape(**given) if complete else replace(_told(path, lines, encoding), **given)
    above = max(0, told.header - 1)
    rows = _rows(lines[above:], told.separator, path, above)
    if told.header == 0 and _has_row_per_signal(rows):
        rows, note = [list(column) for column in zip(*rows, strict=True)], "the table has a row for each signal"
    named = told.header > 0 or bool(note)
    data = [row for row in rows[named:] if any(is_number(cell) for cell in row)]
    width = Counter(len(row) for row in data).most_common(1)[0][0] if data else len(rows[0])
    open_end = all(not row[-1].strip() for row in data if len(row) == width)
    if not named:
        rows.insert(0, [f"column {i}" for i in range(1, width + 1)])
    elif told.separator == " ":
        rows[0] = _words(lines[above], width)
    header = [name.strip(" \t#%/") if i == 0 else name for i, name in enumerate(rows[0])]
    header = _fitted(header, width, open_end) or header
    titles = _rows(lines[above - 1 : above], told.separator) if above else []
    names = _unique([bare(name) for name in _grouped(header, _fitted(titles[0], width, open_end) if titles else [])])
    if len(rows) > 1:
        rows[1] = _fitted(rows[1], width, open_end) or rows[1]
    body: list[list[str]] = []
    ignored, first = 0, told.header + 1
    below, over = (rows[1] if len(rows) > 1 else []), (_fitted(titles[0], width, open_end) if titles else [])
    units = below if _is_units(below, names) else over if _is_units(over, names) and are_units(_units_in(over)) else []
    if units:
        pairs = zip(names, _units_in(units, empty=True), strict=True)
        names = tuple(f"{name} [{unit}]" if unit else name for name, unit in pairs)
    if units and units is below:
        rows[1], ignored = [], 1
    for number, row in enumerate(rows[1:], start=told.header + 1):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(names) or (not body and not any(is_number(cell) for cell in row)):
            ignored += 1
            continue
        if not body:
            first = number
        body.append(row)
    if not body:
        raise UsageError(f"{path}: no row of {len(names)} fields below line {told.header}; is that the header line?")
    footer = _footer(body)
    del body[len(body) - footer :]
    cells = dict(_without_unit(name, [row[i] for row in body]) for i, name in enumerate(names))
    return ForeignTable(
        path, told, tuple(cells), cells, first, ignored + footer, note=note, stated="decimal" in given
    ).with_stamps()


def _without_unit(name: str, cells: list[str]) -> tuple[str, list[str]]:
    """Return a name with the unit that all numbers of its cells have, and the cells without it, or both unchanged."""
    parts = [measured(cell) for cell in cells]
    units = {unit for cell, (_, unit) in zip(cells, parts, strict=True) if is_number(cell)}
    unit = next(iter(units), "")
    if len(units) != 1 or not unit or Name(name).split[1] not in (None, unit):
        return name, cells
    return name if Name(name).split[1] else f"{name} [{unit}]", [number for number, _ in parts]


def _has_row_per_signal(rows: Sequence[Sequence[str]]) -> bool:
    """Return True if each of a few long rows of equal length has a name and numbers."""
    length = len(rows[0])
    return 2 <= len(rows) < length and all(
        len(row) == length and is_text(row[0]) and all(is_number(cell) for cell in row[1:]) for row in rows
    )


def _footer(body: Sequence[Sequence[str]]) -> int:
    """Return the number of last rows with a text where the first row has its first number: "Mean;0.1;0.2".

    A column that ends with many texts is not a footer. The reader of the column reports the first of them.
    """
    column = next((i for i, cell in enumerate(body[0]) if is_number(cell)), None)
    if column is None:
        return 0
    cells = [row[column] for row in body[: -LONGEST_FOOTER - 2 : -1]]
    texts = [is_text(cell) for cell in cells]
    count = texts.index(False) if False in texts else len(texts)
    return count if count <= LONGEST_FOOTER else 0


def _recorded(lines: list[str]) -> list[str]:
    """Return the longest section of a dSPACE ControlDesk recording as plain lines, and other files unchanged.

    Such a recording has a section with names, units and rows for each raster. The first field of a line is a keyword:
    `trace_names`, `unit`, or `trace_values` for the first row of numbers. It is empty in the rows below.
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
        if data.startswith(b"\x1f\x8b"):
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
    if data.startswith(PACKED):
        raise UsageError(f"{path}: is an archive or a workbook; unpack it, or give a workbook its own ending")
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
    if data[1:2000:2].count(0) > 0.9 * len(data[1:2000:2]) > 0:
        return "utf-16-le"  # without the mark at its start
    if data[0:2000:2].count(0) > 0.9 * len(data[0:2000:2]) > 0:
        return "utf-16-be"
    try:
        data.decode("utf-8-sig")
        return "utf-8-sig"
    except UnicodeDecodeError:
        return "cp1252"  # western Windows programs use it instead of UTF-8


def _told(path: Path, lines: Sequence[str], encoding: str) -> Shape:
    """Determine separator, header and decimal sign from the first lines.

    The separator is the character with which most lines have the same number of fields, and these are numbers.
    """
    some = lines[:LOOKED_AT]
    best: tuple[float, int, str] | None = None  # rows of equal width times share of numbers, width, separator
    for separator in (*SEPARATORS, " "):
        fields = [row for row in _rows(some, separator) if len(row) > 1]
        widths = Counter(len(row) for row in fields)
        if widths:
            width, count = max(widths.items(), key=lambda item: (item[1], item[0]))
            cells = [cell for row in fields if len(row) == width for cell in row if cell.strip()]
            share = sum(map(is_number, cells)) / max(len(cells), 1)
            joined = sum("," in cell or ";" in cell for cell in cells if not is_number(cell))
            if separator == " " and best is not None and joined > count / 2:
                continue  # a space inside fields, such as "0.1 sec,0.5"
            score = count * (0.01 + share)  # a decimal comma also divides lines into equal fields
            if best is None or score > 1.1 * best[0]:
                best = (score, width, separator)
    if best is None:
        _rows(lines, SEPARATORS[0], path)  # an open quote hides the rows below it
        raise UsageError(f"{path}: only one column; give a table with at least a time and a torque")
    _, width, separator = best
    rows = _rows(some, separator, width=width)
    wide = [i for i, row in enumerate(rows) if len(row) == width]
    digits = [_mostly_numbers(rows[i]) for i in wide]  # one row of numbers may come before the names
    followed = (i for i, one, two in zip(wide, digits, [*digits[1:], True], strict=True) if one and two)
    numeric = next(followed, next((i for i, one in zip(wide, digits, strict=True) if one), None))
    if numeric is None:
        _rows(lines, separator, path)
        raise UsageError(f"{path}: no row of numbers in the first {len(some)} lines; give a table of numbers")
    body = [row for row in rows[numeric:] if len(row) == width]
    cells = [cell for row in body for cell in row]
    signs = Counter(decimal_of([cell]) for cell in cells)
    open_end = all(not row[-1].strip() for row in body)
    if separator == "," and numeric and not signs["."] and not signs[","]:
        names = rows[numeric - 1]
        if 1 < len(names) < width - open_end <= 2 * len(names) and not any(is_number(name) for name in names):
            raise UsageError(
                f"{path}: line {numeric + 1} has {width} fields below {len(names)} names: the comma separates the "
                "fields and the decimals; export the table with another separator"
            )
    heads = [(i, _fitted(rows[i], width, open_end)) for i in range(numeric)]
    # A title in a workbook is one cell in a row of empty cells.
    full = {i: row for i, row in heads if sum(bool(cell.strip()) for cell in row) > (width - open_end) / 2}
    named = {i: row for i, row in full.items() if _is_names(row)}
    fits = {i: _identified(_grouped(row, dict(heads).get(i - 1, []))) for i, row in named.items()}
    best_fits = [i for i in named if fits[i] == max(fits.values())]
    header = (best_fits[0] if len(named) < 3 else best_fits[-1]) if best_fits else -1
    decimal = "." if signs["."] > signs[","] else "," if signs[","] else ""
    return Shape(encoding, separator, decimal, header + 1)


def _fitted(row: list[str], width: int, open_end: bool) -> list[str]:
    """Return a row with `width` fields if only an empty field at its end differs, or else []."""
    if len(row) == width + 1 and not row[-1].strip():
        return row[:-1]
    if len(row) == width - 1 and open_end:
        return [*row, ""]
    return row if len(row) == width else []


def _is_names(row: Sequence[str]) -> bool:
    """Return True if a row has texts without numbers and without units only."""
    cells = _units_in(row)
    letters = any(re.search("[^\\W\\d_]", cell) for cell in cells)
    return letters and not any(is_number(cell) for cell in cells) and not are_units(cells)


def _units_in(row: Sequence[str], empty: bool = False) -> list[str]:
    """Return the units in a row without their brackets, with the empty cells if `empty` is True."""
    return [bare(cell).strip("[]()") for cell in row if empty or cell.strip()]


def _identified(names: Sequence[str]) -> int:
    return sum(bool(Name(name).columns) for name in names)


def _grouped(names: list[str], above: list[str]) -> list[str]:
    """Return the names with the titles of groups in the row above, if these identify more columns.

    A title applies to the empty cells on its right, as in a merged cell of a workbook. A name that
    identifies a column needs no title.
    """
    titles = [bare(cell) for cell in above]
    if len(titles) != len(names) or all(titles) or any(is_number(title) for title in titles):
        return names
    for i, title in enumerate(titles[1:], start=1):
        titles[i] = title or titles[i - 1]
    pairs = zip(titles, map(bare, names), strict=True)
    grouped = [name if Name(name).columns else f"{title} {name}".strip() for title, name in pairs]
    return grouped if _identified(grouped) > _identified(names) else names


def _words(line: str, width: int) -> list[str]:
    """Return the fields of a line that are separated by white space.

    A unit in brackets belongs to the name before it, and a comment sign before a name is left out. Single spaces are
    parts of names if only then the line has `width` fields.
    """
    text = re.sub(r"^[#%/]+\s*(?=[^\W\d])", "", line.strip())
    short, wide = re.split(r"[ \t]+(?![\[(])", text), re.split(r" {2,}|\t", text)
    return [] if not text else wide if len(short) != width == len(wide) else short


def _rows(
    lines: Sequence[str], separator: str, path: Path | None = None, above: int = 0, width: int = 0
) -> list[list[str]]:
    """Return the fields of all lines.

    Args:
        lines: lines of the text.
        separator: one character, or " " for any white space.
        path: file, if `lines` end with it.
        above: number of lines above the first one.
        width: number of fields of a line of names, for white space; 0 if it is not known.

    Raises:
        UsageError: A quote is not closed before the end of the file.
    """
    if separator == " ":
        return [_words(line, width) for line in lines]
    rows = list(csv.reader(itertools.chain(lines, [""]), delimiter=separator))
    if rows.pop() and path is not None:  # the empty line at the end became a part of a quoted field
        raise UsageError(f'{path}: line {above + len(rows) + 1}: a quote (") is not closed; close or remove it')
    return rows


def _mostly_numbers(row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell.strip()]  # a row of a Markdown table starts and ends with an empty field
    return len(filled) > 1 and sum(is_number(cell) for cell in filled) > len(filled) / 2


def _is_units(row: Sequence[str], names: Sequence[str]) -> bool:
    """Return True if the line below the names has units: the same number of short cells without a number."""
    if len(row) != len(names) or any("[" in name for name in names):
        return False
    filled = _units_in(row)
    short = all(len(cell) <= 10 and not is_number(cell) for cell in filled)
    letters = any(re.search("[^\\W\\d_]|[°%‰]", cell) for cell in filled)  # none in a ruled line, |---|---|
    return (short and letters) or are_units(filled)


def _unique(names: Sequence[str]) -> tuple[str, ...]:
    seen: Counter[str] = Counter()
    out = []
    for i, name in enumerate(names, start=1):
        name = name or f"column {i}"
        seen[name] += 1
        out.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return tuple(out)
