"""What the angles of both pulleys add to a diagnosis: groups that become single names, and pairs that stay.

Usage: tools/run bench/two_encoders [--draws 2] [--seed 0] [--shapes joint even motor] [--rows ROW:SHAPE ...]
                                    [--by-row] [--results FILE] [--jobs 1]
Each row of the catalogue's twins is hidden in short logs (tests/blind/two_encoders.py) on a sheath that bends at the
joint, evenly, or at the motor, as the model file says. The same logs are diagnosed without and with the motor's angle.
Rows that no torque shows (a spring, creep, slip, play; `nothing`) are told by the angles alone. With --by-row the table
has a line for each row instead of each shape. With --results each case is kept in a file as it ends; those that it
holds are not run again.
"""

from __future__ import annotations

import itertools
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tests.blind.two_encoders import NOTHING, SHAPES, names, two_encoder_case, without_motor_angle
from tools import command
from tools.bench.diagnose import ask
from tools.command import Results, Row
from tsa_ctrl.errors import UsageError

KINDS = ("found alone", "in a group", "not named", "wrong")


def one(job: tuple[str, int]) -> Row:
    """A case with what is named with one angle and with two."""
    name, seed = job
    try:
        case = two_encoder_case(name, seed, short=True)
    except RuntimeError as problem:
        return {"name": name, "seed": seed, "error": str(problem)}
    row: Row = {"name": name, "seed": seed, "truth": next(iter(case.truth.effects), NOTHING), "error": ""}
    for key, each in (("without", without_motor_angle(case)), ("with", case)):
        try:
            causes = ask(each.logs, each.model)[0]["causes"]
        except UsageError as problem:
            return {**row, "error": str(problem)}
        row[key] = [[cause["effect"], *cause["alternatives"]] for cause in causes]
    return row


def kind(causes: list[list[str]], truth: str) -> str:
    """Of `KINDS`: the truth as the only name, among others, no name at all, or only other names."""
    if not causes:
        return "found alone" if truth == NOTHING else "not named"
    if not any(truth in group for group in causes):
        return "wrong"
    return "found alone" if causes == [[truth]] else "in a group"


def staying(rows: list[Row]) -> Counter[str]:
    """Pairs of the truth and a name that stands beside it although both angles are known."""
    pairs: Counter[str] = Counter()
    for row in rows:
        for group in row["with"]:
            others = [name for name in group if name != row["truth"]] if row["truth"] in group else []
            pairs.update(" / ".join(sorted(pair)) for pair in itertools.product([row["truth"]], others))
    return pairs


def report(rows: list[Row], by_row: bool) -> None:
    """The table by shape, or by row, and what parts and what stays."""
    place = 0 if by_row else 2
    lines = list(dict.fromkeys(row["name"].partition(":")[place] for row in rows))
    table = Table(
        "hidden, its twins" if by_row else "sheath bends",
        "cases",
        *(f"{kind}: torque" for kind in KINDS),
        *(f"{kind}: both" for kind in KINDS),
    )
    for shape in (*lines, "all"):
        part = [row for row in rows if shape in ("all", row["name"].partition(":")[place])]
        if part:
            counts = [Counter(kind(row[key], row["truth"]) for row in part) for key in ("without", "with")]
            table.add_row(shape, str(len(part)), *(str(count[each]) for count in counts for each in KINDS))
    console = Console(width=230)  # names of rows in full
    console.print(table)
    grouped = [row for row in rows if kind(row["without"], row["truth"]) == "in a group"]
    single = sum(kind(row["with"], row["truth"]) == "found alone" for row in grouped)
    size = [
        sum(len(group) for row in grouped for group in row[key]) / max(len(grouped), 1) for key in ("without", "with")
    ]
    console.print(
        f"{single} of {len(grouped)} groups became single names; names a group: {size[0]:.2f} -> {size[1]:.2f}"
    )
    console.print("what stays: " + "; ".join(f"{pair} {count}" for pair, count in staying(rows).most_common()))
    for row in rows:
        if kind(row["with"], row["truth"]) == "wrong" != kind(row["without"], row["truth"]):
            console.print(
                f"wrong with both angles only: {row['name']} {row['seed']}: {row['without']} -> {row['with']}"
            )


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--draws", type=int, default=2, help="of each row and shape")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--rows", nargs="+", choices=names(), metavar="ROW:SHAPE", default=list(names()))
    parser.add_argument(
        "--shapes", nargs="+", choices=SHAPES, default=list(SHAPES), help="only sheaths that bend there"
    )
    parser.add_argument("--by-row", action="store_true", help="a line of the table for each row, not for each shape")
    parser.add_argument("--results", type=Path, help="a JSON object per case; those that it holds are not run again")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    known: Any = Results(arguments.results, lambda row: (row["name"], row["seed"]))
    jobs = [(name, arguments.seed + draw) for draw in range(arguments.draws) for name in arguments.rows]
    jobs = [job for job in jobs if job[0].partition(":")[2] in arguments.shapes]
    queue = [job for job in jobs if job not in known]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for row in pool.map(one, queue):
            known.add(row)
    rows = [known[job] for job in jobs]
    for row in rows:
        if row["error"]:
            print(f"{row['name']} {row['seed']}: {row['error']}")
    report([row for row in rows if not row["error"]], arguments.by_row)
    return 0
