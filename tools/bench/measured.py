"""Known effects hidden in measured logs of plain drives: from which size on does the diagnosis find them there?

Usage: tools/run bench/measured [--sets emps bam] [--effects NAME ...] [--sizes 0.5 1 2 4 8] [--out FILE.jsonl]

Each log of a set is diagnosed as it is; then again with one effect added to its measured torque, as the drive would
show it, by formulas of this file, at a size in multiples of the floor that the untouched logs have. The size is the
RMS of what is left of it once inertia, friction, drag and offset are projected out. "found": the name (or its group)
comes in addition to what the untouched logs say, and no other name does; "wrong": another name without it. A parameter
that the untouched logs have already is no addition: those effects are left out. The data are looked for in the folder
named by TSA_DATA, else in ../shared/data; without them there is one line and nothing to do.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tools import command
from tools.bench.results import Results, Row
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


HIDDEN: Mapping[str, Callable[[Array, Array, float], Array]] = {  # of angle, velocity and the set's largest angle
    "gravity_load": lambda q, omega, reach: np.sin(q + 0.4),
    "joint_stiffness": lambda q, omega, reach: q,
    "direction_asymmetric_friction": lambda q, omega, reach: np.abs(omega),
    "torque_ripple": lambda q, omega, reach: np.sin(np.round(4.0 * np.pi / reach) * q + 0.7),
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
    result["report"] = {key: report[key] for key in ("verdict", "causes", "rms", "gain", "detection_limit", "summary")}
    return result


def answer(row: Row, untouched: Row) -> str:
    """What came in addition to what the untouched logs say."""
    before = names_of(untouched["report"])
    new = [claim for claim in claims_of(row["report"]) if not claim & before]
    if any(claim == {row["effect"]} for claim in new):
        return "found"
    if any(row["effect"] in claim for claim in claims_of(row["report"])):
        return "in a group"
    return "wrong" if new else "nothing"


def main() -> int:
    """Run what is asked, and print the table."""
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--sets", nargs="+", choices=sorted(SETS), default=sorted(SETS))
    parser.add_argument("--effects", nargs="+", choices=sorted(HIDDEN), default=sorted(HIDDEN))
    parser.add_argument("--sizes", nargs="+", type=float, default=[0.5, 1.0, 2.0, 4.0, 8.0])
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    data = command.measured_data(__name__)
    if data is None:
        return 0
    results = Results(asked.out, lambda row: (row["set"], row["effect"], row["size"]))
    table = Table("set", "hidden", "limit, of the floor", *(f"{size:g}" for size in asked.sizes))
    for name in asked.sets:
        folder = data.parent / name
        if (name, "", 0.0) not in results:
            results.add(trial(folder, "", 0.0, None))
        untouched = results[name, "", 0.0]
        known = names_of(untouched["report"])
        floor = untouched["report"]["rms"]["noise_floor"]
        for effect in asked.effects:
            if effect in known:
                continue
            for size in asked.sizes:
                if (name, effect, size) not in results:
                    results.add(trial(folder, effect, size, untouched["report"]))
            limit = untouched["report"]["detection_limit"].get(effect)
            answers = [answer(results[name, effect, size], untouched) for size in asked.sizes]
            table.add_row(name, effect, "-" if limit is None else f"{limit / floor:.2g}", *answers)
    Console().print(table)
    return 0
