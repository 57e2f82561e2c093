"""Investigate rigs with hidden causes, and print the hypotheses after each motion and the answer.

Usage: tools/run bench/investigate [--seed N] [--only TEXT] [--sample N] [--rows FILE] [--processes 1|2]

The seed determines random rigs of the tests: single joints and the knee of a leg in virtual time, and a simulated gear.
The table has a row for each rig, and the last line counts the right answers. With --rows an interrupted run continues.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from tests.investigate.rigs import GEARED, KNEE, LEG, Gear, Rig, rigs, write
from tools import command
from tools.command import Row
from tsa_ctrl.cli.investigate import command as investigate_command
from tsa_ctrl.errors import UsageError
from tsa_ctrl.investigate.procedure import investigate, report_dict

MOST = 6  # motions, the default of `tsa investigate`


def investigated(hidden: Rig, seed: int) -> dict[str, Any]:
    """Return the JSON object of one rig. After an error, the answer is "error" and the statement is the error text."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if hidden.load == GEARED:
            gear = Gear(hidden, seed)
            try:
                return report_dict(investigate(gear.play, gear.nominal, gear.bounds, MOST), Path())
            except UsageError as error:
                return {"answer": "error", "statement": str(error), "causes": [], "steps": []}
        controller, plant = write(folder / "rig", hidden, seed)
        call = [str(controller), "--virtual", str(plant), "--out", str(folder / "out"), "--json"]
        call += ["--axis", KNEE] if hidden.load == LEG else []
        done = CliRunner().invoke(investigate_command, call)
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            return {"answer": "error", "statement": str(done.exception), "causes": [], "steps": []}
        found: dict[str, Any] = json.loads(done.stdout)
        return found


def _rig(name: str, seed: int) -> Rig:
    return next(hidden for hidden in rigs(seed) if hidden.name == name)


def trial(item: tuple[str, int]) -> Row:
    """Return the row of one rig, by name and seed."""
    name, seed = item
    hidden = _rig(name, seed)
    found = investigated(hidden, seed)
    return {"rig": name, "seed": seed, "right": hidden.judged(found["answer"], found["causes"]), **found}


def line(row: Row) -> str:
    """Return the line of one rig in the table."""
    steps = "; ".join(
        ", ".join(" or ".join(names) for names in step["hypotheses"]) or step["verdict"] for step in row["steps"]
    )
    seconds = sum(step["seconds"] for step in row["steps"])
    right = "right" if row["right"] else "WRONG"
    return f"| {row['rig']} | {steps} | {len(row['steps'])} | {seconds:.0f} | {row['answer']} | {right} |"


def main() -> int:
    """Run the rigs and print the table."""
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--only", default="", help="rigs with this text in their name")
    command.share(parser, "seed sample rows processes json", seed=0)
    options = parser.parse_args()
    names = [(hidden.name, options.seed) for hidden in rigs(options.seed) if options.only in hidden.name]
    chosen = sorted(command.drawn(names, options), key=names.index)

    def seen(row: Row) -> None:
        print(line(row) if row["answer"] != "error" else f"{row['rig']}: {row['statement']}", file=sys.stderr)

    rows = command.run_rows(trial, chosen, lambda row: (row["rig"], row["seed"]), options, seen)

    def shown() -> list[str]:
        titles = ("hidden", "hypotheses after each motion", "motions", "seconds of motion", "answer", "judged")
        head = "\n".join(f"| {' | '.join(cells)} |" for cells in (titles, ["---"] * len(titles)))
        right = sum(row["right"] for row in rows)
        return [head, *map(line, rows), f"{right} of {len(rows)} right; seed {options.seed}"]

    command.print_tables(rows, options, shown)
    return 0
