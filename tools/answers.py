"""Commands of users, run as they stand, and what they print that matters: tables of what once went wrong."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tools import command

LONGEST = 600.0  # s: none of these takes a third of it; one that hangs ends the table


@dataclass(frozen=True)
class Case:
    """What once went wrong, the command that shows it, and the pattern of those of its lines that matter."""

    number: int
    found: str
    line: str  # of a shell
    shown: str


def asked(module: str, doc: str | None, cases: Sequence[Case]) -> list[Case]:
    """Those of the cases that the command line of a tool asks for by number; all of them by default."""
    parser = command.parser(module, doc)
    known = sorted({case.number for case in cases})
    parser.add_argument("--only", type=int, nargs="+", choices=known, metavar="NUMBER", help="these rows")
    only = parser.parse_args().only
    return [case for case in cases if only is None or case.number in only]


def said(case: Case, place: Path) -> str:
    """What the command prints in that folder that matters; SystemExit where it has no answer, or another one."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    run = subprocess.run(
        ["bash", "-c", case.line],
        cwd=place,
        env={**os.environ, "PATH": path, "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
        timeout=LONGEST,
    )
    if run.returncode not in (0, 1, 2) or "Traceback" in run.stderr:
        raise SystemExit(f"{case.line}: exit status {run.returncode}: {run.stderr[-2000:]}")
    lines = [line.strip() for line in (run.stdout + run.stderr).splitlines() if re.search(case.shown, line)]
    if not lines:
        raise SystemExit(f"{case.line}: nothing of '{case.shown}' in what it printed: {run.stdout}{run.stderr}")
    return " ".join(dict.fromkeys(lines))


def rows(place: Path, cases: Sequence[Case]) -> list[tuple[str, ...]]:
    """A line each: number, what was found, the command, what it says now."""
    return [(str(each.number), each.found, f"`{each.line}`", said(each, place)) for each in cases]


def show(lines: Sequence[tuple[str, ...]]) -> None:
    """Print them as a table that `manual/tables` reads: one without the lines of other tables in its cells."""
    table = Table("row", "found once", "command", "says now")
    for line in lines:
        table.add_row(*(Text(" ".join(re.sub("[│┃]", " ", cell).replace("|", "¦").split())) for cell in line))
    Console(width=4000).print(table)
