"""Run the commands that the manual quotes, and write its figures and tables with date, commit and machine.

Usage: tools/run manual/measure [NAME ...] [--long] [--runs N] [--list]
       tools/run manual/measure TABLE --printed FILE

`tools/manual/figures.toml` lists the figures and tables with their commands. Without names, the command measures the
figures that take seconds. With --long it measures all figures and tables, which takes hours. A deterministic figure is
measured once. Any other figure is measured `--runs` times and has median, lowest and highest value. A table is read
from the output of its command, or from a file with --printed. Finally, the command writes the pages like `tools/run
manual/write`.
"""

from __future__ import annotations

import json
import re
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
import tomllib
from functools import cache
from pathlib import Path

from tools import command
from tools.command import Row
from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError

FOLDER = Path(__file__).parent
FIGURES, TABLES = FOLDER / "figures.json", FOLDER / "tables.json"
SIMULATED = 20.0  # s of virtual time in a run whose speed is the figure


@cache
def listed() -> dict[str, Row]:
    """Return the figures by name, and the commands of the tables by name."""
    found: dict[str, Row] = tomllib.loads((FOLDER / "figures.toml").read_text(encoding="utf-8"))
    return found


def load(path: Path) -> dict[str, Row]:
    """Return the measured figures or tables by name."""
    found: dict[str, Row] = json.loads(path.read_text(encoding="utf-8"))
    return found


def keep(path: Path, name: str, row: Row) -> None:
    """Write a figure or a table."""
    row = {**row, **command.here()}
    rows = dict(sorted({**load(path), name: row}.items()))
    settings.write_text(path, json.dumps(rows, indent=1, ensure_ascii=False) + "\n")


def figure(name: str, runs: int, out: Path) -> Row:
    """Run the command of a figure, and return the figure.

    Raises:
        ValueError: The command failed, or its output does not contain the figure.
    """
    given, values = listed()["figures"][name], []
    run = given["run"]
    for number in range(1 if run.get("once") else runs):
        printed, seconds = _printed(run["command"], number, out)
        match = re.search(run.get("read", "()"), printed, re.MULTILINE)
        if match is None:
            raise ValueError(f"'{run['read']}' is not in the output")
        values.append(float(match[1].replace(",", "")) if "read" in run else SIMULATED / seconds)
    return {
        "value": statistics.median(values),
        "low": min(values),
        "high": max(values),
        "unit": run["unit"],
        "runs": len(values),
        "command": run["command"].replace(" --json", "").replace(" --out {out}", ""),
        "words": given["words"],
    }


@cache
def _printed(line: str, number: int, out: Path) -> tuple[str, float]:
    """Return output and duration (s) of a command. Figures that share a run use its cached output."""
    words = shlex.split(line.format(out=out / re.sub(r"\W+", "-", line)).replace("FILE", str(out / "rows.jsonl")))
    if words[0] == "tsa":
        words[0] = str(Path(sys.executable).with_name("tsa"))
    began = time.monotonic()
    done = subprocess.run(words, cwd=command.ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ValueError(f"exit status {done.returncode}: {(done.stderr or done.stdout).strip()[-300:]}")
    return done.stdout, time.monotonic() - began


def table(name: str, text: str) -> Row:
    """Return the first table in an output: lines with `|`, a drawn table, or columns separated by two spaces.

    [titles] names a later table of the output by the line above it.

    Raises:
        UsageError: The output has no table, or none of this title.
    """
    rows: list[list[str]] = []
    if title := listed()["titles"].get(name):
        _, _, text = re.sub(rf"^{re.escape(title)} *$", "\f", text, count=1, flags=re.MULTILINE).partition("\f")
    for line in text.splitlines():
        drawn = re.split(r"[|│┃]", line.strip())
        row = [cell.strip() for cell in (drawn[1:-1] if len(drawn) > 2 else re.split(r"\s{2,}", line.strip()))]
        if re.fullmatch(r"[\s┏━┳┓┡╇┩└─┴┘├┼┤|:-]*", line) and (line.strip() or not rows):
            continue
        if rows and len(row) != len(rows[0]):
            break
        if len(row) > 1:
            rows.append(row)
    if len(rows) < 2:
        raise UsageError(f"no table in the output for '{name}'; give the output of {listed()['tables'][name]}")
    return {"head": rows[0], "rows": rows[1:], "command": listed()["tables"][name]}


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("names", nargs="*", help="figures and tables; default all figures")
    parser.add_argument("--runs", type=int, default=3, help="of a figure that is not deterministic (default 3)")
    parser.add_argument("--long", action="store_true", help="also the tables, and the figures that take minutes")
    parser.add_argument("--printed", type=Path, metavar="FILE", help="output of the table's command")
    parser.add_argument("--list", action="store_true", help="only print names and commands")
    arguments = parser.parse_args()
    figures, tables = listed()["figures"], listed()["tables"]
    if arguments.list:
        rows = [(name, each["run"]["command"]) for name, each in figures.items()]
        command.print_table(("figure or table", "command"), [*rows, *tables.items()])
        return 0
    if unknown := [name for name in arguments.names if name not in figures and name not in tables]:
        raise UsageError(f"no figure or table '{unknown[0]}'; available: {', '.join([*figures, *tables])}")
    quick = [name for name in figures if not figures[name]["run"].get("long")]
    names = arguments.names or ([*figures, *tables] if arguments.long else quick)
    failed = 0
    with tempfile.TemporaryDirectory() as out:
        for name in names:
            try:
                if name in tables:
                    file = arguments.printed
                    keep(
                        TABLES, name, table(name, file.read_text() if file else _printed(tables[name], 0, Path(out))[0])
                    )
                    continue
                row = figure(name, arguments.runs, Path(out))
            except ValueError as error:
                failed += 1
                print(f"{name}: not measured: {error}", file=sys.stderr)
                continue
            keep(FIGURES, name, row)
            print(f"{name}: {row['value']:.4g} {row['unit']} ({row['low']:.4g} to {row['high']:.4g})", flush=True)
    from tools.manual.write import write_pages  # imported here, because its parts import this module

    write_pages()
    return int(failed > 0)
