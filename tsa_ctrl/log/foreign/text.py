"""Read foreign tables: text files, and the binary files of other programs.

A text table is read as columns of text. Encoding, separator, header line and decimal sign are determined from the file.
Each binary format has one function, which returns named columns. It uses the common library of the format. The extra
`formats` of pyproject.toml installs these libraries.
"""

from __future__ import annotations

import csv
import gzip
import importlib
import io
import itertools
import json
import math
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.foreign.clocks import TIME, Arrays, Columns, columns, on_one_clock, outside
from tsa_ctrl.log.foreign.names import listed
from tsa_ctrl.system.process_supervisor import worker_context

# Keys of a list of names next to lists of values: dSPACE (Name, Data), Simulink (label, values), JointState of ROS
# (name, ...).
LABELS = ("Name", "label", "name")


def library(name: str, path: Path) -> Any:
    """Import the library of a format. Raise UsageError with the remedy if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.split(".")[0]
        raise UsageError(f"{path}: reading this format needs the package {package}; pip install '.[formats]'") from None


def flat(value: Any, name: str = "", group: str = "") -> Iterator[tuple[str, Any, str]]:
    """Yield the numbers and arrays inside nested mappings, lists and messages.

    Args:
        value: mapping, list, message or number.
        name: name of `value`, whose parts are joined by dots.
        group: name of the mapping that contains `value`.

    Yields:
        Name, value and group of each number or array.
    """
    if not isinstance(value, Mapping) and (fields := getattr(value, "__dict__", None) or _slots(value)):
        value = fields
    if isinstance(value, Mapping):
        texts = next(([str(label) for label in value[key]] for key in LABELS if _is_texts(value.get(key))), [])
        for key, inner in value.items():
            whole = f"{name}.{key}" if name else str(key)
            if texts and not isinstance(inner, str) and np.ndim(inner) <= 2 and _length(inner) == len(texts):
                for label, element in zip(texts, inner, strict=True):
                    yield from flat(element, label if key in ("Data", "values") else f"{whole}.{label}", name)
            elif not str(key).startswith("__"):
                yield from flat(inner, whole, name)
    elif isinstance(value, list) and any(isinstance(element, (dict, list, np.ndarray)) for element in value):
        for i, element in enumerate(value, start=1):
            yield from flat(element, f"{name}.{i}", group)
    elif np.asarray(value).dtype.kind in "fiubM":
        yield name, np.asarray(value), group


def _slots(value: Any) -> dict[str, Any]:
    return {key: getattr(value, key) for key in getattr(value, "__slots__", ()) if not key.startswith("_")}


def _is_texts(value: Any) -> bool:
    return isinstance(value, (list, np.ndarray)) and len(value) > 0 and all(isinstance(text, str) for text in value)


def _length(value: Any) -> int:
    return len(value) if isinstance(value, (list, np.ndarray)) else -1


def mat(path: Path) -> Arrays:
    """Read MATLAB v5 and v7.3, including the structures that Simulink and dSPACE write."""
    return columns(flat(library("pymatreader", path).read_mat(path)), path)


def numpy_file(path: Path) -> Arrays:
    """Read NumPy's .npy and .npz. Reject pickled objects, which could run code."""
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        return columns(iter([("", found, "")]), path)
    return columns(((name, values, name.rpartition("/")[0]) for name, values in found.items()), path)


def hdf5(path: Path) -> Arrays:
    """Read HDF5: each data set by its path. An attribute `unit` or `units` becomes part of the name."""
    h5py, found = library("h5py", path), []
    with h5py.File(path) as file:

        def visit(name: str, node: Any) -> None:
            if isinstance(node, h5py.Dataset) and (node.dtype.kind in "fiub" or node.dtype.names):
                unit = node.attrs.get("unit", node.attrs.get("units"))
                named = f"{name} [{unit}]" if unit is not None else name
                found.append((named, node[()], name.rpartition("/")[0]))

        file.visititems(visit)
    return columns(iter(found), path)


def tdms(path: Path) -> Arrays:
    """Read LabVIEW TDMS: each channel, with the time of its waveform if it has one."""
    tables: dict[str, tuple[NDArray[np.float64], Columns]] = {}
    plain: list[tuple[str, Any, str]] = []
    used: set[str] = set()
    for group in library("nptdms", path).TdmsFile.read(path).groups():
        for channel in group.channels():
            if channel.data.dtype.kind not in "fiubM":
                continue
            unit = channel.properties.get("unit_string")
            name = f"{channel.name} [{unit}]" if unit else channel.name
            name = f"{group.name}/{name}" if name in used else name
            used.add(name)
            if "wf_increment" in channel.properties:
                tables[f"{group.name}/{name}"] = (channel.time_track(), {name: channel.data})
            else:
                plain.append((name, channel.data, group.name))
    if not tables:
        return columns(iter(plain), path)
    merged = on_one_clock(tables)
    dropped = tuple(name for name, _, _ in plain)
    return Arrays(merged, dropped + outside({key: table for key, (_, table) in tables.items()}, merged))


def parquet(path: Path) -> Arrays:
    """Read Parquet of any program with DuckDB."""
    import duckdb

    found = duckdb.execute("SELECT * FROM read_parquet(?)", [str(path)]).fetchnumpy()
    return columns(
        ((name, np.ma.filled(c.astype(float), np.nan), "") for name, c in found.items() if c.dtype.kind in "fiub"), path
    )


def ros(path: Path) -> Arrays:
    """Read a bag of ROS 1 (.bag) or ROS 2 (a folder, or its .db3): the numbers of each topic by their record time."""
    rosbags, stores = library("rosbags.highlevel", path), library("rosbags.typesys", path)
    bag = path if path.is_dir() or path.suffix == ".bag" else path.parent
    with rosbags.AnyReader([bag], default_typestore=stores.get_typestore(stores.Stores.ROS2_HUMBLE)) as reader:
        found = ((c.topic, stamp, reader.deserialize(raw, c.msgtype)) for c, stamp, raw in reader.messages())
        return _messages(found, path)


def mcap(path: Path) -> Arrays:
    """Read MCAP of other programs with messages in JSON or of ROS 2."""
    reading, decoding = library("mcap.reader", path), library("mcap_ros2.decoder", path)

    def messages() -> Iterator[tuple[str, int, Any]]:
        with path.open("rb") as stream:
            factory = decoding.DecoderFactory()
            for schema, channel, message in reading.make_reader(stream).iter_messages():
                if channel.message_encoding == "json":
                    yield channel.topic, message.log_time, json.loads(message.data)
                elif (decoder := factory.decoder_for(channel.message_encoding, schema)) is not None:
                    yield channel.topic, message.log_time, decoder(message.data)

    return _messages(messages(), path)


def _messages(found: Iterator[tuple[str, int, Any]], path: Path) -> Arrays:
    """Collect the scalars of messages (topic, ns, message), with a separate clock for each topic."""
    rows: dict[str, tuple[list[int], dict[str, list[Any]]]] = {}
    for topic, stamp, message in found:
        stamps, numbers = rows.setdefault(topic, ([], {}))
        stamps.append(stamp)
        for name, value, _ in flat(message, topic.strip("/")):
            flat_value = np.ravel(value)
            if flat_value.size == 1 and ".header." not in name:
                numbers.setdefault(name, [np.nan] * (len(stamps) - 1)).append(float(flat_value[0]))
        for values in numbers.values():
            values += [np.nan] * (len(stamps) - len(values))
    if not any(numbers for _, numbers in rows.values()):
        raise UsageError(f"{path}: no topic contains numbers; give a recording with at least a torque")
    first = min(stamps[0] for stamps, _ in rows.values())
    tables = {
        topic: ((np.array(stamps) - first) * 1e-9, {name: np.array(values) for name, values in numbers.items()})
        for topic, (stamps, numbers) in rows.items()
    }
    merged = on_one_clock(tables)
    return Arrays(merged, outside({topic: table for topic, (_, table) in tables.items()}, merged))


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


ARRAYS: dict[str, Callable[[Path], Arrays]] = {
    ".mat": mat, ".npy": numpy_file, ".npz": numpy_file, ".h5": hdf5, ".hdf5": hdf5, ".tdms": tdms,
    ".parquet": parquet, ".bag": ros, ".db3": ros, "": ros, ".mcap": mcap,
}  # fmt: skip
TEXTS: dict[str, Callable[[Path], tuple[str, str]]] = {".xlsx": sheet, ".xls": sheet, ".ods": sheet, ".lvm": lvm}


def in_child(reader: Callable[[Path], Any], path: Path) -> Any:
    """Call a reader in a child process, because the C code of its library may crash on a damaged file.

    Raises:
        UsageError: The reader crashed.
    """
    from concurrent.futures import ProcessPoolExecutor  # imported here, because most tables are text
    from concurrent.futures.process import BrokenProcessPool

    with ProcessPoolExecutor(1, mp_context=worker_context(__name__)) as pool:
        try:
            return pool.submit(reader, path).result()
        except BrokenProcessPool:
            raise UsageError(f"{path}: is damaged: its reader crashed; export it again") from None


def read_with(reader: Callable[[Path], Any], path: Path) -> Any:
    """Call a reader. Raise UsageError with a message of one line if its library cannot read the file."""
    if not path.exists():
        raise UsageError(f"{path}: no such file; give the path of a table")
    try:
        return in_child(reader, path) if reader is mat else reader(path)
    except UsageError:
        raise
    except Exception as error:  # each library raises its own errors, but a damaged file must not cause a traceback
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UsageError(
            f"{path}: is damaged or not a {path.suffix or 'ROS 2'} file ({reason}); export it again"
        ) from None


LARGEST = 1 << 30  # bytes of text, because a foreign table is read into memory
SEPARATORS = ";\t,|"  # in order of preference: a comma may be a decimal sign
LONGEST_FOOTER = 10  # lines
LOOKED_AT = 200  # lines from which header and separator are determined
csv.field_size_limit(LARGEST)  # `_rows` reports a field that an open quote makes too long
_DATES = (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d", r"\d{1,2}\.\d{1,2}\.\d{4} +\d{1,2}:\d\d(:\d\d([.,]\d+)?)?$")
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)$")  # time of day
_DAY = 86400.0  # s
_DATE = re.compile("|".join((*_DATES, _CLOCK.pattern)))
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$")


@dataclass(frozen=True)
class Shape:
    """The format of a text table.

    Attributes:
        encoding: text encoding.
        separator: one character, or " " for any white space.
        decimal: decimal sign, "." or ",".
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

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.cells.values()))) if self.cells else len(next(iter(self.arrays.values()), ()))

    def with_rate(self, rate: float) -> ForeignTable:
        """Return the table with an additional time column, row / `rate` in s, named by `row_clock`."""
        name = row_clock(rate)
        arrays = {**self.arrays, name: np.arange(self.rows) / rate}
        return replace(self, names=(*self.names, name), arrays=arrays, rate=rate)

    def numbers(self, name: str) -> NDArray[np.float64]:
        """Return one column as doubles, with nan for empty cells.

        Raises:
            UsageError: A value is not a number. The message has its line.
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
        """Return a column of dates and times in s since the first one.

        Raises:
            UsageError: A value is not a date and time. The message has its line.
        """
        if name in self.arrays:
            stamps = self.arrays[name].astype("datetime64[ns]")
            return np.asarray((stamps - stamps[0]).astype(np.float64) * 1e-9, dtype=np.float64)
        found = []
        for row, cell in enumerate(self.cells[name]):
            text = cell.strip().strip('"').replace(",", ".")
            try:
                found.append(math.nan if text.lower() in _EMPTY else _stamp(text))
            except ValueError:
                raise UsageError(
                    f"{self.path}: column '{name}', line {self.first + row}: '{cell}' is not a date and time like "
                    "2025-01-31 14:25:01.5, 31.01.2025 14:25:01.5 or 14:25:01.5; convert it"
                ) from None
        t = np.array(found)
        good = np.flatnonzero(np.isfinite(t))
        if good.size and all(_CLOCK.match(self.cells[name][i].strip().strip('"')) for i in good[[0, -1]]):
            t[good[1:]] += _DAY * np.cumsum(np.diff(t[good]) < -_DAY / 2)  # midnight
        return t - (t[good[0]] if good.size else 0.0)

    def is_date(self, name: str) -> bool:
        """Return True if the first value of the column is a date and time, or a time of day."""
        if name in self.arrays:
            return bool(self.arrays[name].dtype.kind == "M")
        first = next((cell.strip().strip('"') for cell in self.cells[name] if cell.strip()), "")
        return _DATE.match(first) is not None


_EMPTY = frozenset({"", "nan", "-nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "#nv"})


def row_clock(rate: float) -> str:
    """Return the name of the time column of a table with a sampling rate in Hz."""
    return f"row / {rate:.12g} Hz"


def _stamp(text: str) -> float:
    """Return a date and time as seconds since 1970, or a time of day as seconds since midnight; raises ValueError."""
    if found := _CLOCK.match(text):
        hour, minute, second = int(found[1]), int(found[2]), float(found[3])
        if hour > 23 or minute > 59 or second >= 61.0:
            raise ValueError(text)
        return 3600.0 * hour + 60.0 * minute + second
    if found := re.match(r"(\d{1,2})\.(\d{1,2})\.(\d{4}) +(\d{1,2}):(\d\d)(?::(\d\d(?:\.\d+)?))?$", text):
        day, month, year, hour, minute = (int(part) for part in found.groups()[:5])
        return datetime(year, month, day, hour, minute, tzinfo=UTC).timestamp() + float(found[6] or 0.0)
    return datetime.fromisoformat(text).timestamp()


def read_foreign(path: Path, shape: Shape | None = None) -> ForeignTable:
    """Read a table in the format that its name and content suggest, or a text table in the format `shape`.

    Raises:
        UsageError: The file cannot be read. The message is one line.
    """
    suffix = path.suffix.lower()
    if suffix in ARRAYS and (suffix or path.is_dir()):
        arrays = read_with(ARRAYS[suffix], path)
        return ForeignTable(path, NO_TEXT, tuple(arrays.columns), {}, 1, 0, arrays.columns, arrays.dropped)
    note = ""
    if suffix in TEXTS:
        (text, note), encoding = read_with(TEXTS[suffix], path), "utf-8"
    else:
        text, encoding = _text(path, None if shape is None else shape.encoding)
    lines = _recorded(text.splitlines())
    if not any(line.strip() for line in lines):
        raise UsageError(f"{path}: is empty; give a table with a header line and rows of numbers")
    told = _told(path, lines, encoding) if shape is None else shape
    above = max(0, told.header - 1)
    rows = _rows(lines[above:], told.separator, path, above)
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
    cells = {name: [row[i] for row in body] for i, name in enumerate(names)}
    return ForeignTable(path, told, names, cells, first, ignored + footer, note=note)


def _footer(body: Sequence[Sequence[str]]) -> int:
    """Return the number of last rows with a text where the first row has its first number: "Mean;0.1;0.2".

    A column that ends with many texts is not a footer. The reader of the column reports the first of them.
    """
    column = next((i for i, cell in enumerate(body[0]) if is_number(cell)), None)
    if column is None:
        return 0
    cells = [row[column] for row in body[: -LONGEST_FOOTER - 2 : -1]]
    texts = [not is_number(cell) and cell.strip().strip('"').lower() not in _EMPTY for cell in cells]
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
        return "cp1252"  # western Windows programs use it instead of UTF-8


def _told(path: Path, lines: Sequence[str], encoding: str) -> Shape:
    """Determine separator, header and decimal sign from the first lines.

    The separator is the character with which most lines have the same number of fields.
    """
    some = lines[:LOOKED_AT]
    best: tuple[int, int, str] | None = None  # rows of equal width, width, separator
    for separator in (*SEPARATORS, " "):
        widths = Counter(len(row) for row in _rows(some, separator) if len(row) > 1)
        if widths:
            width, count = max(widths.items(), key=lambda item: (item[1], item[0]))
            if best is None or (count, -len(separator.strip())) > (best[0] * 1.1, 0):
                best = (count, width, separator)
    if best is None:
        _rows(lines, SEPARATORS[0], path)  # an open quote hides the rows below it
        raise UsageError(f"{path}: only one column; give a table with at least a time and a torque")
    _, width, separator = best
    rows = _rows(some, separator)
    numeric = next((i for i, row in enumerate(rows) if len(row) == width and _mostly_numbers(row)), None)
    if numeric is None:
        _rows(lines, separator, path)
        raise UsageError(f"{path}: no row of numbers in the first {len(some)} lines; give a table of numbers")
    # A title in a workbook is one cell in a row of empty cells.
    full = [i for i in range(numeric) if len(rows[i]) == width and sum(bool(c.strip()) for c in rows[i]) > width / 2]
    named = [i for i in full if any(re.search("[^\\W\\d]", c) for c in rows[i])]
    header = (named[0] if len(named) < 3 else named[-1]) if named else -1  # a line of units may follow the names
    cells = [cell.strip().strip('"') for row in rows[numeric:] for cell in row]
    commas = sum("," in cell and is_number(cell) for cell in cells)
    points = sum("." in cell and is_number(cell) for cell in cells)
    return Shape(encoding, separator, "," if separator != "," and commas > points else ".", header + 1)


def _rows(lines: Sequence[str], separator: str, path: Path | None = None, above: int = 0) -> list[list[str]]:
    """Return the fields of all lines.

    Args:
        lines: lines of the text.
        separator: one character, or " " for any white space.
        path: file, if `lines` end with it.
        above: number of lines above the first one.

    Raises:
        UsageError: A quote is not closed before the end of the file.
    """
    if separator == " ":
        return [line.split() for line in lines]
    rows = list(csv.reader(itertools.chain(lines, [""]), delimiter=separator))
    if rows.pop() and path is not None:  # the empty line at the end became a part of a quoted field
        raise UsageError(f'{path}: line {above + len(rows) + 1}: a quote (") is not closed; close or remove it')
    return rows


def is_number(cell: str) -> bool:
    """Return True if a cell is a number, a date or a time of day."""
    text = cell.strip().strip('"')
    return bool(_NUMBER.match(text)) or bool(_DATE.match(text)) or bool(re.match(r"\d{4}-\d\d-\d\d[T ]", text))


def _mostly_numbers(row: Sequence[str]) -> bool:
    return sum(is_number(cell) for cell in row) > len(row) / 2


def _is_units(row: Sequence[str], names: Sequence[str]) -> bool:
    """Return True if the line below the names has units: the same number of short cells without a number."""
    cells = [cell.strip() for cell in row]
    few = len(cells) == len(names) and any(cells) and all(len(cell) <= 10 for cell in cells)
    return few and not any(is_number(cell) for cell in cells) and not any("[" in name for name in names)


def _unique(names: Sequence[str]) -> tuple[str, ...]:
    seen: Counter[str] = Counter()
    out = []
    for i, name in enumerate(names, start=1):
        name = name or f"column {i}"
        seen[name] += 1
        out.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return tuple(out)
