"""Rows that a long run has made, a JSON object a line: what an interrupted run left behind is not made again."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def read_rows(path: Path | None) -> list[Row]:
    """The rows of a results file; none without it. The last line of a run that was killed may be torn: it is none."""
    text = path.read_text(encoding="utf-8") if path is not None and path.exists() else ""
    return [json.loads(line) for line in text.splitlines() if line.endswith("}")]


class Results:
    """Rows by `key`; with a path each is on the disk before the next is made. What `counts` denies is left out."""

    def __init__(
        self, path: Path | None, key: Callable[[Row], Hashable], counts: Callable[[Row], bool] = lambda row: True
    ) -> None:
        self._path = path
        self._key = key
        self._rows: dict[Hashable, Row] = {}
        for row in read_rows(path):
            if counts(row):
                self._rows[key(row)] = row

    def __contains__(self, key: Hashable) -> bool:
        return key in self._rows

    def __getitem__(self, key: Hashable) -> Row:
        return self._rows[key]

    def add(self, row: Row) -> None:
        """Keep a row."""
        self._rows[self._key(row)] = row
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
