"""Columns of doubles to CSV: the shortest text that reads back to the same number, nan as an empty field."""

from __future__ import annotations

import contextlib
import gzip
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl import outputs
from tsa_ctrl.log.columns import BY_NAME

ROWS = 16384  # written at once

Codes = Mapping[str, Mapping[int, str]]


class CsvFile:
    """A CSV file written in blocks of rows, compressed when asked; raises OSError."""

    def __init__(self, path: Path, names: Sequence[str], codes: Codes | None = None, compressed: bool = False) -> None:
        """`codes` gives the names of coded columns' values."""
        self._names = names
        self._codes = codes or {}
        raw = gzip.GzipFile(path, "wb", compresslevel=4) if compressed else path.open("wb")
        self._stream = io.TextIOWrapper(raw, encoding="utf-8", newline="")
        self._stream.write(",".join(names) + "\n")

    def write(self, block: NDArray[np.float64]) -> None:
        """Rows, shape (k, columns)."""
        columns = [self._texts(name, block[:, i]) for i, name in enumerate(self._names)]
        self._stream.write("".join([",".join(row) + "\n" for row in zip(*columns, strict=True)]))

    def close(self) -> None:
        self._stream.close()

    def _texts(self, name: str, values: NDArray[np.float64]) -> Collection[str]:
        if name in self._codes:
            return coded(values, self._codes[name])
        if name in BY_NAME and BY_NAME[name].stepped:
            return ["" if v != v else f"{v:.17g}" for v in values.tolist()]
        return ["" if v != v else repr(v) for v in values.tolist()]


def in_blocks(columns: Mapping[str, NDArray[np.float64]]) -> Iterator[NDArray[np.float64]]:
    """Rows of the columns, each (n,), in blocks of (k, columns)."""
    for start in range(0, len(next(iter(columns.values()), ())), ROWS):
        yield np.column_stack([values[start : start + ROWS] for values in columns.values()])


def write_columns(path: Path, columns: Mapping[str, NDArray[np.float64]], keeping: bool = True) -> None:
    """Write a table, compressed where its name ends with .gz; raises UsageError. `keeping`: what was there is kept."""
    with (
        outputs.beside(path, keeping) as part,
        contextlib.closing(CsvFile(part, list(columns), compressed=path.suffix == ".gz")) as file,
    ):
        for block in in_blocks(columns):
            file.write(block)


def coded(values: NDArray[np.float64], names: Mapping[int, str]) -> list[str]:
    """Codes as their names; one without a name stays a number."""
    return ["" if v != v else names.get(int(v), f"{v:g}") for v in values.tolist()]
