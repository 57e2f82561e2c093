"""DuckDB as the engine of tables: of one thread, in memory, without the network.

It reads and writes CSV and Parquet in 69 MB of disk where pyarrow takes 165.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

SETTINGS: dict[str, str | bool | int | float | list[str]] = {
    "threads": 1,  # a daemon's processors are not for this, and others' timing is not disturbed
    "autoinstall_known_extensions": False,
    "autoload_known_extensions": False,
}


_NAME = re.compile(r"\s*(in|of|for)?( the)?( file)?:? *['\"]?/dev/fd/\d+['\"]?")


@contextlib.contextmanager
def connected(database: Path | None = None) -> Iterator[DuckDBPyConnection]:
    """A connection to a new database, in memory or in the file `database`; closed at the end."""
    import duckdb

    with duckdb.connect(":memory:" if database is None else str(database), config=SETTINGS) as connection:
        yield connection


@contextlib.contextmanager
def opened(path: Path) -> Iterator[str]:
    """The name of `path` for a query: DuckDB takes *, ? and [ in a name for a pattern, here is none."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        yield f"/dev/fd/{descriptor}"
    finally:
        os.close(descriptor)


def quoted(name: str) -> str:
    """A column's name in a query."""
    return '"' + name.replace('"', '""') + '"'


def doubles(values: Any) -> NDArray[np.float64]:
    """A column of a result as doubles of its own, NULL as nan."""
    filled = values.filled(np.nan) if isinstance(values, np.ma.MaskedArray) else values
    return np.require(filled, dtype=np.float64, requirements="W")


def said(error: Exception) -> str:
    """What is wrong, without `opened`'s name and the advice on queries that follows."""
    text = _NAME.sub("", str(error).partition("\n\n")[0])
    return " ".join(text.partition(" Error: ")[2].split() or text.split())
