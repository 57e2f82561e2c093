"""Take a table that a benchmark of hours printed into the manual, with date, commit and command.

Usage: tools/run manual/tables NAME [FILE]      (tools/run manual/tables alone lists the names and their commands)

Reads the table from FILE, or from standard input, as the command prints it: lines with `|`, or the lines of a drawn
table, or columns apart by two blanks. Writes `tools/manual/tables.json`; the pages follow by `tools/run manual/write`.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tools import command
from tools.manual import measure
from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError

FILE = Path(__file__).with_name("tables.json")
COMMANDS: Mapping[str, str] = {
    "coverage": "tools/run bench/calibrate --logs 7000",
    "stretch": "tools/run measured/stretch",
    "stretch-rigs": "tools/run bench/stretch --rigs 30 --seed 2",
    "blind": "tools/run bench/diagnose --short --seed 8000",
    "runaway": "tools/run campaign/runaway changes --sensors sensor --rows FILE",
    "runaway-missed": "tools/run campaign/runaway changes --sensors sensor --rows FILE --which",
    "healthy": "tools/run campaign/runaway healthy --rows FILE",
    "two-encoders": "tools/run bench/two_encoders --by-row --draws 1",
    "control": "tools/run bench/control --rows FILE --brief",
    "checks": "tools/run bench/checks --sensors encoder --set-points sine",
    "checks-sensor": "tools/run bench/checks --sensors sensor --set-points sine",
    "trend": "tools/run bench/trend",
    "client": "tools/run bench/client --seconds 15",
    "circle": "tools/vcan tools/run bench/circle --seconds 14",
}
Row = dict[str, Any]


def load() -> dict[str, Row]:
    """Every table by name: `head` and `rows` of cells, `command`, `date`, `commit`."""
    found: dict[str, Row] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def cells(text: str) -> list[list[str]]:
    """The rows of the first table in what was printed, its head first; rules between rows are none."""
    found: list[list[str]] = []
    for line in text.splitlines():
        drawn = re.split(r"[|│┃]", line.strip())
        row = drawn[1:-1] if len(drawn) > 2 else re.split(r"\s{2,}", line.strip())
        row = [cell.strip() for cell in row]
        if re.fullmatch(r"[\s┏━┳┓┡╇┩└─┴┘├┼┤|:-]*", line) and (line.strip() or not found):
            continue
        if found and len(row) != len(found[0]):
            break
        if len(row) > 1:
            found.append(row)
    return found


def taken(name: str, text: str) -> Row:
    """The table of a name from what its command printed; raises UsageError where there is none."""
    rows = cells(text)
    if len(rows) < 2:
        raise UsageError(f"no table in what was read for '{name}'; give what {COMMANDS[name]} prints")
    return {"head": rows[0], "rows": rows[1:], "command": COMMANDS[name], **measure.here()}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("name", nargs="?", help="of the table")
    parser.add_argument("file", nargs="?", type=Path, help="what its command printed; default standard input")
    asked = parser.parse_args(arguments)
    if asked.name is None:
        for name, line in COMMANDS.items():
            print(f"{name:14s} {line}")
        return 0
    if asked.name not in COMMANDS:
        raise UsageError(f"no table '{asked.name}'; known are {', '.join(COMMANDS)}")
    text = asked.file.read_text(encoding="utf-8") if asked.file else sys.stdin.read()
    found, row = load(), taken(asked.name, text)
    settings.write_text(FILE, json.dumps({**found, asked.name: row}, indent=1, ensure_ascii=False) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
