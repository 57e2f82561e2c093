"""Run what the manual quotes and write it down, with date, commit and machine: the one writer of its figures.

Usage: tools/run manual/measure [NAME ...] [--long] [--runs N] [--list]

Writes `tools/manual/figures.json`; the tables of tools/README.md follow from it by `tools/run manual/write`. Without
names all are run, those that take minutes with --long alone. What is deterministic is run once, the rest `--runs` times
(default 3): median, lowest and highest.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any

from tools import command
from tools.manual.measures import MEASURES, TSA, Measure
from tsa_ctrl import settings

FILE = Path(__file__).with_name("figures.json")
Row = dict[str, Any]


def measured(measure: Measure, runs: int, out: Path) -> Row:
    """Run it; raises ValueError with what was printed where the figure is not in it."""
    values = []
    out /= re.sub(r"\W+", "-", _spoken(measure.line))  # one of its own, and the same for all that read this command
    line = tuple(word.format(out=out, config=command.CONFIG, root=command.ROOT) for word in measure.line)
    for number in range(1 if measure.deterministic else runs):
        printed, seconds = _printed(line, number)
        value = measure.read(printed)
        values.append(value / seconds if measure.per_second else value)
    return {
        "value": statistics.median(values),
        "low": min(values),
        "high": max(values),
        "unit": measure.unit,
        "runs": len(values),
        "command": _spoken(measure.line),
        "words": measure.words,
        **here(),
    }


def note(name: str, words: str, values: list[float], unit: str, line: str) -> None:
    """Keep a figure that a tool found by itself: median, lowest and highest of its values; `line`: what prints it."""
    row = {
        "value": statistics.median(values),
        "low": min(values),
        "high": max(values),
        "unit": unit,
        "runs": len(values),
        "command": line,
        "words": words,
        **here(),
    }
    settings.write_text(FILE, json.dumps(dict(sorted({**load(), name: row}.items())), indent=1) + "\n")


def here() -> Row:
    """When, of what and where a figure is."""
    return {
        "date": datetime.date.today().isoformat(),
        "commit": _commit(),
        "machine": f"{os.cpu_count()} processors, {platform.machine()}, Python {platform.python_version()}",
    }


@cache
def _printed(line: tuple[str, ...], number: int) -> tuple[str, float]:
    """What a command prints, and how long it took, s; once for all figures that read the same run."""
    began = time.monotonic()
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ValueError(f"exit status {done.returncode}: {(done.stderr or done.stdout).strip()[-300:]}")
    return done.stdout, time.monotonic() - began


def _spoken(line: tuple[str, ...]) -> str:
    """The command as a reader types it."""
    text = " ".join("tsa" if word == TSA else f"'{word}'" if "(" in word else word for word in line)
    for placed, said in ((" --out {out}", ""), (" --json", ""), ("{root}/", ""), ("{config}", "config")):
        text = text.replace(placed, said)
    return text


def _commit() -> str:
    return subprocess.run(
        ["git", "-C", str(command.ROOT), "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()


def load() -> dict[str, Row]:
    """What was measured, by name; empty before the first time."""
    found: dict[str, Row] = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
    return found


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("names", nargs="*", help="figures; default all")
    parser.add_argument("--runs", type=int, default=3, help="of what is not deterministic")
    parser.add_argument("--long", action="store_true", help="those that take minutes, too")
    parser.add_argument("--list", action="store_true", help="names only")
    arguments = parser.parse_args()
    known = {measure.name: measure for measure in MEASURES}
    if arguments.list:
        print("\n".join(known))
        return 0
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        print(f"tools/run manual/measure: unknown figure '{unknown[0]}'; known are {', '.join(known)}", file=sys.stderr)
        return 2
    rows, failed = load(), 0
    names = arguments.names or [name for name in known if arguments.long or not known[name].long]
    with tempfile.TemporaryDirectory() as out:
        for name in names:
            try:
                rows[name] = measured(known[name], arguments.runs, Path(out))
            except ValueError as error:
                failed += 1
                print(f"{name}: not measured: {error}", file=sys.stderr)
                continue
            row = rows[name]
            print(f"{name}: {row['value']:.4g} {row['unit']} ({row['low']:.4g} to {row['high']:.4g})", flush=True)
            settings.write_text(FILE, json.dumps(dict(sorted(rows.items())), indent=1) + "\n")
    return int(failed > 0)
