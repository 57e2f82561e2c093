"""Compare results with regression digests, or with another revision, to find the results that a change affects.

Usage: tools/run pins [--part a|b|c] [--only TEXT] [--quick] [--processes 1|2] [--write | --against REV | --show ROW]

A row is one result: the diagnosis of a log (a), a run of the loop in virtual time (b), or the output and files of a
command (c). tools/pins.toml lists the cases. Without an option, all rows are compared with the digests in
tools/pins.json. Numbers are first rounded to ten digits. A row is equal, or its values differ, or only its text
differs. If the versions differ from those in the file, or the measured data are missing (TSA_DATA, else
../shared/data), a row is "not compared".

--write writes the digests of the chosen rows. --against REV also runs these rows on the package of another revision. It
prints the number of values that differ in a row, and the largest change relative to its column. HEAD shows the effect
of uncommitted changes. --show ROW prints both values of each difference, against REV or else against the commit that
last changed the digests. --quick runs only some fast rows. Exit code 1: a row differs.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import importlib
import json
import math
import os
import platform
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from tools import command
from tools.pin_rows import Job, Values, data, jobs
from tools.revision import WORKTREES, worktree
from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError

FILE = command.ROOT / "tools" / "pins.json"
PLACE = WORKTREES / "pins"  # always the same worktree, so that numba's cache stays valid for unchanged files
ZERO = 1e-12  # in SI units; smaller values are rounding errors
VARYING = ("sha256", "date", "version", "recorded_by", "build")  # keys that vary from run to run or with the release
QUICK = r"a .* 90[04]$|b .* sine, fault none|c tsa (run|plant|init|data|doctor) "
NOT_COMPARED = "not compared: "
INDEX = re.compile(r"\[\d+\]$")  # index of a list item at the end of a path


def leaves(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and value of each leaf of a tree, with sorted keys and without keys that vary."""
    if isinstance(tree, dict):
        for key in sorted(tree.keys() - VARYING):
            yield from leaves(tree[key], f"{path}.{key}")
    elif isinstance(tree, list | tuple):
        for place, value in enumerate(tree):
            yield from leaves(value, f"{path}[{place}]")
    else:
        yield path, tree


def rounded(value: Any) -> str:
    """Return a value as text, with ten digits for a number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{0.0 if abs(value) < ZERO else value:.9e}"


def is_sentence(value: Any) -> bool:
    """Return True if a value is a text with spaces, and not a number or a name."""
    return isinstance(value, str) and " " in value


def digest(tree: Values) -> str:
    """Return two digests in one string, of the numbers and names, and of the sentences."""
    parts = {False: hashlib.sha256(), True: hashlib.sha256()}
    for path, value in leaves(tree):
        parts[is_sentence(value)].update(f"{path} {rounded(value)}\n".encode())
    return " ".join(part.hexdigest()[:12] for part in parts.values())


def machine() -> dict[str, str]:
    """Return the versions and the processor on which the last digits of a result depend."""
    found = {name: metadata.version(name) for name in ("numpy", "scipy", "numba", "llvmlite")}
    found |= {"python": platform.python_version(), "libc": "-".join(platform.libc_ver())}
    instructions = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    processor = importlib.import_module("llvmlite.binding").get_host_cpu_name()
    return found | {"processor": processor, "instructions": " ".join(instructions)}


def outcome(values: Values | None, kept: str | None, same_machine: bool) -> str:
    """Return the result of comparing a row with its saved digests, as text."""
    if values is None:
        return f"{NOT_COMPARED}no measured data"
    if kept is None or not same_machine:
        return NOT_COMPARED + ("no digest; --write adds it" if kept is None else "other versions")
    now, before = digest(values).split(), kept.split()
    return "equal" if now == before else "text differs" if now[0] == before[0] else "values differ"


def differences(before: Values, now: Values) -> list[tuple[str, Any, Any, float]]:
    """Return path, both values and relative change of each difference. A change of text is infinite.

    The change of a number is relative to the largest number of its list. Outside a list it is relative to the number.
    """
    old, new = dict(leaves(before)), dict(leaves(now))
    sizes: dict[str, float] = {}
    for path, value in (*old.items(), *new.items()):
        if isinstance(value, int | float) and math.isfinite(value):
            sizes[INDEX.sub("", path)] = max(sizes.get(INDEX.sub("", path), ZERO), abs(value))
    found = []
    for path in dict.fromkeys((*old, *new)):
        one, other = old.get(path, "absent"), new.get(path, "absent")
        if rounded(one) != rounded(other):
            numbers = all(isinstance(each, int | float) and math.isfinite(each) for each in (one, other))
            found.append((path, one, other, abs(one - other) / sizes[INDEX.sub("", path)] if numbers else math.inf))
    return found


def compared(before: Values | None, now: Values | None) -> str:
    """Return the result of comparing a row with another revision, and its largest change, as text."""
    result = outcome(now, None if before is None else digest(before), True)
    if before is None or now is None or "differ" not in result:
        return result
    found = differences(before, now)
    text = next((f"; {path}: {one} -> {other}" for path, one, other, change in found if change == math.inf), "")
    path, *_, change = max((each for each in found if each[3] < math.inf), key=lambda each: each[3], default=("", 0.0))
    largest = f"; largest relative change {change:.2g} at {path}" if path else ""
    return f"{result}: {len(found)} of {len(list(leaves(now)))}{largest}{text[:200]}"


def chosen(options: argparse.Namespace) -> dict[str, Job]:
    """Return the job of each row that the options select."""
    rows = {row: job for job in jobs() for row in job.rows if row.startswith(options.part) and options.only in row}
    rows = {row: job for row, job in rows.items() if options.show in (None, row)}
    rows = {row: job for row, job in rows.items() if not options.quick or re.search(QUICK, row)}
    if not rows:
        raise UsageError(f"no row '{options.show or options.only}'; tools/pins.json lists all rows")
    return rows


def run(rows: Mapping[str, Job], processes: int) -> dict[str, Values | None]:
    """Run the jobs of the rows and return the values of the rows."""
    found: dict[str, Values | None] = {}
    for done in command.parallel(Job.__call__, list(dict.fromkeys(rows.values())), processes):
        found |= {row: values for row, values in done.items() if row in rows}
        if sys.stderr.isatty():
            print(f"\r{len(found)} of {len(rows)} rows", end="\r", file=sys.stderr)
    return found


def reference(revision: str, processes: int, selection: list[str]) -> dict[str, Values | None]:
    """Run the selected rows with the package and configuration of a revision in a worktree, and return their values."""

    PLACE.parent.mkdir(parents=True, exist_ok=True)
    with PLACE.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        worktree(revision, PLACE, ("tools", "tests/blind"))  # use the cases of the present revision
        values = PLACE.with_suffix(".json")
        call = [sys.executable, str(PLACE / "tools"), "pins", *selection, "--processes", str(processes)]
        environment = {**os.environ, "TSA_DATA": str(data())}
        done = subprocess.run([*call, "--values", str(values)], cwd=PLACE, env=environment, check=False)
        if done.returncode != 0:
            raise UsageError(f"--against {revision}: the rows did not run there")
        found: dict[str, Values | None] = json.loads(values.read_text(encoding="utf-8"))
    return found


def write(values: Mapping[str, Values | None], whole: bool) -> int:
    """Write the digests of the rows, and remove digests whose case or measured data are missing."""
    kept = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() and not whole else {"rows": {}}
    if not whole and kept.get("machine") != machine():
        raise UsageError("the other digests are of other versions; --write all rows, or none")
    rows = kept["rows"] | {row: digest(value) for row, value in values.items() if value is not None}
    known = {row for job in jobs() for row in job.rows if values.get(row, {}) is not None}
    rows = {row: rows[row] for row in sorted(rows.keys() & known)}
    settings.write_text(FILE, json.dumps({"machine": machine(), "rows": rows}, indent=0) + "\n")
    print(f"{sum(value is not None for value in values.values())} of {len(values)} digests written")
    return 0


def report(results: Mapping[str, str]) -> int:
    """Print the rows that are not equal, and the totals. Return 1 if a row differs."""
    for row, result in sorted(results.items()):
        if result != "equal":
            print(f"{row}: {result}")
    counts = Counter(result.partition(": ")[0] for result in results.values())
    print(f"{len(results)} rows: {', '.join(f'{count} {name}' for name, count in counts.items())}")
    return 1 if any("differ" in result for result in counts) else 0


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--part", choices=("a", "b", "c"), default="", help="a: diagnosis, b: loop, c: commands")
    parser.add_argument("--only", default="", metavar="TEXT", help="rows with TEXT in their name")
    parser.add_argument("--quick", action="store_true", help="only some fast rows")
    parser.add_argument("--processes", type=int, default=2, choices=range(1, command.MOST_PROCESSES + 1))
    parser.add_argument("--write", action="store_true", help="write the digests of these rows")
    parser.add_argument("--against", metavar="REV", help="another revision, on which the same rows are run")
    parser.add_argument("--show", metavar="ROW", help="print both values of each difference of a row")
    parser.add_argument("--values", type=Path, metavar="FILE", help="only write the values of these rows, as JSON")
    options = parser.parse_args()
    rows = chosen(options)
    if options.show and not options.against:
        log = ["git", "-C", str(command.ROOT), "log", "-1", "--format=%H", "--", str(FILE)]
        options.against = subprocess.run(log, capture_output=True, text=True, check=True).stdout.strip()
    values = run(rows, options.processes)
    if options.values:
        settings.write_text(options.values, json.dumps(values))
        return 0
    if options.write:
        return write(values, whole=not (options.part or options.only or options.quick or options.show))
    if not options.against:
        kept = json.loads(FILE.read_text(encoding="utf-8"))
        same = kept["machine"] == machine()
        return report({row: outcome(value, kept["rows"].get(row), same) for row, value in values.items()})
    selection = [f"--{name}={value}" for name in ("part", "only", "show") if (value := getattr(options, name))]
    others = reference(options.against, options.processes, [*selection, *["--quick"] * options.quick])
    if options.show:
        for path, one, other, change in differences(others[options.show] or {}, values[options.show] or {}):
            print(f"{path}: {one} -> {other}" + (f", relative change {change:.2g}" if change < math.inf else ""))
    return report({row: compared(others[row], value) for row, value in values.items()})
