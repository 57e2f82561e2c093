"""Shared parts of the commands: name, parser, tables, saved rows of a long run, a vcan, a pool of processes."""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "config"
MOST_PROCESSES = 2

Row = dict[str, Any]
Item = TypeVar("Item")
Done = TypeVar("Done")


def name_of(module: str) -> str:
    """`bench/cycle` of the module `tools.bench.cycle`: what `tools/run` calls it."""
    return module.removeprefix("tools.").replace(".", "/")


def parser(module: str, doc: str | None) -> argparse.ArgumentParser:
    """A parser whose help is the module's text."""
    prog = f"tools/run {name_of(module)}"
    return argparse.ArgumentParser(prog, description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def process(module: str, *arguments: str) -> list[str]:
    """The command line of a command here as a process of its own."""
    return [sys.executable, str(ROOT / "tools"), name_of(module), *arguments]


def vcan(module: str) -> str:
    """Name of the virtual CAN interface; where there is none this process becomes one under tools/vcan."""
    if "TSA_VCAN" not in os.environ:
        os.execv(ROOT / "tools" / "vcan", ["vcan", *process(module, *sys.argv[1:])])
    return os.environ["TSA_VCAN"]


def measured_data(module: str) -> Path | None:
    """Folder of the measured cable drive: TSA_DATA, else ../shared/data, else what was fetched; its lack is said."""
    from tsa_ctrl.published import catalogue

    beside = [] if catalogue.VARIABLE in os.environ else [ROOT.parent / "shared" / "data"]
    places = [*beside, catalogue.folder()]
    for folder in (folder for base in places for folder in (base / "davinci", base)):
        if (folder / "actuator.toml").is_file():
            return folder
    print(
        f"tools/run {name_of(module)}: no measured data in {' or '.join(map(str, places))}; tsa data fetch davinci, "
        f"or name the folder that holds davinci/ in {catalogue.VARIABLE}"
    )
    return None


def parallel(work: Callable[[Item], Done], items: Sequence[Item], processes: int) -> Iterator[Done]:
    """Yield `work(item)` of every item as it is done; the first one compiles what all need, before others begin."""
    first, rest = items[:1], items[1:]
    yield from map(work, first if processes > 1 and rest else items)
    if processes > 1 and rest:
        context = multiprocessing.get_context("fork")
        with concurrent.futures.ProcessPoolExecutor(processes, context) as pool:
            for done in concurrent.futures.as_completed([pool.submit(work, item) for item in rest]):
                yield done.result()


def read_rows(path: Path | None) -> list[Row]:
    """Return the rows of a results file, empty without a file. A torn last line of a killed run is ignored."""
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


def print_table(head: Sequence[str], lines: Sequence[Sequence[object]], title: str | None = None) -> None:
    """Print a table; without a terminal it is as wide as its cells need, up to 250 characters."""
    from rich.console import Console
    from rich.table import Table

    table = Table(*head, title=title, title_justify="left")
    for line in lines:
        table.add_row(*map(_cell, line))
    Console(width=None if sys.stdout.isatty() else 250).print(table)


def show(rows: Sequence[Row], keys: Sequence[str], as_json: bool) -> None:
    """Print one JSON object a line, or a table of these keys."""
    if as_json:
        print("\n".join(map(json.dumps, rows)), flush=True)
    else:
        print_table([key.replace("_", " ") for key in keys], [[row.get(key) for key in keys] for row in rows])


def _cell(value: object) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
