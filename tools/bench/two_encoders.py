"""Measure how the angles of both pulleys improve a diagnosis, by the groups that become single causes and that remain.

Usage: tools/run bench/two_encoders [--draws 2] [--seed 0] [--names ROW:SHAPE ...]
                                    [--by-row] [--rows FILE] [--processes 1]

The effects of each row of the catalogue's indistinguishable effects are hidden in short logs
(tests/blind/two_encoders.py). The sheath bends at the joint, evenly or at the motor, and the model file has this
profile. The same logs are diagnosed without and with the motor's angle. Effects without influence on the torque (a
spring, creep, slip, backlash, and `nothing`) can be identified only by the angles. With --by-row the table has a line
for each row instead of each shape.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator

from rich.table import Table

from tests.blind.two_encoders import NOTHING, names, two_encoder_case, without_motor_angle
from tools import command
from tools.bench.diagnose import ask
from tools.command import Row
from tsa_ctrl.errors import UsageError

KINDS = ("found alone", "in a group", "not named", "wrong")


def one(job: tuple[str, int]) -> Row:
    """Return the row of a case with the causes from the diagnoses without and with the motor's angle."""
    name, seed = job
    row: Row = {"name": name, "seed": seed, "truth": NOTHING, "error": ""}
    try:
        case = two_encoder_case(name, seed, short=True)
        row["truth"] = next(iter(case.truth.effects), NOTHING)
        for key, each in (("without", without_motor_angle(case)), ("with", case)):
            causes = ask(each.logs, each.model)[0]["causes"]
            row[key] = [[cause["effect"], *cause["alternatives"]] for cause in causes]
    except (RuntimeError, UsageError) as problem:
        row["error"] = str(problem)
    return row


def kind(causes: list[list[str]], truth: str) -> str:
    """Return the kind of answer, one of `KINDS`."""
    if not causes:
        return "found alone" if truth == NOTHING else "not named"
    if not any(truth in group for group in causes):
        return "wrong"
    return "found alone" if causes == [[truth]] else "in a group"


def report(every: list[Row], by_row: bool) -> Iterator[Table | str]:
    """Yield the table by shape or by row, and the groups that both angles separate or do not separate."""
    yield from (f"{row['name']} {row['seed']}: {row['error']}" for row in every if row["error"])
    rows = [row for row in every if not row["error"]]
    place = 0 if by_row else 2
    lines = []
    for part in (*dict.fromkeys(row["name"].partition(":")[place] for row in rows), "all"):
        mine = [row for row in rows if part in ("all", row["name"].partition(":")[place])]
        counts = [Counter(kind(row[key], row["truth"]) for row in mine) for key in ("without", "with")]
        lines.append((part, len(mine), *(count[each] for count in counts for each in KINDS)))
    heads = [f"{each}: {angles}" for angles in ("torque", "both") for each in KINDS]
    yield command.table(("hidden, its twins" if by_row else "sheath bends", "cases", *heads), lines)
    grouped = [row for row in rows if kind(row["without"], row["truth"]) == "in a group"]
    single = sum(kind(row["with"], row["truth"]) == "found alone" for row in grouped)
    without, both = (sum(len(group) for row in grouped for group in row[key]) for key in ("without", "with"))
    count = max(len(grouped), 1)
    sizes = f"{without / count:.2f} -> {both / count:.2f}"
    yield f"{single} of {len(grouped)} groups became single names; names a group: {sizes}"
    pairs: Counter[str] = Counter()
    for row in rows:
        for group in row["with"] if row["truth"] != NOTHING else ():
            others = [name for name in group if name != row["truth"]] if row["truth"] in group else []
            pairs.update(" / ".join(sorted(pair)) for pair in itertools.product([row["truth"]], others))
    yield "what stays: " + "; ".join(f"{pair} {count}" for pair, count in pairs.most_common())


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--draws", type=int, default=2, help="of each row and shape")
    parser.add_argument("--names", nargs="+", choices=names(), metavar="ROW:SHAPE", default=list(names()))
    parser.add_argument("--by-row", action="store_true", help="a line of the table for each row, not for each shape")
    command.share(parser, "seed rows processes json", seed=0)
    arguments = parser.parse_args()
    jobs = [(name, arguments.seed + draw) for draw in range(arguments.draws) for name in arguments.names]
    rows = command.run_rows(one, jobs, lambda row: (row["name"], row["seed"]), arguments)
    command.print_tables(rows, arguments, lambda: report(rows, arguments.by_row))
    return 0
