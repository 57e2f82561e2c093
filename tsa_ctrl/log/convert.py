"""Convert a log to CSV, CSV.gz or Parquet, with one file per axis, codes as names and no empty columns."""

from __future__ import annotations

import calendar
import contextlib
import gzip
import io
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl import outputs
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.csv_table import connected, opened, said
from tsa_ctrl.log.mcap_file import McapFile
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.log.table import Table, check_readable, kind_of, read_table, split_axis
from tsa_ctrl.signals import COLUMNS, FIELD_NAMES

ROWS = 16384  # rows of a block that is written at once

Codes = Mapping[str, Mapping[int, str]]


class CsvFile:
    """Write a CSV file in blocks of rows, optionally compressed. Methods raise OSError.

    A number is written as the shortest text that reads back to the same number, and nan as an empty field.
    """

    def __init__(self, path: Path, names: Sequence[str], codes: Codes | None = None, compressed: bool = False) -> None:
        """Open the file and write the header line. `codes` maps the values of coded columns to names."""
        self._names = names
        self._codes = codes or {}
        raw = gzip.GzipFile(path, "wb", compresslevel=4) if compressed else path.open("wb")
        self._stream = io.TextIOWrapper(raw, encoding="utf-8", newline="")
        self._stream.write(",".join(names) + "\n")

    def write(self, block: NDArray[np.float64]) -> None:
        """Write a block of rows, (k, columns)."""
        columns = [self._texts(name, block[:, i]) for i, name in enumerate(self._names)]
        self._stream.write("".join([",".join(row) + "\n" for row in zip(*columns, strict=True)]))

    def close(self) -> None:
        self._stream.close()

    def _texts(self, name: str, values: NDArray[np.float64]) -> Collection[str]:
        if name in self._codes:
            return coded(values, self._codes[name])
        if name in COLUMNS and COLUMNS[name].stepped:
            return ["" if v != v else f"{v:.17g}" for v in values.tolist()]
        return ["" if v != v else repr(v) for v in values.tolist()]


def in_blocks(columns: Mapping[str, NDArray[np.float64]]) -> Iterator[NDArray[np.float64]]:
    """Yield the rows of the columns (n,) in blocks (k, columns)."""
    for start in range(0, len(next(iter(columns.values()), ())), ROWS):
        yield np.column_stack([values[start : start + ROWS] for values in columns.values()])


def write_columns(path: Path, columns: Mapping[str, NDArray[np.float64]], keeping: bool = True) -> None:
    """Write a table, compressed if the name ends with .gz.

    Args:
        path: file to write.
        columns: columns by name, (n,) each.
        keeping: True to keep an existing file as a backup.

    Raises:
        UsageError: The file cannot be written.
    """
    with (
        outputs.beside(path, keeping) as part,
        contextlib.closing(CsvFile(part, list(columns), compressed=path.suffix == ".gz")) as file,
    ):
        for block in in_blocks(columns):
            file.write(block)


def coded(values: NDArray[np.float64], names: Mapping[int, str]) -> list[str]:
    """Return the names of codes. A code without a name is returned as a number, and nan as an empty string."""
    return ["" if v != v else names.get(int(v), f"{v:g}") for v in values.tolist()]


FORMATS = (".csv", ".csv.gz", ".parquet")

Progress = Callable[[float], None]
Blocks = Iterator[NDArray[np.float64]]


@dataclass(frozen=True)
class _Source:
    """One axis to write: its columns, the names of its codes, and its rows in blocks (k, columns)."""

    axis: str | None
    names: list[str]
    codes: Codes
    rows: int
    blocks: Callable[[], Blocks]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Written:
    """The path of a written file, and notes on the parts of the log that it does not contain."""

    path: Path
    notes: tuple[str, ...]


def convert(log: str | Path, out: Path, progress: Progress = lambda share: None) -> list[Written]:
    """Write every axis of `log`, and return the files: `out` itself for one axis, OUT_AXIS for several axes.

    A file is written under another name and then renamed, so that it is either complete or absent.

    Args:
        log: log of the daemon or table.
        out: file that ends with .csv, .csv.gz or .parquet, or a folder for CSV files.
        progress: function that receives the completed share, 0 to 1.

    Raises:
        UsageError: The log cannot be read, or `out` cannot be written.
    """
    file, _ = split_axis(log)
    check_readable(file)
    sources = _sources(log)
    written: list[Written] = []
    total = sum(source.rows for source in sources)
    done = 0

    def write_csv(rows: Path, source: _Source, compressed: bool = False) -> None:
        nonlocal done
        with contextlib.closing(CsvFile(rows, source.names, source.codes, compressed)) as table:
            for block in source.blocks():
                table.write(block)
                done += len(block)
                progress(done / total)

    for source in sources:
        path = _path(file, out, source.axis if len(sources) > 1 or _is_folder(out) else None)
        outputs.refuse_inputs(path, [file])
        with outputs.beside(path) as part:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.name.lower().endswith(".parquet"):
                # by a file, because a log may be larger than the memory
                with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}-") as folder:
                    write_csv(Path(folder) / "rows.csv", source)
                    _to_parquet(Path(folder) / "rows.csv", part, source)
            else:
                write_csv(part, source, compressed=path.name.lower().endswith(".gz"))
        written.append(Written(path, source.notes))
    return written


def _sources(log: str | Path) -> list[_Source]:
    file, axis = split_axis(log)
    if not file.exists() or kind_of(file) != ".mcap":
        return [_of_table(read_table(log))]
    contents = LogFile(file)
    axes = contents.chosen(axis)
    present: dict[str, NDArray[np.bool_]] = {}
    rows = dict.fromkeys(contents.axes, 0)
    for name, block in contents.blocks(contents.fields):
        present[name] = ~np.isnan(block).all(axis=0) | present.get(name, np.zeros(len(contents.fields), dtype=bool))
        rows[name] += len(block)
    if not present:
        raise UsageError(f"{file}: contains no records; record longer or give another log")
    return [_of_axis(contents, name, present[name], rows[name]) for name in axes if name in present]


def _of_axis(contents: LogFile, axis: str, present: NDArray[np.bool_], rows: int) -> _Source:
    names = [name for name, there in zip(contents.fields, present.tolist(), strict=True) if there]
    joints = contents.joint_angles() if "t" in names else {}

    def blocks() -> Blocks:
        for name, block in contents.blocks(names):
            if name == axis:
                t = block[:, names.index("t")] if joints else block[:, 0]
                yield np.column_stack([block, *(at(t) for at in joints.values())])

    return _Source(axis, [*names, *joints], contents.codes, rows, blocks, tuple(contents.problems))


def _of_table(table: Table) -> _Source:
    names = list(table.columns)
    if not names:
        raise UsageError(
            f"{table.label}: no column has only numbers; tsa log import reads the tables of other programs"
        )
    text = ", ".join(table.left_out)
    notes = (f"columns without numbers are left out: {text}",) if text else ()

    def blocks() -> Blocks:
        return in_blocks(table.columns)

    return _Source(None, names, {}, len(table), blocks, notes)


def _is_folder(out: Path) -> bool:
    return out.is_dir() or not any(out.name.lower().endswith(ending) for ending in FORMATS)


def _path(log: Path, out: Path, axis: str | None) -> Path:
    if _is_folder(out):
        if out.suffix and not out.is_dir():
            raise UsageError(f"{out}: unknown kind of file; allowed are {', '.join(FORMATS)} or a folder")
        stem = log.name[: -len(kind_of(log))]
        return out / (f"{stem}_{axis}.csv" if axis else f"{stem}.csv")
    if axis is None:
        return out
    ending = max((ending for ending in FORMATS if out.name.lower().endswith(ending)), key=len)
    return out.with_name(f"{out.name[: -len(ending)]}_{axis}{out.name[-len(ending) :]}")


def _to_parquet(rows: Path, out: Path, source: _Source) -> None:
    """Write a CSV file with the columns of the source as a Parquet file, with codes as text. Raise OSError."""
    import duckdb

    kinds = {name: "VARCHAR" if name in source.codes else "DOUBLE" for name in source.names}
    options = "auto_detect = false, header = false, skip = 1, delim = ',', nullstr = ''"
    try:
        with connected() as connection, opened(rows) as name:
            connection.execute(
                f"COPY (SELECT * FROM read_csv('{name}', {options}, columns = $kinds)) TO $out "
                "(FORMAT parquet, COMPRESSION zstd)",
                {"kinds": kinds, "out": str(out)},
            )
    except duckdb.Error as error:  # most likely a full disk
        raise OSError(said(error)) from None


def write_last(log: Path, out: Path, seconds: float) -> float:
    """Write the header, the records of the last `seconds` (s) and all events of a log to a new file.

    Returns:
        The duration of the written part, s.

    Raises:
        UsageError: The log cannot be read or is from a version with other columns, or `out` cannot be written.
    """
    file = LogFile(log)
    if tuple(file.fields) != tuple(FIELD_NAMES):
        raise UsageError(
            f"{log}: was written by version {file.about.get('version')}, which has other columns; use that version"
        )
    end = max((float(block[-1, 0]) for _, block in file.blocks(("t",)) if len(block)), default=0.0)
    started = calendar.timegm(time.strptime(file.about["started"], "%Y-%m-%dT%H:%M:%SZ"))
    header = LogHeader(
        tuple(file.axes),
        file.about["rate"],
        file.files,
        file.codes,
        float(started),
        file.about["version"],
        file.about.get("build", "unknown"),
    )
    first = end
    with outputs.beside(out) as part, contextlib.closing(McapFile(part, header)) as target:
        for axis, block in file.blocks(file.fields):
            kept = block[block[:, 0] >= end - seconds]
            if len(kept):
                first = min(first, float(kept[0, 0]))
                target.write([kept if name == axis else _nothing() for name in file.axes])
        target.write_notes(file.notes)
        target.finish()
    return end - first


def _nothing() -> NDArray[np.float64]:
    return np.empty((0, len(FIELD_NAMES)))
