"""Known effects hidden in measured logs of plain drives: from which size on does the diagnosis find them there?

Usage: tools/run bench/measured [--sets emps bam] [--effects NAME ...] [--sizes 0.5 1 2 4 8] [--out FILE.jsonl] [--list]

Each log of a set is diagnosed as it is; then again with one effect added to its measured torque, as the drive would
show it, by formulas of this file, at a size in multiples of the floor that the untouched logs have. The size is the
RMS of what is left of it once inertia, friction, drag and offset are projected out. "found": the name (or its group)
comes in addition to what the untouched logs say, and no other name does; "wrong": another name without it; "refused":
the logs were found insufficient. A parameter
that the untouched logs have already is no addition: those effects are left out. And one half of a set (of its logs, or
of its one log's time) is diagnosed with the model that the diagnosis of the other half has written: nothing may be
added. Rows are kept in --out (default: the file that the manual's table is written from), and not made again. The data
are looked for in the folder named by TSA_DATA, else in ../shared/data; without them there is one line and nothing to
do.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tools import command
from tools.bench.results import Results, Row, read_rows
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import Dataset, load_logs
from tsa_ctrl.model.parameters import load_model

Array = NDArray[np.float64]
SETS = {"emps": ("*.csv.gz", "emps.toml"), "bam": ("*.csv.gz", "xl330.toml")}
SLOW = 0.03  # s, over which motion is averaged for what is hidden: any smooth motion near the measured one will do


def smooth(y: Array, t: Array) -> Array:
    """Mean over SLOW, (n,)."""
    width = max(3, round(SLOW / float(np.median(np.diff(t)))) | 1)
    return np.convolve(np.pad(y, width // 2, mode="edge"), np.full(width, 1.0 / width), mode="valid")


def motion(log: Dataset) -> tuple[Array, Array, Array]:
    """Angle (rad), velocity and acceleration of one log, (n,) each, by differences of averages."""
    t = log["t"]
    q = smooth(log["q_m"], t)
    omega = smooth(np.gradient(q, t), t)
    return q, omega, smooth(np.gradient(omega, t), t)


STRIBECK = 0.1  # of the largest speed, over which the hidden static friction fades
MOST_CYCLES = 40  # of a ripple per turn: more are not looked for (model/effects/motor.py), and would be another test
HALVES = "half against half"
FILE = command.ROOT / "tools" / "manual" / "measured.jsonl"

HIDDEN: Mapping[str, Callable[[Array, Array, float], Array]] = {  # of angle, velocity and the set's largest angle
    "gravity_load": lambda q, omega, reach: np.sin(q + 0.4),
    "joint_stiffness": lambda q, omega, reach: q,
    "direction_asymmetric_friction": lambda q, omega, reach: np.abs(omega),
    "stribeck_friction": lambda q, omega, reach: (
        np.sign(omega) * np.exp(-np.abs(omega) / (STRIBECK * np.max(np.abs(omega))))
    ),
    "torque_ripple": lambda q, omega, reach: np.sin(min(np.round(4.0 * np.pi / reach), MOST_CYCLES) * q + 0.7),
}


def recorded(log: Dataset) -> dict[str, Array]:
    """The columns that were measured."""
    return {name: values for name, values in log.columns.items() if name not in log.derived}


def left_of(effect: list[Array], motions: list[tuple[Array, Array, Array]]) -> float:
    """RMS of an effect of unit strength over all logs once the base model is projected out."""
    omega, acceleration = (np.concatenate([each[i] for each in motions]) for i in (1, 2))
    base = np.column_stack([acceleration, np.sign(omega), omega, np.ones_like(omega)])
    whole = np.concatenate(effect)
    return float(np.sqrt(np.mean((whole - base @ np.linalg.lstsq(base, whole, rcond=None)[0]) ** 2)))


def names_of(report: Row) -> set[str]:
    """Every name that a report holds possible."""
    return {name for cause in report["causes"] for name in (cause["effect"], *cause["alternatives"])}


def claims_of(report: Row) -> list[set[str]]:
    """Each claim as the set of the names that it leaves open."""
    return [{cause["effect"], *cause["alternatives"]} for cause in report["causes"]]


def trial(folder: Path, effect: str, size: float, untouched: Row | None) -> Row:
    """Diagnose one set with an effect hidden in it (`untouched`: what it says without), or as it is (None)."""
    pattern, model = SETS[folder.name]
    logs = load_logs(sorted(folder.glob(pattern)))
    result: Row = {"set": folder.name, "effect": effect, "size": size}
    if untouched is not None:
        motions = [motion(log) for log in logs]
        reach = max(float(np.ptp(q)) for q, _, _ in motions)
        shape = [HIDDEN[effect](q, omega, reach) for q, omega, _ in motions]
        strength = size * untouched["rms"]["noise_floor"] / left_of(shape, motions)
        logs = [
            Dataset.from_arrays({**recorded(log), "tau_m": log["tau_m"] + strength * each}, log.name)
            for log, each in zip(logs, shape, strict=True)
        ]
        result["strength"] = strength
    report = json.loads(diagnose(logs, load_model(folder / model)).to_json())
    result["report"] = _kept(report)
    return result


def halves(folder: Path) -> Row:
    """What the second half of a set adds to the model that the diagnosis of the first has written."""
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
    """What came in addition to what the untouched logs say."""
    if row["report"]["verdict"] == "insufficient":
        return "refused"
    before = names_of(untouched["report"])
    new = [claim for claim in claims_of(row["report"]) if not claim & before]
    if any(claim == {row["effect"]} for claim in new):
        return "found"
    if any(row["effect"] in claim for claim in claims_of(row["report"])):
        return "in a group"
    return "wrong" if new else "nothing"


def table(rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows: an effect of a set a line, its limit and the answer by size; then what half against half adds."""
    by = {(row["set"], row["effect"], row["size"]): row for row in rows}
    sizes = sorted({row["size"] for row in rows if row["effect"] in HIDDEN})
    head = ("set", "hidden", "limit, of the floor", *(f"{size:g}" for size in sizes))
    lines = []
    for name in (name for name in SETS if (name, "", 0.0) in by):
        untouched = by[name, "", 0.0]
        floor = untouched["report"]["rms"]["noise_floor"]
        for effect in HIDDEN:
            found = [by.get((name, effect, size)) for size in sizes]
            if not any(found):
                continue
            limit = untouched["report"]["detection_limit"].get(effect)
            answers = ["" if row is None else answer(row, untouched) for row in found]
            lines.append((name, effect, "-" if limit is None else f"{limit / floor:.2g}", *answers))
        if (half := by.get((name, HALVES, 0.0))) is not None:
            new = [" or ".join(sorted(claim)) for claim in claims_of(half["report"])]
            told = f"adds {'; '.join(new)}" if new else "adds nothing"
            lines.append((name, HALVES, told, *("" for _ in sizes)))
    return head, lines


def main() -> int:
    """Run what is asked and not known yet, and print the table."""
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--sets", nargs="+", choices=sorted(SETS), default=sorted(SETS))
    parser.add_argument("--effects", nargs="+", choices=sorted(HIDDEN), default=sorted(HIDDEN))
    parser.add_argument("--sizes", nargs="+", type=float, default=[0.5, 1.0, 2.0, 4.0, 8.0])
    parser.add_argument("--out", type=Path, default=FILE)
    parser.add_argument("--list", action="store_true", help="only print the table of what is in --out")
    asked = parser.parse_args()
    results = Results(asked.out, lambda row: (row["set"], row["effect"], row["size"]))
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
    head, lines = table(read_rows(asked.out))
    shown = Table(*head)
    for line in lines:
        shown.add_row(*line)
    Console().print(shown)
    return 0
