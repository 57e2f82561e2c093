"""Known effects hidden in measured logs: from which size on does the diagnosis find them there?

Usage: tools/run bench/measured [--sets emps bam] [--effects NAME ...] [--sizes 0.5 1 2 4 8] [--out FILE.jsonl] [--list]

Each set is diagnosed as it is; then again with one effect added to its measured torque, as the drive would show it, by
formulas of this file, at a size in multiples of the floor that the untouched logs have. The size is the RMS of what is
left of it once all is projected out that recalibration may change: inertia, friction, drag and offset as far as the
model has them; of tendons the motor torque and the direction. "found": the name comes in addition to what the untouched
logs say, and no other name does; "in a group": it stands among others; "wrong": another name without it; "refused": the
logs were found insufficient. A parameter that the untouched logs have already is no addition: those effects are left
out. And one half of a set (of its logs, or of its one log's time) is diagnosed with the model that the diagnosis of the
other half has written: nothing may be added. Rows are kept in --out (default: the file that the manual's table is
written from), and not made again. The data are looked for in the folder named by TSA_DATA, else in ../shared/data;
without them there is one line and nothing to do.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tools import command
from tools.bench.results import Results, Row, read_rows
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import Dataset, load_logs
from tsa_ctrl.model.parameters import Model, RigidDrive, load_model

Array = NDArray[np.float64]
SETS = {  # the trials of the cable drive at one frequency: all 25 take minutes a diagnosis
    "emps": ("*.csv.gz", "emps.toml"),
    "epos": ("steady/*.csv.gz", "drive.toml"),
    "bam": ("*.csv.gz", "xl330.toml"),
    "davinci": ("*_0.3Hz.csv.gz", "actuator.toml"),
}
SLOW = 0.03  # s, over which motion is averaged for what is hidden: any smooth motion near the measured one will do
STRIBECK = 0.1  # of the largest speed, over which the hidden static friction fades
MOST_BLURRED = 0.5  # of what is hidden, RMS, that may be another when the motion is averaged over twice as long
MOST_CYCLES = 40  # of a ripple per turn: more are not looked for (model/effects/motor.py), and would be another test
HALVINGS = 30  # of the range of a delay or a distance, until its size is the one wanted
HALVES = "half against half"
FILE = command.ROOT / "tools" / "manual" / "measured.jsonl"


@dataclass(frozen=True)
class Motion:
    """One log, (n,) each: angle (rad), velocity, acceleration and the torque that is predicted, SI; motor's torque."""

    t: Array
    q: Array
    omega: Array
    acceleration: Array
    torque: Array
    tau_m: Array
    reach: float  # rad, the largest range of an angle in the set
    fastest: float  # rad/s, of the set
    friction: float  # N*m, Coulomb friction of the set by least squares


@dataclass(frozen=True)
class Hidden:
    """`change` of the torque (N*m) that a plain drive needs, or that tendons lose, with this number of the effect.

    `parameter` of the model file that the number is, "" where the file's law is another one; `range`: of a number in
    which the change is not linear. `follows_acceleration`: which at steady speed is the velocity's noise alone.
    """

    change: Callable[[Motion, float], Array]
    parameter: str = ""
    needs_angle: bool = False
    range: tuple[float, float] | None = None
    follows_acceleration: bool = False


def smooth(y: Array, t: Array, times: int = 1) -> Array:
    """Mean over so many times SLOW, three samples at least each, (n,)."""
    width = times * max(3, round(SLOW / float(np.median(np.diff(t)))) | 1) | 1
    return np.convolve(np.pad(y, width // 2, mode="edge"), np.full(width, 1.0 / width), mode="valid")


def motions_of(logs: Sequence[Dataset], model: Model, times: int = 1) -> list[Motion]:
    """Motion by differences of averages over so many times SLOW, and what of it the set has in common."""
    plain = isinstance(model, RigidDrive)
    found = [_motion(log, plain, times) for log in logs]
    bases = [base_of(each, model) for each in found]
    fitted = np.linalg.lstsq(np.concatenate(bases), np.concatenate([each.torque for each in found]), rcond=None)[0]
    reach, fastest = max(float(np.ptp(each.q)) for each in found), max(float(np.max(np.abs(m.omega))) for m in found)
    friction = abs(float(fitted[0 if plain else 1]))
    return [replace(each, reach=reach, fastest=fastest, friction=friction) for each in found]


def _motion(log: Dataset, plain: bool, times: int) -> Motion:
    """Of one log; of a recorded velocity the angle is the integral."""
    t = log["t"]
    angle, velocity = ("q_m", "omega_m") if plain else ("q_j", "omega_j")
    if angle in log and angle not in log.derived:
        q = smooth(log[angle], t, times)
        omega = smooth(np.gradient(q, t), t, times)
    else:
        omega = smooth(log[velocity], t, times)
        q = np.cumsum(omega) * float(np.median(np.diff(t)))
    torque = log["tau_m" if plain else "tau_j"]
    return Motion(t, q, omega, smooth(np.gradient(omega, t), t, times), torque, log["tau_m"], 0.0, 0.0, 0.0)


def presliding(log: Motion, share: float) -> Array:
    """What Coulomb friction lacks that builds up exponentially over this share of the motion after each reversal."""
    distance = share * log.reach
    z, out = 0.0, np.empty(len(log.q))
    steps = np.abs(np.diff(log.q, prepend=log.q[0]))
    for at, (way, step) in enumerate(zip(np.sign(log.omega).tolist(), steps.tolist(), strict=True)):
        z = way + (z - way) * math.exp(-step / distance)
        out[at] = z
    return log.friction * (out - np.sign(log.omega))


def late(log: Motion, delay: float) -> Array:
    """What a torque changes that is shown so many seconds late."""
    return np.asarray(np.interp(log.t - delay, log.t, log.torque) - log.torque)


def cycles(log: Motion) -> float:
    """Whole cycles of a ripple per turn: four or more in the motion of the set."""
    return float(min(np.round(4.0 * np.pi / log.reach), MOST_CYCLES))


HIDDEN: Mapping[str, Hidden] = {
    "gravity_load": Hidden(lambda log, a: a * np.sin(log.q + 0.4), "amplitude", needs_angle=True),
    "joint_stiffness": Hidden(lambda log, a: a * log.q, "stiffness", needs_angle=True),
    "torque_offset": Hidden(lambda log, a: np.full(len(log.q), a)),
    "viscous_friction": Hidden(lambda log, a: a * log.omega, "coefficient"),
    "inertia": Hidden(lambda log, a: a * log.acceleration, "inertia", follows_acceleration=True),
    "direction_asymmetric_friction": Hidden(lambda log, a: a * np.abs(log.omega), "viscous_difference"),
    "stribeck_friction": Hidden(
        lambda log, a: a * np.sign(log.omega) * np.exp(-np.abs(log.omega) / (STRIBECK * log.fastest))
    ),
    "torque_ripple": Hidden(lambda log, a: a * np.sin(cycles(log) * log.q + 0.7), needs_angle=True),
    "presliding_hysteresis": Hidden(presliding, needs_angle=True, range=(1e-6, 0.1)),
    "transport_delay": Hidden(late, "delay", range=(1e-4, 0.1)),
}


def recorded(log: Dataset) -> dict[str, Array]:
    """The columns that were measured."""
    return {name: values for name, values in log.columns.items() if name not in log.derived}


def base_of(log: Motion, model: Model) -> Array:
    """What recalibration may change, (n, k)."""
    sigma = np.sign(log.omega)
    if not isinstance(model, RigidDrive):
        return np.column_stack([log.tau_m, sigma])
    free = {"inertia": log.acceleration, "viscous_friction": log.omega, "torque_offset": np.ones_like(sigma)}
    return np.column_stack([sigma, *(column for name, column in free.items() if getattr(model, name) is not None)])


def left_of(change: Sequence[Array], base: Sequence[Array]) -> float:
    """RMS of a change over all logs once the base model is projected out, N*m."""
    whole, columns = np.concatenate(change), np.concatenate(base)
    return float(np.sqrt(np.mean((whole - columns @ np.linalg.lstsq(columns, whole, rcond=None)[0]) ** 2)))


def number_of(hidden: Hidden, logs: Sequence[Motion], base: Sequence[Array], size: float) -> float | None:
    """The number of an effect with which it leaves `size`, N*m; None where no number in its range does."""

    def left(number: float) -> float:
        return left_of([hidden.change(log, number) for log in logs], base)

    if hidden.range is None:
        unit = left(1.0)
        return size / unit if unit > 1e-9 * size else None
    low, high = hidden.range
    if not left(low) < size < left(high):
        return None
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if left(middle) < size else (low, middle)
    return math.sqrt(low * high)


def names_of(report: Row) -> set[str]:
    """Every name that a report holds possible."""
    return {name for cause in report["causes"] for name in (cause["effect"], *cause["alternatives"])}


def claims_of(report: Row) -> list[set[str]]:
    """Each claim as the set of the names that it leaves open."""
    return [{cause["effect"], *cause["alternatives"]} for cause in report["causes"]]


def trial(folder: Path, effect: str, size: float, untouched: Row | None) -> Row:
    """Diagnose one set with an effect hidden in it (`untouched`: what it says without), or as it is (None).

    Without a report where these logs cannot have the effect at this size.
    """
    pattern, file = SETS[folder.name]
    logs, model = load_logs(sorted(folder.glob(pattern))), load_model(folder / file)
    result: Row = {"set": folder.name, "effect": effect, "size": size}
    if untouched is not None:
        logs, result["number"] = with_hidden(logs, model, effect, size * untouched["rms"]["noise_floor"])
        if result["number"] is None:
            return result
    result["report"] = _kept(json.loads(diagnose(logs, model).to_json()))
    return result


def with_hidden(logs: Sequence[Dataset], model: Model, effect: str, size: float) -> tuple[list[Dataset], float | None]:
    """The logs with an effect of this size (N*m) in them, and its number.

    None where there is none of that size, or where it would follow the velocity's noise (acceleration at steady speed).
    """
    plain, hidden = isinstance(model, RigidDrive), HIDDEN[effect]
    if (plain and getattr(model, effect, None) is not None) or (
        hidden.needs_angle and not any(name in logs[0] and name not in logs[0].derived for name in ("q_m", "q_j"))
    ):
        return list(logs), None
    motions = motions_of(logs, model)
    bases = [base_of(each, model) for each in motions]
    number = number_of(hidden, motions, bases, size)
    if number is None or (hidden.follows_acceleration and _is_noise(hidden, motions, motions_of(logs, model, 2))):
        return list(logs), None
    name, sign = "tau_m" if plain else "tau_j", 1.0 if plain or effect == "transport_delay" else -1.0
    changed = [
        Dataset.from_arrays({**recorded(log), name: log[name] + sign * hidden.change(each, number)}, log.name)
        for log, each in zip(logs, motions, strict=True)
    ]
    return changed, number


def _is_noise(hidden: Hidden, motions: Sequence[Motion], coarser: Sequence[Motion]) -> bool:
    """Whether most of the change is another one when the motion is averaged longer."""
    change, other = (np.concatenate([hidden.change(each, 1.0) for each in logs]) for logs in (motions, coarser))
    return float(np.sum((change - other) ** 2)) > (MOST_BLURRED**2) * float(np.sum(change**2))


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


def holds(row: Row) -> bool | None:
    """Whether the interval of the hidden number holds it; None where it was not told."""
    parameter = HIDDEN[row["effect"]].parameter
    told = [cause["parameters"].get(parameter) for cause in row["report"]["causes"] if cause["effect"] == row["effect"]]
    if not told or told[0] is None or told[0]["low"] is None:
        return None
    return bool(told[0]["low"] <= row["number"] <= told[0]["high"])


def table(rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows: an effect of a set a line, its limit and the answer by size; then what half against half adds.

    Last what was found of those above their limit, and of how many below it nothing was said.
    """
    by = {(row["set"], row["effect"], row["size"]): row for row in rows if "report" in row}
    sizes = sorted({row["size"] for row in rows if row["effect"] in HIDDEN})
    head = ("set", "hidden", "limit, of the floor", *(f"{size:g}" for size in sizes))
    lines = []
    above: list[str] = []
    below: list[str] = []
    for name in (name for name in SETS if (name, "", 0.0) in by):
        untouched = by[name, "", 0.0]
        floor = untouched["report"]["rms"]["noise_floor"]
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
    seen = sum(told in ("found", "in a group") for told in above)
    lines.append(("all", "above its limit", "named, alone or in a group", f"{seen} of {len(above)}", *blank))
    quiet = sum(told != "wrong" for told in below)
    lines.append(("all", "below its limit", "no other name", f"{quiet} of {len(below)}", *blank))
    wrong = sum(told == "wrong" for told in above)
    lines.append(("all", "above its limit", "another name", f"{wrong} of {len(above)}", *blank))
    inside = [held for row in by.values() if row["effect"] in HIDDEN and (held := holds(row)) is not None]
    lines.append(("all", "its number told", "interval holds it", f"{sum(inside)} of {len(inside)}", *blank))
    return head, lines


def main() -> int:
    """Run what is asked and not known yet, and print the table."""
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--sets", nargs="+", choices=tuple(SETS), default=list(SETS))
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
