"""What half and double of a threshold of the diagnosis do: hidden logs on which it says something else.

Usage: tools/run bench/constants [NAME ...] [--seed 7000] [--until HH:MM] [--out FILE.jsonl] [--list]

NAME is a module below tsa_ctrl/identify and a constant in it, as diagnosis.selection.entry.BLOCK_T; a module alone
stands for all of its numbers; without any those that decide are asked. The logs are twelve blind ones (tests/blind),
short, of every family and the same for every value; where an effect is hidden, the weakest of ten draws, since that is
where thresholds decide. Each is diagnosed with the number as it is, halved and doubled (whole numbers stay whole; of a
pair all are changed alike; what is made of a number at import, as ASIDE of MOST_SPREAD, stays: it is a number of its
own). A row says of how many logs the answer was right, on which it named something else than with the number as it is,
and on how many anything in the report was another. Rows are kept in --out (default: the file that the manual's table is
written from), and not made again unless the code is another: comments do not count.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import json
import pkgutil
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tests.blind import FAMILIES, Case, case
from tests.blind.score import mark
from tools import command
from tools.bench.diagnose import SILENT, ask
from tools.bench.results import Results, Row, read_rows
from tools.manual.measure import here

ROOT = "tsa_ctrl.identify"
FACTORS = {"half": 0.5, "double": 2.0}
COUNTS = {"none": 1, "hidden_direction": 1, "single": 3, "pair": 2, "outside": 2, "confounded": 1, "rigid": 2}
DRAWN = 10  # seeds, of which the one with the weakest effect is taken
SHOWN = 3  # names of hidden causes in a cell of the table, before only their number is said
FILE = command.ROOT / "tools" / "manual" / "constants.jsonl"
RIGHT = {"single": "unique", "pair": "both", "outside": "flagged", "confounded": "grouped", "rigid": "unique"}
CODE = ("tsa_ctrl/identify", "tsa_ctrl/model", "tests/blind")
DECIDING = tuple(  # in the order in which they are asked
    f"diagnosis.{module}"
    for module in (
        *("selection.entry", "selection.forward", "selection.meaning", "selection.step", "selection.detection_limits"),
        *("rivals.groups", "rivals.alternatives", "rivals.elsewhere", "residual.structure", "fitting.noise_model"),
        *("parameters.held_out", "parameters.transfer", "parameters.instead", "parameters.formula", "refusals"),
        *("residual.dependence", "residual.changes", "residual.features", "parameters.refit", "parameters.proportion"),
        *("data.audit", "data.split", "data.direction", "noise.nuisance", "noise.autoregressive", "fitting.score_test"),
        *("fitting.fit", "data.denoise", "data.gross_motion", "data.prepare", "data.frame", "hypotheses.base"),
    )
)
NO_CHOICE = ("SHRINK", "SINGULAR", "TRIAL", "AT_BOUND", "RIDGE")  # of geometry and of rounding: nothing is decided


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
    return [name for name in names if name not in NO_CHOICE]


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
    """The constant scaled in its module, in those that import it from there, and in defaults of their functions."""
    old, new = constant.value, scaled(constant.value, factor)
    users = [module for name, module in list(sys.modules.items()) if _uses(name, module, constant)]
    defaults = [(each, each.__defaults__) for module in users for each in _defaulting(module, constant)]
    for module in users:
        setattr(module, constant.name, new)
    for function, values in defaults:
        function.__defaults__ = tuple(new if each is old else each for each in values)
    try:
        yield
    finally:
        for module in users:
            setattr(module, constant.name, old)
        for function, values in defaults:
            function.__defaults__ = values


def _uses(name: str, module: Any, constant: Constant) -> bool:
    if not name.startswith(ROOT) or not hasattr(module, constant.name):
        return False
    found = [each for each in _tree(module).body if isinstance(each, ast.ImportFrom) and each.module == constant.module]
    return name == constant.module or any(alias.name == constant.name for each in found for alias in each.names)


def _tree(module: Any) -> ast.Module:
    return ast.parse(Path(module.__file__).read_text(encoding="utf-8"))


def _defaulting(module: Any, constant: Constant) -> list[Any]:
    """The functions of a module of which a default argument is the constant."""
    functions = [each for each in _tree(module).body if isinstance(each, ast.FunctionDef)]
    by = {each.name: [part.id for part in each.args.defaults if isinstance(part, ast.Name)] for each in functions}
    return [getattr(module, name) for name, defaults in by.items() if constant.name in defaults]


def import_all() -> None:
    """Every module that may use a constant: one that is imported while it is changed would keep what it found."""
    root = importlib.import_module(ROOT)
    for module in pkgutil.walk_packages(root.__path__, f"{ROOT}."):
        importlib.import_module(module.name)


def version() -> str:
    """Changes with the code of what is tested and of what tests it; not with a comment."""
    digest = hashlib.sha256()
    for path in sorted(path for folder in CODE for path in (command.ROOT / folder).rglob("*.py")):
        if not path.name.startswith("test_"):
            digest.update(ast.dump(ast.parse(path.read_text(encoding="utf-8"))).encode())
    return digest.hexdigest()[:12]


def draw(seed: int) -> list[Case]:
    """The twelve: names of a family at even distances, of each the weakest draw; of two of one name the two weakest."""
    found = []
    for family, count in COUNTS.items():
        names = [FAMILIES[family][k * len(FAMILIES[family]) // count] for k in range(count)]
        for name in dict.fromkeys(names):
            seeds = range(seed, seed + (DRAWN if family in RIGHT else 1))
            drawn = [case(family, name, each, True) for each in seeds]
            found += sorted(drawn, key=lambda each: each.truth.size / each.truth.noise)[: names.count(name)]
    return found


def spoken(hidden: Case) -> str:
    """What is hidden in it: its effects, the cause outside the catalogue, or its family."""
    inside = " and ".join(sorted(hidden.truth.effects))
    return f"{hidden.truth.outside or inside or 'nothing'} ({hidden.family})"


def answers(cases: Sequence[Case]) -> list[Row]:
    """Of each hidden log whether the answer is right, what was named, and a digest of all that was said."""
    out = []
    for hidden in cases:
        before = time.process_time()
        try:
            report, _ = ask(hidden.logs, hidden.model)
        except Exception as problem:  # a number that breaks the diagnosis is wrong
            report = {**SILENT, "error": type(problem).__name__}
        marks = mark(hidden, report).as_dict()
        asked = RIGHT.get(hidden.family) if hidden.truth.effects or hidden.truth.outside else None
        right = not marks["named"] if asked is None else bool(marks[asked]) and not marks["wrong"]
        named = sorted([cause["effect"], *sorted(cause["alternatives"])] for cause in report["causes"])
        said = hashlib.sha256(json.dumps(report, sort_keys=True).encode()).hexdigest()[:12]
        seconds = round(time.process_time() - before, 2)
        out.append({"hidden": spoken(hidden), "right": right, "named": named, "said": said, "seconds": seconds})
    return out


def compared(told: Sequence[Row], base: Sequence[Row]) -> Row:
    """How many are right, which are named otherwise, of how many any word or figure differs, and the time, of its."""
    pairs = list(zip(told, base, strict=True))
    return {
        "right": sum(row["right"] for row in told),
        "lost": [a["hidden"] for a, b in pairs if b["right"] and not a["right"]],
        "won": [a["hidden"] for a, b in pairs if a["right"] and not b["right"]],
        "renamed": [a["hidden"] for a, b in pairs if a["named"] != b["named"]],
        "touched": sum(a["said"] != b["said"] for a, b in pairs),
        "time": round(sum(row["seconds"] for row in told) / sum(row["seconds"] for row in base), 2),
    }


def table(rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows: the number as it is, then of half and double what is right, named otherwise and touched at all.

    Of the newest version of the code alone; those that decide come in their own order.
    """
    base = [row for row in rows if row["factor"] == 1.0][-1]
    by = {(row["constant"], row["factor"]): row for row in rows if row["version"] == base["version"]}
    lines = []
    for name in dict.fromkeys(name for name, factor in by if factor != 1.0):
        found = [by[name, factor] for factor in FACTORS.values() if (name, factor) in by]
        if len(found) == len(FACTORS):
            cells = [f"{row['right']}, {len(row['renamed'])}, {row['touched']}" for row in found]
            which = list(dict.fromkeys(hidden for row in found for hidden in row["renamed"]))
            told = ", ".join(which) if len(which) <= SHOWN else f"{len(which)} logs"
            lines.append((f"`{name.removeprefix('diagnosis.')}`", found[0]["value"], *cells, told))
    count = len(base["answers"])
    same = f"{sum(row['right'] for row in base['answers'])}, 0, 0"
    stamp = f"{base['date']}, {base['commit']}"
    lines.append((f"all of {count} logs as it is ({stamp})", "", same, same, ""))
    return ("number", "is", "half: right, renamed, touched", "double: right, renamed, touched", "renamed"), lines


def late(until: str | None) -> bool:
    """Whether it is later than HH:MM."""
    return until is not None and time.strftime("%H:%M") >= until


def main() -> int:
    """Run what is asked and not known yet, and print the table."""
    parser = command.parser(__name__, __doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", default=DECIDING)
    parser.add_argument("--seed", type=int, default=7000, help="first of the draws (default 7000)")
    parser.add_argument("--until", metavar="HH:MM", help="begin no other number after this time of the day")
    parser.add_argument("--out", type=Path, default=FILE)
    parser.add_argument("--list", action="store_true", help="only print the table of what is in --out")
    asked = parser.parse_args()
    if not asked.list:
        run([each for text in asked.names for each in asked_for(text)], asked.seed, asked.until, asked.out)
    head, lines = table(read_rows(asked.out))
    shown = Table(*head)
    for line in lines:
        shown.add_row(*line)
    Console(width=None if sys.stdout.isatty() else 160).print(shown)
    return 0


def run(constants: Sequence[Constant], seed: int, until: str | None, out: Path) -> None:
    """Add the rows that are not known; the answers as it is are made once."""
    import_all()
    code, cases = version(), draw(seed)
    stamp = {"seed": seed, "version": code, **here()}
    results = Results(out, lambda row: (row["constant"], row["factor"]), lambda row: stamp.items() >= _of(row).items())
    if ("", 1.0) not in results:
        results.add({"constant": "", "factor": 1.0, "answers": answers(cases), **stamp})
    base = results["", 1.0]["answers"]
    for constant in constants:
        for word, factor in FACTORS.items():
            if (str(constant), factor) in results or late(until):
                continue
            try:
                with changed(constant, factor):
                    told = answers(cases)
            except TypeError:
                print(f"{constant}: no number, left out", file=sys.stderr)
                break
            row = {"constant": str(constant), "factor": factor, "value": repr(constant.value)}
            results.add({**row, **compared(told, base), **stamp})
            print(f"{constant} {word}: {compared(told, base)}", file=sys.stderr)


def _of(row: Row) -> Row:
    """Of which draws and of which code a row is."""
    return {"seed": row["seed"], "version": row["version"]}


if __name__ == "__main__":
    raise SystemExit(main())
