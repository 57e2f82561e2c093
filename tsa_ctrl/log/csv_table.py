"""CSV files of any size to columns of doubles: read in blocks, checked line by line, with errors that name the place.

Comma, semicolon and tab part the fields; a byte-order mark, Windows line ends, quotes, spaces and `#` lines above the
header are accepted. A decimal comma is not: a number must read the same everywhere.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log import numbers
from tsa_ctrl.log.columns import SIGNAL_NAMES

BLOCK = 1 << 22  # bytes read at once
ROWS = 1 << 16  # lines parsed at once
ODD = 1 << 14  # entries that are no plain numbers handled at once
DELIMITERS = ",;\t"

Columns = dict[str, NDArray[np.float64]]


def read_csv(path: Path, wanted: Collection[str] | None = None) -> tuple[Columns, list[str], int]:
    """Read `wanted` columns (None: all signals and whatever else is numeric); an empty field is nan.

    Returns the columns, the names of those left out and the number of lines above the first row. Raises UsageError in
    one line for a file that is no table of numbers.
    """
    try:
        with _open(path) as stream:
            return _read(path, stream, wanted)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        reason = "ends early" if isinstance(error, EOFError) else "is damaged"
        raise UsageError(f"{path}: the compressed file {reason} ({error}); copy it again") from None


def _open(path: Path) -> BinaryIO | gzip.GzipFile:
    if path.suffix.lower() == ".gz":
        return gzip.GzipFile(path, "rb")
    return path.open("rb")


def _read(
    path: Path, stream: BinaryIO | gzip.GzipFile, wanted: Collection[str] | None
) -> tuple[Columns, list[str], int]:
    names, delimiter, above, rest = _header(path, stream)
    kept = [name for name in names if wanted is None or name in wanted]
    target = np.array([kept.index(name) if name in kept else -1 for name in names], dtype=np.int64)
    columns = [_Growing() for _ in kept]
    texts: dict[int, tuple[int, str]] = {}  # the first entry that is no number, per column
    out = np.empty((max(1, len(kept)), ROWS))
    odd = np.empty((max(ODD, len(names)), 4), dtype=np.int64)
    rows = 0
    for block in _lines(rest, stream):
        text = np.frombuffer(block, dtype=np.uint8)
        position = 0
        while position < len(text):
            done, position, odds, outcome, found = numbers.parse(
                text, position, len(text), ord(delimiter), target, out, odd
            )
            for row, column, begin, end in odd[:odds].tolist():
                token = block[begin:end]
                try:
                    out[column, row] = _odd_number(token)
                except ValueError:
                    texts.setdefault(column, (rows + row + 1, token.decode("utf-8", "replace")))
            for growing, values in zip(columns, out, strict=False):
                growing.extend(values[:done])
            rows += done
            if outcome == numbers.BLANK_LINE and not block[position:].strip() and not stream.read(1 << 16).strip():
                position = len(text)
            elif outcome != numbers.OK:
                raise UsageError(f"{path}: row {rows + 1} (line {rows + 1 + above}) " + _wrong(outcome, found, names))
    for column, (row, entry) in texts.items():
        if wanted is not None or kept[column] in SIGNAL_NAMES:
            raise UsageError(
                f"{path}: column {kept[column]}, row {row} (line {row + above}): found '{entry[:40]}' where a number "
                f"is needed{_comma_hint(entry)}; correct it"
            )
    whole = {name: columns[i].whole() for i, name in enumerate(kept) if i not in texts}
    return whole, [name for name in names if name not in whole], above


class _Growing:
    """One column that grows in place, so that a file of gigabytes is in memory once."""

    def __init__(self) -> None:
        self._values = np.empty(ROWS)
        self._length = 0

    def extend(self, values: NDArray[np.float64]) -> None:
        end = self._length + len(values)
        if end > len(self._values):
            self._values.resize(max(end, len(self._values) * 5 // 4), refcheck=False)
        self._values[self._length : end] = values
        self._length = end

    def whole(self) -> NDArray[np.float64]:
        """The column; nothing may be added afterwards."""
        self._values.resize(self._length, refcheck=False)
        return self._values


def _lines(rest: bytes, stream: BinaryIO | gzip.GzipFile) -> Iterator[bytes]:
    """Blocks of whole lines."""
    while chunk := stream.read(BLOCK):
        cut = chunk.rfind(b"\n") + 1
        if cut == 0:
            rest += chunk
            continue
        yield rest + chunk[:cut]
        rest = chunk[cut:]
    if rest.strip():
        yield rest


def _header(path: Path, stream: BinaryIO | gzip.GzipFile) -> tuple[list[str], str, int, bytes]:
    """Names, delimiter, number of lines down to the header, and the bytes read beyond it."""
    head = stream.read(BLOCK)
    if not head.strip():
        raise UsageError(f"{path}: is empty; give a log with a header row and at least two rows")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise UsageError(f"{path}: is UTF-16 text; save it as UTF-8")
    if b"\0" in head[:4096]:
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
    twice = next((name for name in names if name and names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"{path}: column {twice} stands twice in the header; rename or remove one")
    return names, delimiter, above, head


def _odd_number(token: bytes) -> float:
    if not token:
        return float("nan")
    if b"_" in token:  # float() takes 1_000
        raise ValueError(token)
    return float(token)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _comma_hint(token: str) -> str:
    return " (a decimal comma: only the point is allowed)" if "," in token and _is_number(token) else ""


def _wrong(outcome: int, found: int, names: list[str]) -> str:
    if outcome == numbers.BLANK_LINE:
        return "is empty; a log has no holes: remove the line or cut the file there"
    hint = " (a decimal comma: only the point is allowed)" if found >= 2 * len(names) - 1 else ""
    return f"has {found} fields where the header has {len(names)}{hint}; correct or remove it"
