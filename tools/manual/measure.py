"""Run what the manual quotes and write it down, with date, commit and machine: the one writer of its figures.

Usage: tools/run manual/measure [NAME ...] [--runs N] [--list]

Writes `tools/manual/figures.json`; the tables of tools/README.md follow from it by `tools/run manual/write`. Without
names all are run. What is deterministic is run once, the rest `--runs` times (default 3): median, lowest and highest.
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
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tools import command
from tsa_ctrl import settings

FILE = Path(__file__).with_name("figures.json")
TSA = str(Path(sys.executable).with_name("tsa"))
Row = dict[str, Any]


@dataclass(frozen=True)
class Measure:
    """A figure: what it is, the command that prints it, and how it is read from what that prints."""

    name: str
    words: str
    line: tuple[str, ...]
    read: Callable[[str], float]
    unit: str
    deterministic: bool = False  # in virtual time: the same command gives the same figure


def _json(*path: str | int, factor: float = 1.0) -> Callable[[str], float]:
    def read(text: str) -> float:
        found: Any = json.loads(text)
        for key in path:
            found = found[key]
        return factor * float(found)

    return read


def _found(pattern: str, factor: float = 1.0) -> Callable[[str], float]:
    def read(text: str) -> float:
        match = re.search(pattern, text)
        if match is None:
            raise ValueError(f"'{pattern}' is not in what was printed")
        return factor * float(match[1].replace(",", ""))

    return read


def _demo(load: str) -> tuple[str, ...]:
    return (TSA, "demo", "--virtual", "--load", load, "--json", "--out", "{out}")


LOADS = ("imposed", "held", "spring", "weight", "free", "limb", "wearer")
MEASURES: tuple[Measure, ...] = (
    *(
        Measure(
            f"demo-{load}",
            f"demo, joint {load}: error of the joint torque less than without compensation",
            _demo(load),
            _json("reduction_percent"),
            "%",
            deterministic=True,
        )
        for load in LOADS
    ),
    *(
        Measure(
            f"first-{name}",
            f"first ten minutes, a bare Python 3.11 and the wheel alone: {words}",
            ("{root}/tools/run", "package/check", "--python", "python3.11"),
            _found(rf"{pattern}\s+0\s+([0-9.]+) s"),
            "s",
        )
        for name, words, pattern in (
            ("install", "pip install", "pip install"),
            ("picture", "first picture, functions compiled in it", r"tsa demo --virtual\b.*?"),
            ("example", "an example log made and diagnosed", r"tsa diagnose --example\b.*?"),
        )
    ),
    Measure(
        "virtual-speed",
        "virtual time of `tsa simulate-loop` with the example files, over real time",
        (TSA, "simulate-loop", "{config}/controller.toml", "{config}/plant.toml", "--seconds", "20", "--json"),
        lambda text: 20.0,
        "times",
    ),
    Measure(
        "demo-vcan",
        "demo on a real vcan at 1 kHz: error less than without compensation",
        ("{root}/tools/demo", "--json", "--out", "{out}"),
        _json("reduction_percent"),
        "%",
    ),
)


def measured(measure: Measure, runs: int, out: Path) -> Row:
    """Run it; raises ValueError with what was printed where the figure is not in it."""
    values = []
    line = tuple(word.format(out=out, config=command.CONFIG, root=command.ROOT) for word in measure.line)
    for number in range(1 if measure.deterministic else runs):
        printed, seconds = _printed(line, number)
        value = measure.read(printed)
        values.append(value / seconds if measure.unit == "times" else value)
    return {
        "value": statistics.median(values),
        "low": min(values),
        "high": max(values),
        "unit": measure.unit,
        "runs": len(values),
        "command": _spoken(measure.line),
        "words": measure.words,
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
    text = " ".join("tsa" if word == TSA else word for word in line)
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
    for name in arguments.names or known:
        with tempfile.TemporaryDirectory() as out:
            try:
                rows[name] = measured(known[name], arguments.runs, Path(out))
            except ValueError as error:
                failed += 1
                print(f"{name}: not measured: {error}", file=sys.stderr)
                continue
        row = rows[name]
        print(f"{name}: {row['value']:.4g} {row['unit']} ({row['low']:.4g} to {row['high']:.4g})")
        settings.write_text(FILE, json.dumps(dict(sorted(rows.items())), indent=1) + "\n")
    return int(failed > 0)
