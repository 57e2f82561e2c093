"""Functions that the commands share: parsers, tables, saved rows of long runs, a vcan, and a pool of processes."""

from __future__ import annotations

import argparse
import concurrent.futures
import contextlib
import dataclasses
import datetime
import itertools
import json
import multiprocessing
import os
import platform
import random
import secrets
import subprocess
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:  # the guest's first process has only the standard library
    from rich.table import Table

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "config"
MOST_PROCESSES = 2
PROCESSORS = min(MOST_PROCESSES, len(os.sched_getaffinity(0)))
SENSORS = ("motor", "encoder", "sensor")  # no joint sensor; joint encoder; joint encoder and joint torque sensor

Row = dict[str, Any]
Item = TypeVar("Item")
Done = TypeVar("Done")


def name_of(module: str) -> str:
    """Return the name of a command for `tools/run`, for example `bench/cycle` of the module `tools.bench.cycle`."""
    return module.removeprefix("tools.").replace(".", "/")


def parser(module: str, doc: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help text is the module's docstring."""
    prog = f"tools/run {name_of(module)}"
    return argparse.ArgumentParser(prog, description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


SHARED: dict[str, dict[str, Any]] = {  # options of several commands
    "--rows": {"type": Path, "help": "JSON lines of finished runs, which are not run again"},
    "--processes": {"type": int, "default": PROCESSORS, "choices": range(1, MOST_PROCESSES + 1)},
    "--json": {"action": "store_true", "help": "print a JSON object for each run instead of tables"},
    "--seed": {"type": int, "help": "seed of all random choices (default: a new one, which is printed)"},
    "--sample": {"type": int, "default": 0, "metavar": "N", "help": "N drawn runs; 0: all"},
    "--rigs": {"type": int, "default": 10},
    "--first": {"type": int, "default": 0, "help": "number of the first rig"},
    "--sensors": {"nargs": "+", "choices": SENSORS, "default": SENSORS},
}


def share(parser: argparse.ArgumentParser, names: str, **defaults: object) -> None:
    """Add shared options by their names. `defaults` replaces their default values."""
    for name in names.split():
        parser.add_argument(f"--{name}", **SHARED[f"--{name}"])
    parser.set_defaults(**defaults)


def seeded(chosen: argparse.Namespace) -> None:
    """Choose a random seed if --seed is not given."""
    if chosen.seed is None:
        chosen.seed = secrets.randbelow(10**6)


def drawn(items: Sequence[Item], chosen: argparse.Namespace) -> list[Item]:
    """Return --sample random items in random order by --seed, or all items without --sample."""
    seeded(chosen)
    return random.Random(chosen.seed).sample(items, min(chosen.sample, len(items))) if chosen.sample else list(items)


def process(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a command of this folder in a separate process."""
    return [sys.executable, str(ROOT / "tools"), name_of(module), *arguments]


def here() -> Row:
    """Return the date, the commit and the machine of a measurement."""
    git = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    return {
        "date": datetime.date.today().isoformat(),
        "commit": subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip(),
        "machine": f"{os.cpu_count()} processors, {platform.machine()}, Python {platform.python_version()}",
    }


def family(pid: int) -> list[int]:
    """Return the process ids of a process and all its descendants."""
    found = [pid]
    for each in found:
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{each}/task").iterdir():
                found += [int(child) for child in (task / "children").read_text(encoding="ascii").split()]
    return found


def vcan(module: str) -> str:
    """Return the name of the virtual CAN interface. Without TSA_VCAN, execute this command again under tools/vcan."""
    if "TSA_VCAN" not in os.environ:
        os.execv(ROOT / "tools" / "vcan", ["vcan", *process(module, *sys.argv[1:])])
    return os.environ["TSA_VCAN"]


def measured_data(module: str) -> Path | None:
    """Return the folder of the measured cable drive, or print that it is missing and return None.

    It is searched in TSA_DATA, or without this variable in ../shared/data and the folder of fetched data.
    """
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
    """Yield the results of `work` for all items in the order of completion.

    The first item runs alone, so that it compiles the functions that all items need.
    """
    first, rest = items[:1], items[1:]
    yield from map(work, first if processes > 1 and rest else items)
    if processes > 1 and rest:
        context = multiprocessing.get_context("fork")
        with concurrent.futures.ProcessPoolExecutor(processes, context) as pool:
            for done in concurrent.futures.as_completed([pool.submit(work, item) for item in rest]):
                yield done.result()


def read_rows(path: Path | None) -> list[Row]:
    """Return the rows of a results file, or no rows without a file. Ignore a line that a killed run cut off."""
    text = path.read_text(encoding="utf-8") if path is not None and path.exists() else ""
    rows: list[Row] = []
    for line in text.splitlines():
        with contextlib.suppress(ValueError):
            rows.append(json.loads(line))
    return rows


class Results:
    """Rows by key, which are also appended to a file if a path is given. Rows that `counts` rejects are ignored."""

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
        """Store a row, and append it to the file."""
        self._rows[self._key(row)] = row
        if self._path is not None:
            with self._path.open("a+b") as file:
                if file.tell() and not self._path.read_bytes().endswith(b"\n"):  # a line that an interruption cut off
                    file.write(b"\n")
                file.write(json.dumps(row).encode() + b"\n")


def run_rows(
    work: Callable[[Item], Row],
    items: Sequence[Item],
    key: Callable[[Row], Hashable],
    chosen: argparse.Namespace,
    each: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Return the row of every item. Items whose row is in --rows are not run again.

    `key` returns the item of a row. `each` is called with every new row.
    """
    kept = Results(chosen.rows, key)
    for row in parallel(work, [item for item in items if item not in kept], chosen.processes):
        kept.add(row)
        each(row)
    return [kept[item] for item in items]


def from_row(kind: type[Item], row: Row) -> Item:
    """Return the case of a row: a dataclass whose fields are keys of the row."""
    return kind(*(row[field.name] for field in dataclasses.fields(kind)))  # type: ignore[arg-type]


def judged(
    work: Callable[[Item], Row],
    items: Sequence[Item],
    key: Callable[[Row], Hashable],
    chosen: argparse.Namespace,
    good: Callable[[Row], bool],
    words: Callable[[Row], str],
    tables: Callable[[list[Row]], Iterable[object]],
) -> int:
    """Run the items that are not in --rows. Print the new rows that miss a goal, and then the tables.

    Return 1 if any row misses a goal.
    """

    def missed(row: Row) -> None:
        if not good(row) and not chosen.json:
            print(f"missed: {words(row)}", flush=True)

    rows = run_rows(work, items, key, chosen, missed)
    print_tables(rows, chosen, lambda: tables(rows))
    return int(not all(map(good, rows)))


def print_tables(rows: Sequence[Row], chosen: argparse.Namespace, tables: Callable[[], Iterable[object]]) -> None:
    """Print the rows as JSON lines with --json, otherwise the tables and lines of text."""
    from rich.console import Console

    if chosen.json:
        print("\n".join(map(json.dumps, rows)), flush=True)
        return
    for each in tables():
        print(each, flush=True) if isinstance(each, str) else Console(width=250).print(each)


def parts(rows: Sequence[Row], **values: Iterable[str]) -> Iterator[tuple[tuple[str, ...], list[Row]]]:
    """Yield each combination of values of these keys that rows have, with its rows."""
    for key in itertools.product(*values.values()):
        if those := [row for row in rows if tuple(row[name] for name in values) == key]:
            yield key, those


def table(head: Sequence[str], lines: Iterable[Sequence[object]], title: str | None = None) -> Table:
    """Return a table. None becomes "-", and floating-point numbers have four digits."""
    from rich.table import Table

    found = Table(*head, title=title, title_justify="left")
    for line in lines:
        found.add_row(*map(_cell, line))
    return found


def print_table(head: Sequence[str], lines: Iterable[Sequence[object]]) -> None:
    """Print a table, up to 250 characters wide if the output is not a terminal."""
    from rich.console import Console

    Console(width=None if sys.stdout.isatty() else 250).print(table(head, lines))


def _cell(value: object) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def print_goals(rows: Sequence[Row]) -> None:
    """Print a table of rows with "what", "goal" and "found". A goal is met by a value of at most the goal."""
    lines = [(row["what"], f"{row['goal']:.1f}", f"{row['found']:.1f}", row["found"] <= row["goal"]) for row in rows]
    print_table(("row", "goal", "measured", "met"), lines)
