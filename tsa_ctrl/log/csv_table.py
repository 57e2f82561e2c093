"""CSV files of any size to columns of doubles, with errors that name the place.

Comma, semicolon and tab part the fields; a byte-order mark, Windows line ends, quotes, spaces and `#` lines above the
header are accepted. A decimal comma is not: a number must read the same everywhere. pyarrow parts the lines and reads
the numbers (each as `float()` would); here is what it accepts and a log may not have, and the place of what it refuses.

It is pyarrow by measurement, 400,000 rows of 10 numbers: 0.48 s of one processor; pandas 0.24, polars 0.2, numpy's
loadtxt 1.3, the csv module and float() 3.0, a reader of our own in numba 0.33 and 0.8 s more at its first use. pandas
and polars take a row that is too short, numpy no empty field; pyarrow refuses both kinds and says where.
"""

from __future__ import annotations

import contextlib
import gzip
import os
import re
import sys
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.columns import SIGNAL_NAMES
from tsa_ctrl.log.unpacked import CountedStream, Unpacked

HEAD = 1 << 16  # bytes in which the header is looked for
DELIMITERS = ",;\t"
_NO_NUMBER = re.compile(r"In CSV column #(\d+): Row #(\d+): .* invalid value '(.*)'$", re.DOTALL)  # as pyarrow says it

# pyarrow's own allocator takes an arena of 1 GB at its first byte, all of it present in a daemon that locks its memory
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")

Columns = dict[str, NDArray[np.float64]]


def read_csv(path: Path, wanted: Collection[str] | None = None) -> tuple[Columns, list[str], int]:
    """Read `wanted` columns (None: all signals and whatever else is numeric); an empty field is nan.

    Returns the columns, the names of those left out and the number of lines above the first row. Raises UsageError in
    one line for a file that is no table of numbers.
    """
    try:
        with _open(path) as stream:
            head = stream.read(HEAD)
        names, delimiter, above = _header(path, head)
        with _open(path) as stream:
            counted = CountedStream(stream, Unpacked(path)) if isinstance(stream, gzip.GzipFile) else stream
            return _read(path, counted, names, delimiter, above, wanted)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        reason = "ends early" if isinstance(error, EOFError) else "is damaged"
        raise UsageError(f"{path}: the compressed file {reason} ({error}); copy it again") from None


def _open(path: Path) -> BinaryIO | gzip.GzipFile:
    return gzip.GzipFile(path, "rb") if path.suffix.lower() == ".gz" else path.open("rb")


def _read(
    path: Path,
    stream: BinaryIO | CountedStream,
    names: list[str],
    delimiter: str,
    above: int,
    wanted: Collection[str] | None,
) -> tuple[Columns, list[str], int]:
    import pyarrow as pa
    from pyarrow import csv

    kept = [place for place, name in enumerate(names) if wanted is None or name in wanted]  # names may be empty
    if not kept:  # to pyarrow no column is all of them
        return {}, names, above
    numeric = [str(place) for place in kept if wanted is not None or names[place] in SIGNAL_NAMES]
    refused: list[str] = []

    def wrong_length(row: Any) -> str:
        if not row.text.strip():
            return "skip"
        hint = " (a decimal comma: only the point is allowed)" if row.actual_columns >= 2 * len(names) - 1 else ""
        place = f"row {row.number - above} (line {row.number})"
        found = f"{place} has {row.actual_columns} fields where the header has {len(names)}{hint}"
        refused.append(f"{path}: {found}; correct or remove it")
        return "error"

    try:
        with _undecodable(path):
            table: Any = csv.read_csv(
                stream,
                csv.ReadOptions(use_threads=False, skip_rows=above, column_names=[str(i) for i in range(len(names))]),
                csv.ParseOptions(delimiter=delimiter, ignore_empty_lines=False, invalid_row_handler=wrong_length),
                csv.ConvertOptions(
                    column_types=dict.fromkeys(numeric, pa.float64()),
                    null_values=[""],
                    include_columns=[str(place) for place in kept],
                ),
            )
    except pa.ArrowInvalid as error:
        raise UsageError(refused[0] if refused else _no_number(path, str(error), names, above)) from None
    rows = _last(path, table, above)
    columns: Columns = {}
    for place, column in zip(kept, table.columns, strict=True):
        if pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or pa.types.is_null(column.type):
            values = column.slice(0, rows).cast(pa.float64(), safe=False).to_numpy()
            columns[names[place]] = np.require(values, requirements="W")
    return columns, [name for name in names if name not in columns], above


@contextlib.contextmanager
def _undecodable(path: Path) -> Iterator[None]:
    """Raises UsageError for a row that pyarrow cannot show as text: it tells nobody but the standard error."""
    hidden: list[sys.UnraisableHookArgs] = []
    before, sys.unraisablehook = sys.unraisablehook, hidden.append
    try:
        yield
    finally:
        sys.unraisablehook = before
        if hidden:
            raise UsageError(f"{path}: a row with too few or too many fields is not UTF-8 text; save the file as UTF-8")


def _last(path: Path, table: Any, above: int) -> int:
    """Number of rows without the empty ones at the end; raises UsageError for an empty one before others."""
    rows: int = table.num_rows
    if not table.num_columns or not all(column.null_count for column in table.columns):
        return rows
    empty = np.logical_and.reduce([column.is_null().to_numpy() for column in table.columns])
    if not empty.any():
        return rows
    first = int(np.argmax(empty))
    if not empty[first:].all():
        raise UsageError(
            f"{path}: row {first + 1} (line {first + 1 + above}) is empty; a log has no holes: remove the line or cut "
            "the file there"
        )
    return first


def _no_number(path: Path, said: str, names: list[str], above: int) -> str:
    found = _NO_NUMBER.match(said)
    if found is None:
        return f"{path}: is no table of numbers ({' '.join(said.split())}); write it again"
    column, line, entry = names[int(found[1])], int(found[2]), found[3]
    hint = " (a decimal comma: only the point is allowed)" if "," in entry and _is_number(entry) else ""
    return (
        f"{path}: column {column}, row {line - above} (line {line}): found {entry[:40]!r} where a number is needed"
        f"{hint}; correct it"
    )


def _header(path: Path, head: bytes) -> tuple[list[str], str, int]:
    """Names, delimiter, and number of lines down to the header."""
    if not head.strip():
        raise UsageError(f"{path}: is empty; give a log with a header row and at least two rows")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise UsageError(f"{path}: is UTF-16 text; save it as UTF-8")
    if b"\0" in head:
        raise UsageError(f"{path}: is not text; give CSV, CSV.gz, Parquet or MCAP (by the file's ending)")
    head = head.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in head and b"\n" not in head:
        raise UsageError(f"{path}: its lines end with a lone carriage return; save it with line feeds")
    line, above = b"", 0
    while head and (not line.strip() or line.startswith(b"#")):
        line, _, head = head.partition(b"\n")
        above += 1
    try:
        text = line.decode("utf-8").strip("\r\n")
    except UnicodeDecodeError:
        raise UsageError(f"{path}: line {above} is not UTF-8 text; save the file as UTF-8") from None
    delimiter = max(DELIMITERS, key=text.count)
    names = [name.strip().strip('"').strip() for name in text.split(delimiter)]
    if all(_is_number(name) for name in names):
        raise UsageError(f"{path}: line {above} holds numbers where the header is expected; add a row of column names")
    odd = next((name for name in names if not name.isprintable()), None)
    if odd is not None:
        raise UsageError(f"{path}: line {above}: the column name {odd[:40]!r} cannot be printed; rename it")
    twice = next((name for name in names if name and names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"{path}: column {twice} stands twice in the header; rename or remove one")
    return names, delimiter, above


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
