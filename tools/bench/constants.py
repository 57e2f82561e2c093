"""What half and double of a threshold of the diagnosis do: hidden logs on which it says something else.

Usage: tools/run bench/constants [NAME ...] [--seed 7000] [--until HH:MM] [--out FILE.jsonl] [--list]

NAME is a module below tsa_ctrl/identify and a constant in it, as diagnosis.selection.entry.BLOCK_T; a module alone
stands for all of its numbers; without any those that decide are asked. The logs are twelve blind ones (tests/blind),
short, of every family and the same for every value. Where something is hidden it is the weakest of ten draws, and the
torque sensor has more noise, in steps of sqrt 2, as long as the answer is right: every other log stands at the last of
these steps, the others one beyond, for it is there that thresholds decide. Each is diagnosed with the number as it is,
halved and doubled (whole numbers stay whole; of a pair all are changed alike; what is
made of a number at import, as ASIDE of MOST_SPREAD, stays: it is a number of its
own). A row says of how many logs the answer was right, on which it named something else than with the number as it is,
and on how many anything in the report was another. Rows are kept in --out (default: the file that the manual's table is
written from), and not made again unless the code is another: comments do not count. A log is left out where every
comparison of a number with anything comes out the same (`watched`).
"""

from __future__ import annotations

import ast
import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from tests.blind import FAMILIES, Case, case
from tests.blind.score import mark
from tools import command
from tools.bench import watched
from tools.bench.diagnose import SILENT, ask
from tools.bench.results import Results, Row, read_rows
from tools.bench.thresholds import Constant, asked_for, changed, import_all, replaced, scaled, tree_of, users_of
from tools.manual.measure import here

FACTORS = {"half": 0.5, "double": 2.0}
COUNTS = {"none": 1, "hidden_direction": 1, "single": 3, "pair": 2, "outside": 2, "confounded": 1, "rigid": 2}
DRAWN = 10  # seeds, of which the one with the weakest effect is taken
LOUDEST = 8  # steps of sqrt 2 of the sensor's noise: sixteen times of it, below which every effect is lost
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


def version() -> str:
    """Changes with the code of what is tested and of what tests it; not with a comment."""
    digest = hashlib.sha256()
    for path in sorted(path for folder in CODE for path in (command.ROOT / folder).rglob("*.py")):
        if not path.name.startswith("test_"):
            digest.update(ast.dump(ast.parse(path.read_text(encoding="utf-8"))).encode())
    return digest.hexdigest()[:12]


def commit() -> str:
    """The last commit that changed what is tested or what tests it."""
    line = ["git", "log", "-1", "--format=%h", "--", *(f"{folder}/*.py" for folder in CODE)]
    return subprocess.run(line, cwd=command.ROOT, capture_output=True, text=True, check=True).stdout.strip()


def draw(seed: int) -> list[Case]:
    """The twelve: names of a family at even distances, of each the weakest draw; of two of one name the two weakest."""
    found: list[Case] = []
    for family, count in COUNTS.items():
        names = [FAMILIES[family][k * len(FAMILIES[family]) // count] for k in range(count)]
        for name in dict.fromkeys(names):
            seeds = range(seed, seed + (DRAWN if family in RIGHT else 1))
            drawn = [case(family, name, each, True) for each in seeds]
            found += sorted(drawn, key=lambda each: each.truth.size / each.truth.noise)[: names.count(name)]
    hidden = [each for each in found if each.truth.effects or each.truth.outside]
    edge = {id(each): at_the_edge(each, beyond=k % 2 == 1) for k, each in enumerate(hidden)}
    return [edge.get(id(each), each) for each in found]


def at_the_edge(hidden: Case, beyond: bool) -> Case:
    """With as much noise as leaves the answer right, in steps; `beyond`: one more."""
    last = hidden
    for step in range(LOUDEST + 1):
        louder = noisier(hidden, 2.0 ** (0.5 * step))
        if not answers([louder])[0]["right"]:
            return louder if beyond else last
        last = louder
    return last


def noisier(hidden: Case, factor: float) -> Case:
    """The same with so many times the noise of its torque sensor."""
    rng = np.random.default_rng(int(1000 * factor))
    logs, more = [], hidden.truth.noise * np.sqrt(factor**2 - 1.0)
    for log in hidden.logs:
        name = "tau_m" if hidden.family == "rigid" else "tau_j"
        torque = log.columns[name] + more * rng.standard_normal(len(log.columns[name]))
        logs.append(replace(log, columns={**log.columns, name: torque}))
    return replace(hidden, logs=logs)


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


def in_question(
    cases: Sequence[Case], base: Sequence[Row], constants: Sequence[Constant]
) -> dict[watched.Key, set[int]]:
    """The logs, by place, to which half or double of a number may do anything: of those that are only compared.

    All are watched in one run of each log. Of a number that is not in the result every log is in question.
    """
    compared_only = [
        each for each in constants if watched.only_compared([tree_of(m) for m in users_of(each)], each.name)
    ]
    keys = {(str(each), factor): each for each in compared_only for factor in FACTORS.values()}
    found: dict[watched.Key, set[int]] = {key: set() for key in keys}
    for place, hidden in enumerate(cases):
        otherwise: set[watched.Key] = set()
        with ExitStack() as stack:
            for each in compared_only:
                instead = {(str(each), factor): scaled(each.value, factor) for factor in FACTORS.values()}
                stack.enter_context(replaced(each, watched.Watched(each.value, instead, otherwise)))
            said = answers([hidden])[0]["said"]
        for key in keys if said != base[place]["said"] else otherwise:
            found[key].add(place)
    return found


def compared(told: Sequence[Row], base: Sequence[Row]) -> Row:
    """How many are right, which are named otherwise, and of how many any word or figure is another."""
    pairs = list(zip(told, base, strict=True))
    return {
        "right": sum(row["right"] for row in told),
        "lost": [a["hidden"] for a, b in pairs if b["right"] and not a["right"]],
        "won": [a["hidden"] for a, b in pairs if a["right"] and not b["right"]],
        "renamed": [a["hidden"] for a, b in pairs if a["named"] != b["named"]],
        "touched": sum(a["said"] != b["said"] for a, b in pairs),
    }


def table(rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows: the number as it is, then of half and double what is right, named otherwise and touched at all.

    Of the newest version of the code alone, first the numbers by which an answer is another, then those that touch one.
    """
    base = [row for row in rows if row["factor"] == 1.0][-1]
    by = {(row["constant"], row["factor"]): row for row in rows if row["version"] == base["version"]}
    order = {name: k for k, name in enumerate(dict.fromkeys(name for name, factor in by if factor != 1.0))}
    whole = [name for name in order if all((name, factor) in by for factor in FACTORS.values())]
    lines = []
    for name in sorted(whole, key=lambda name: (_acts([by[name, factor] for factor in FACTORS.values()]), order[name])):
        found = [by[name, factor] for factor in FACTORS.values()]
        cells = [f"{row['right']}, {len(row['renamed'])}, {row['touched']}" for row in found]
        which = list(dict.fromkeys(hidden for row in found for hidden in _other(row)))
        told = ", ".join(which) if len(which) <= SHOWN else f"{len(which)} logs"
        lines.append((f"`{name.removeprefix('diagnosis.')}`", _short(found[0]["value"]), *cells, told))
    same = f"{sum(row['right'] for row in base['answers'])}, 0, 0"
    about = f"{len(base['answers'])} logs; {len(whole)} numbers; {base['date']}, {base['commit']}"
    lines.append((f"all as they are: {about}", "", same, same, ""))
    return ("number", "is", "half: right, renamed, touched", "double: right, renamed, touched", "which"), lines


def _other(row: Row) -> list[str]:
    """The logs that are named otherwise, or of which the answer is right or wrong by its verdict alone."""
    return [*row["renamed"], *row["lost"], *row["won"]]


def _acts(found: Sequence[Row]) -> int:
    """0 where half or double answers a log otherwise, 1 where it touches one, 2 where nothing is another."""
    return 0 if any(_other(row) for row in found) else 1 if any(row["touched"] for row in found) else 2


def _short(value: str) -> str:
    """A number in few digits; several as they are."""
    return value if value.startswith("(") else f"{float(value):.4g}"


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
    stamp = {"seed": seed, "version": code, **here(), "commit": commit()}
    results = Results(out, lambda row: (row["constant"], row["factor"]), lambda row: stamp.items() >= _of(row).items())
    if ("", 1.0) not in results:
        results.add({"constant": "", "factor": 1.0, "answers": answers(cases), **stamp})
    base = results["", 1.0]["answers"]
    numbers = [each for each in constants if _is_number(each)]
    asked = in_question(cases, base, numbers)
    for constant in numbers:
        for word, factor in FACTORS.items():
            key = (str(constant), factor)
            places = sorted(asked.get(key, range(len(cases))))
            if key in results or (late(until) and places):
                continue
            with changed(constant, factor):
                others = dict(zip(places, answers([cases[place] for place in places]), strict=True))
            row = compared([others.get(place, each) for place, each in enumerate(base)], base)
            results.add({"constant": key[0], "factor": factor, "value": repr(constant.value), **row, **stamp})
            print(f"{constant} {word}: {len(places)} run, {row}", file=sys.stderr)


def _is_number(constant: Constant) -> bool:
    try:
        scaled(constant.value, 1.0)
    except TypeError:
        print(f"{constant}: no number, left out", file=sys.stderr)
        return False
    return True


def _of(row: Row) -> Row:
    """Of which draws and of which code a row is."""
    return {"seed": row["seed"], "version": row["version"]}


if __name__ == "__main__":
    raise SystemExit(main())
