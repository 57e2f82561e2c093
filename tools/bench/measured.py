"""Measure the smallest size at which the diagnosis identifies known effects that are hidden in measured logs.

Usage: tools/run bench/measured [--sets emps bam] [--effects NAME ...] [--sizes 0.5 1 2 4 8] [--rows FILE] [--list]

Each set is diagnosed unchanged, and again with one effect added to its measured torque by the formulas of
`hidden_effects`. The size of the effect is a multiple of the noise floor of the unchanged logs. Effects that the
unchanged logs already have are omitted. The answers are:

  found       only this cause
  in a group  this cause with alternatives
  wrong       another cause without this one
  refused     the logs are insufficient

Then each set is halved by its logs, or by the time of its only log. One half is diagnosed with the model from the
diagnosis of the other half, which should add no cause. Rows are kept in --rows (default: the file of the manual's
table) and are not run again. The command looks for the data in TSA_DATA, and then in ../shared/data. Without data it
prints one line.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from tools import command
from tools.bench.hidden_effects import HIDDEN, recorded, with_hidden
from tools.command import Results, Row, read_rows
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import Dataset, load_logs
from tsa_ctrl.model.parameters import load_model

SETS = {  # davinci: only the trials at one frequency, because a diagnosis of all 25 takes minutes
    "emps": ("*.csv.gz", "emps.toml"),
    "epos": ("steady/*.csv.gz", "drive.toml"),
    "bam": ("*.csv.gz", "xl330.toml"),
    "davinci": ("*_0.3Hz.csv.gz", "actuator.toml"),
}
HALVES = "half against half"
AND_ANOTHER = ", and another cause"
FILE = command.ROOT / "tools" / "manual" / "measured.jsonl"


def names_of(report: Row) -> set[str]:
    """Return one set with all causes and alternatives of a report."""
    return {name for cause in report["causes"] for name in (cause["effect"], *cause["alternatives"])}


def claims_of(report: Row) -> list[set[str]]:
    """Return a set with each cause of a report and its alternatives."""
    return [{cause["effect"], *cause["alternatives"]} for cause in report["causes"]]


def trial(folder: Path, effect: str, size: float, untouched: Row | None) -> Row:
    """Diagnose one set unchanged (`untouched` is None), or with an effect hidden in it.

    `untouched` is the report of the unchanged logs. The row has no report if the effect cannot have this size in them.
    """
    pattern, file = SETS[folder.name]
    logs, model = load_logs(sorted(folder.glob(pattern))), load_model(folder / file)
    result: Row = {"set": folder.name, "effect": effect, "size": size}
    if untouched is not None:
        logs, result["number"] = with_hidden(logs, model, effect, size * untouched["rms"]["refitted"])
        if result["number"] is None:
            return result
    result["report"] = _kept(json.loads(diagnose(logs, model).to_json()))
    return result


def halves(folder: Path) -> Row:
    """Diagnose the second half of a set with the model from the diagnosis of the first half, and return the row."""
    pattern, model = SETS[folder.name]
    logs = load_logs(sorted(folder.glob(pattern)))
    if len(logs) > 1:
        first, second = logs[::2], logs[1::2]
    else:
        first, second = (
            [_part(logs[0], each)] for each in (slice(None, len(logs[0]) // 2), slice(len(logs[0]) // 2, None))
        )
    learned = diagnose(first, load_model(folder / model))
    report = json.loads(diagnose(second, learned.model).to_json())
    known = sorted({name for cause in learned.causes for name in (cause.effect, *cause.alternatives)})
    return {"set": folder.name, "effect": HALVES, "size": 0.0, "known": known, "report": _kept(report)}


def _part(log: Dataset, part: slice) -> Dataset:
    return Dataset.from_arrays({name: values[part] for name, values in recorded(log).items()}, log.name)


def _kept(report: Row) -> Row:
    return {key: report[key] for key in ("verdict", "causes", "rms", "gain", "detection_limit", "summary")}


def answer(row: Row, untouched: Row) -> str:
    """Return the answer in which the diagnosis differs from the diagnosis of the unchanged logs."""
    if row["report"]["verdict"] == "insufficient":
        return "refused"
    before = names_of(untouched["report"])
    new = [claim for claim in claims_of(row["report"]) if not claim & before]
    more = AND_ANOTHER if any(row["effect"] not in claim for claim in new) else ""
    if any(claim == {row["effect"]} for claim in new):
        return f"found{more}"
    if any(row["effect"] in claim for claim in claims_of(row["report"])):
        return f"in a group{more}"
    return "wrong" if new else "nothing"


def table(rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and lines of the table.

    The lines have each effect of a set with its detection limit and the answer by size, and the halves of each set.
    The last lines count the answers above and below the detection limits.
    """
    by = {(row["set"], row["effect"], row["size"]): row for row in rows if "report" in row}
    sizes = sorted({row["size"] for row in rows if row["effect"] in HIDDEN})
    head = ("set", "hidden", "limit, of the floor", *(f"{size:g}" for size in sizes))
    lines = []
    above: list[str] = []
    below: list[str] = []
    for name in (name for name in SETS if (name, "", 0.0) in by):
        untouched = by[name, "", 0.0]
        floor = untouched["report"]["rms"].get("refitted", untouched["report"]["rms"]["noise_floor"])
        for effect in HIDDEN:
            found = [by.get((name, effect, size)) for size in sizes]
            if not any(found):
                continue
            limit = untouched["report"]["detection_limit"].get(effect)
            answers = ["" if row is None else answer(row, untouched) for row in found]
            for size, told in zip(sizes, answers, strict=True):
                if told and limit is not None:
                    (above if size * floor > limit else below).append(told)
            lines.append((name, effect, "-" if limit is None else f"{limit / floor:.2g}", *answers))
        if (half := by.get((name, HALVES, 0.0))) is not None:
            new = [" or ".join(sorted(claim)) for claim in claims_of(half["report"])]
            told = f"adds {'; '.join(new)}" if new else "adds nothing"
            lines.append((name, HALVES, told, *("" for _ in sizes)))
    blank = ("",) * (len(sizes) - 1)
    seen = sum(told.removesuffix(AND_ANOTHER) in ("found", "in a group") for told in above)
    lines.append(("all", "above its limit", "named, alone or in a group", f"{seen} of {len(above)}", *blank))
    quiet = sum(told != "wrong" and not told.endswith(AND_ANOTHER) for told in below)
    lines.append(("all", "below its limit", "no other name", f"{quiet} of {len(below)}", *blank))
    wrong = sum(told == "wrong" or told.endswith(AND_ANOTHER) for told in above)
    lines.append(("all", "above its limit", "another name", f"{wrong} of {len(above)}", *blank))
    return head, lines


def main() -> int:
    """Run the missing rows and print the table."""
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--sets", nargs="+", choices=tuple(SETS), default=list(SETS))
    parser.add_argument("--effects", nargs="+", choices=sorted(HIDDEN), default=sorted(HIDDEN))
    parser.add_argument("--sizes", nargs="+", type=float, default=[0.5, 1.0, 2.0, 4.0, 8.0])
    command.share(parser, "rows", rows=FILE)
    parser.add_argument("--list", action="store_true", help="only print the table of the results in --rows")
    asked = parser.parse_args()
    results = Results(asked.rows, lambda row: (row["set"], row["effect"], row["size"]))
    data = None if asked.list else command.measured_data(__name__)
    if data is None and not asked.list:
        return 0
    for name in asked.sets if data is not None else ():
        assert data is not None
        folder = data.parent / name
        if (name, "", 0.0) not in results:
            results.add(trial(folder, "", 0.0, None))
        if (name, HALVES, 0.0) not in results:
            results.add(halves(folder))
        untouched = results[name, "", 0.0]["report"]
        for effect in sorted(set(asked.effects) - names_of(untouched)):
            for size in asked.sizes:
                if (name, effect, size) not in results:
                    results.add(trial(folder, effect, size, untouched))
    command.print_table(*table(read_rows(asked.rows)))
    return 0
