"""What half and double of a threshold of the diagnosis do: hidden logs on which it names something else.

Usage: tools/run bench/constants NAME ... [--cases 12] [--seed 7000] [--out FILE.jsonl] [--list]

NAME is a module below tsa_ctrl/identify and a constant in it, as diagnosis.selection.entry.BLOCK_T; a module alone
stands for all of its numbers. The logs are blind ones (tests/blind), short, of all families in turn and the same for
every value; each is diagnosed with the number as it is, halved and doubled (whole numbers stay whole; of a pair all are
changed alike). A row says of how many logs the answer was right, and on how many it was another than with the number as
it is. Rows are kept in --out, by what was asked and the code's version, and not made again.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tests.blind import case
from tests.blind.score import mark
from tools import command
from tools.bench.diagnose import SILENT, Job, ask, code_version, jobs
from tools.bench.results import Results, Row

ROOT = "tsa_ctrl.identify"
FACTORS = {"half": 0.5, "as it is": 1.0, "double": 2.0}
COUNTS = {"none": 1, "single": 1, "pair": 1, "outside": 1, "rigid": 1, "hidden_direction": 1}  # of each name
FILE = command.ROOT / "tools" / "manual" / "constants.jsonl"
RIGHT = {"single": "unique", "pair": "both", "outside": "flagged", "rigid": "unique"}


@dataclass(frozen=True)
class Constant:
    """A number, or several, at the head of a module."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module.removeprefix(ROOT + '.')}.{self.name}"

    @property
    def value(self) -> Any:
        return getattr(importlib.import_module(self.module), self.name)


def constants_in(path: Path) -> list[str]:
    """Names in capitals at the head of a module that hold numbers, none of them a truth value or a text."""
    names = []
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        target = statement.targets[0] if isinstance(statement, ast.Assign) else getattr(statement, "target", None)
        value = getattr(statement, "value", None)
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or target is None or value is None:
            continue
        numbers = [each.value for each in ast.walk(value) if isinstance(each, ast.Constant)]
        if any(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
            names += [each.id for each in ast.walk(target) if isinstance(each, ast.Name) and each.id.isupper()]
    return names


def asked_for(text: str) -> list[Constant]:
    """The constants that a name stands for. Raises SystemExit where there is none."""
    folder = command.ROOT / ROOT.replace(".", "/")
    parts = text.split(".")
    for cut, chosen in ((len(parts), None), (len(parts) - 1, parts[-1])):
        path = folder.joinpath(*parts[:cut]).with_suffix(".py")
        if cut and path.is_file():
            module = ".".join([ROOT, *parts[:cut]])
            names = [name for name in constants_in(path) if chosen in (None, name)]
            if names:
                return [Constant(module, name) for name in names]
    raise SystemExit(
        f"tools/run bench/constants: {text}: no number of that name; name one as selection/entry.py has it"
    )


def scaled(value: Any, factor: float) -> Any:
    """The number, or each of a tuple, times a factor; whole ones stay whole, and above 0. TypeError for others."""
    if isinstance(value, tuple):
        return tuple(scaled(each, factor) for each in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    return max(1, round(value * factor)) if isinstance(value, int) and value > 0 else value * factor


@contextmanager
def changed(constant: Constant, factor: float) -> Iterator[None]:
    """The constant scaled in its module and in those that import it from there."""
    new, users = scaled(constant.value, factor), []
    for name, module in list(sys.modules.items()):
        if name == constant.module or (name.startswith(ROOT) and _imports(module, constant)):
            users.append((module, getattr(module, constant.name)))
            setattr(module, constant.name, new)
    try:
        yield
    finally:
        for module, old in users:
            setattr(module, constant.name, old)


def _imports(module: Any, constant: Constant) -> bool:
    path = getattr(module, "__file__", None)
    if path is None or not hasattr(module, constant.name):
        return False
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    found = [each for each in tree.body if isinstance(each, ast.ImportFrom) and each.module == constant.module]
    return any(alias.name == constant.name for each in found for alias in each.names)


def answers(queue: list[Job]) -> list[tuple[bool, Any]]:
    """Of each hidden log whether the answer is right, and what was named."""
    out = []
    for job in queue:
        hidden = case(*job)
        try:
            report, _ = ask(hidden.logs, hidden.model)
        except Exception:  # a number that breaks the diagnosis is wrong
            report = dict(SILENT)
        marks = mark(hidden, report).as_dict()
        family = job[0]
        right = bool(marks[RIGHT[family]]) if family in RIGHT and hidden.truth.effects else not marks["named"]
        right = bool(marks["flagged"]) and not marks["wrong"] if hidden.truth.outside else right
        out.append((right, [[cause["effect"], sorted(cause["alternatives"])] for cause in report["causes"]]))
    return out


def main() -> int:
    """Run what is asked and not known yet, and print the table."""
    parser = command.parser(__name__, __doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--seed", type=int, default=7000)
    parser.add_argument("--out", type=Path, default=FILE)
    parser.add_argument("--list", action="store_true", help="only print the table of what is in --out")
    asked = parser.parse_args()
    every = list(jobs(COUNTS, [], asked.seed, True))
    queue = every[:: max(1, len(every) // asked.cases)][: asked.cases]
    results = Results(asked.out, lambda row: (row["constant"], row["factor"], row["cases"], row["seed"]))
    constants = [each for text in asked.names for each in asked_for(text)]
    version, base = code_version(), None
    for constant in () if asked.list else constants:
        for word, factor in FACTORS.items():
            key = (str(constant), factor, len(queue), asked.seed)
            if factor == 1.0 or (key in results and results[key]["version"] == version):
                continue
            base = answers(queue) if base is None else base
            try:
                with changed(constant, factor):
                    told = answers(queue)
            except TypeError:
                print(f"{constant}: no number, left out", file=sys.stderr)
                break
            row: Row = dict(zip(("constant", "factor", "cases", "seed"), key, strict=True))
            row |= {"right": sum(right for right, _ in told), "right_as_is": sum(right for right, _ in base)}
            row |= {"others": sum(a != b for a, b in zip(told, base, strict=True)), "version": version}
            results.add(row)
            print(f"{constant} {word}: {row['right']} of {len(queue)} right, {row['others']} others", file=sys.stderr)
    shown = Table("constant", "as it is", "half", "double")
    for constant in constants:
        rows = {
            factor: results[key]
            for factor in (0.5, 2.0)
            if (key := (str(constant), factor, len(queue), asked.seed)) in results
        }
        if rows:
            first = next(iter(rows.values()))
            cells = [f"{row['right']}, {row['others']} changed" for row in rows.values()]
            shown.add_row(str(constant), f"{first['right_as_is']} of {first['cases']} right", *cells)
    Console(width=None if sys.stdout.isatty() else 120).print(shown)
    return 0
