"""Compare the diagnosis with regressions on measured drives of others: held-out errors and processor time.

Usage: tools/run bench/otherwise [--sets emps epos bam davinci] [--rows FILE] [--list]

One split for all, stated before the run: of emps every third of twelve stretches is held out, with gaps of 0.3 s; of
epos every third log by name (speeds, each way); of bam the trials with the higher gain (kp400*); of davinci, its trials
at 0.3 Hz, the one with 50 % of the load. Fitted on the rest: the model as given, recalibrated, extended (`tsa
diagnose`); least squares by hand on inertia, friction, drag and offset, and the same with the published causes; boosted
trees, a small network, and a sparse regression over products of the signals (tools/bench/regressions.py), which see
angle, velocity, its sign, acceleration and the temperature where there is one; of davinci the motor torque as well.
Errors: RMS over all held-out samples. Rows are kept in --rows (default: the file that the manual's table is written
from); a set that stands there is not run again. The data are looked for in the folder named by TSA_DATA, else in
../shared/data. Needs scikit-learn (extra dev).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tools import command
from tools.bench import regressions
from tools.bench.regressions import Array, Predict
from tools.command import Results, Row, read_rows
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import load_logs
from tsa_ctrl.identify.diagnosis.data.prepare import prepare
from tsa_ctrl.identify.diagnosis.data.split import Split, split
from tsa_ctrl.model.effects.memory import PreslidingHysteresis
from tsa_ctrl.model.parameters import RigidDrive, load_model
from tsa_ctrl.model.signals import Signals, hold_direction

FILE = command.ROOT / "tools" / "manual" / "otherwise.jsonl"
STEPS = ("as given", "recalibrated", "extended")
BY_HAND = ("by hand", "by hand, published causes")
METHODS = (*STEPS, *BY_HAND, *regressions.METHODS)
DISTANCES = np.geomspace(0.002, 0.2, 16)  # rad, tried for presliding by hand
SPEEDS = np.geomspace(0.5, 50.0, 12)  # rad/s, tried for Stribeck's speed by hand


@dataclass(frozen=True)
class Trial:
    """Logs below the folder of the data, model, what is held out (None: stretches), and the published causes."""

    logs: str
    model: str
    hold_out: str | None
    published: str


SETS: Mapping[str, Trial] = {
    "emps": Trial("*.csv.gz", "emps.toml", None, "friction differs by direction"),
    "epos": Trial("steady/*.csv.gz", "drive.toml", None, "offset, Stribeck"),
    "bam": Trial("*.csv.gz", "xl330.toml", "kp400*", "gravity, friction that grows with the load"),
    "davinci": Trial("*_0.3Hz.csv.gz", "actuator.toml", "load050*", "presliding, load, a spring"),
}


def masks(data: Split) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the fitted and the held-out samples at the rate of the logs, over all logs."""
    fit, held = (np.zeros(sum(len(run.full_target) for run in data.frame.runs), dtype=np.bool_) for _ in range(2))
    start = 0
    for run, part in zip(data.frame.runs, data.frame.slices, strict=True):
        for own, score in ((fit, data.fit), (held, data.held)):
            own[start : start + run.count * run.full_bin] = np.repeat(score[part], run.full_bin)
        start += len(run.full_target)
    return fit, held


def signals_of(s: Signals, plain: bool) -> Array:
    """Return the signals for a regression without causes, (n, k)."""
    omega, angle = s.omega_j, s.q_m if plain or s.q_j is None else s.q_j
    columns = [omega, np.sign(omega), s.acceleration]
    for column in (angle, None if plain else s.tau_m, s.temperature):
        if column is not None:
            columns.append(column)
    return np.column_stack(columns)


def by_hand(s: Signals, plain: bool) -> Array:
    """Inertia, friction, drag, offset of a plain drive; (3.55)'s line in motor torque and direction of tendons."""
    sigma, one = hold_direction(s.omega_j), np.ones(len(s))
    if plain:
        return np.column_stack([s.acceleration, sigma, s.omega_j, one])
    return np.column_stack([s.tau_m, sigma, one])


def with_published(name: str, s: Signals) -> list[Array]:
    """The same with the causes that were published, one set of columns for each value of what is not linear."""
    base, sigma = by_hand(s, name != "davinci"), hold_direction(s.omega_j)
    if name == "emps":
        return [np.column_stack([base, np.abs(s.omega_j)])]
    if name == "epos":
        return [np.column_stack([base, sigma * np.exp(-np.abs(s.omega_j) / speed)]) for speed in SPEEDS]
    assert s.q_m is not None
    if name == "bam":
        weight = np.sin(s.q_m)
        return [np.column_stack([base, weight, np.cos(s.q_m), sigma * np.abs(weight)])]
    found = []
    for distance in DISTANCES:
        z = PreslidingHysteresis(float(distance), 1, "motor").state(s.q_m, 0.0)
        angle = s.q_m if s.q_j is None else s.q_j
        found.append(np.column_stack([s.tau_m, z, z * s.tau_m, angle, np.ones(len(s))]))
    return found


def trial(folder: Path, name: str) -> list[Row]:
    """Run all methods on one set and return a row for each."""
    of = SETS[name]
    model = load_model(folder / of.model)
    logs = load_logs(sorted(folder.glob(of.logs)))
    rows: list[Row] = []

    def add(method: str, rms: float | None, started: float, **more: object) -> None:
        seconds = time.process_time() - started
        rows.append({"set": name, "method": method, "rms": rms, "seconds": seconds, **more})

    started = time.process_time()
    report = json.loads(diagnose(logs, model, hold_out=of.hold_out).to_json())
    causes = [[cause["effect"], *cause["alternatives"]] for cause in report["causes"]]
    told = {"causes": causes, "verdict": report["verdict"], "summary": report["summary"]}
    for method, key in zip(STEPS, ("as_given", "recalibrated", "extended"), strict=True):
        add(method, report["rms"][key], started, **told)
    data, plain = split(prepare(logs, model), of.hold_out), isinstance(model, RigidDrive)
    runs = data.frame.runs
    fit, held = masks(data)
    torque = np.concatenate([run.full_target for run in runs])

    def measure(method: str, candidates: list[Array], learn: Callable[[Array, Array], Predict], started: float) -> None:
        best = regressions.best_by_blocks([each[fit] for each in candidates], torque[fit]) if len(candidates) > 1 else 0
        columns = candidates[best]
        add(method, regressions.error(learn(columns[fit], torque[fit]), columns[held], torque[held]), started)

    started = time.process_time()
    measure(
        BY_HAND[0], [np.concatenate([by_hand(run.full, plain) for run in runs])], regressions.least_squares, started
    )
    started = time.process_time()
    tried = zip(*(with_published(name, run.full) for run in runs), strict=True)
    measure(BY_HAND[1], [np.concatenate(parts) for parts in tried], regressions.least_squares, started)
    signals = np.concatenate([signals_of(run.full, plain) for run in runs])
    for method, learn in regressions.METHODS.items():
        measure(method, [signals], learn, time.process_time())
    return rows


def table(rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and lines: held-out error and processor time of each method, then the identified causes."""
    sets = [name for name in SETS if any(row["set"] == name for row in rows)]
    by = {(row["set"], row["method"]): row for row in rows}
    units = {"emps": "N"}
    head = ("", *(f"{name}, {units.get(name, 'mN·m')} (s)" for name in sets))
    lines = []
    for method in METHODS:
        cells = []
        for name in sets:
            row = by[name, method]
            factor = 1.0 if name in units else 1e3
            error = "refused" if row["rms"] is None else f"{row['rms'] * factor:.3g}"
            cells.append(f"{error} ({row['seconds']:.2g})")
        lines.append((method, *cells))
    named = []
    for name in sets:
        causes = by[name, STEPS[-1]]["causes"]
        named.append("; ".join(" or ".join(each).replace("_", " ") for each in causes) or "nothing")
    lines.append(("named", *named))
    lines.append(("published", *(SETS[name].published for name in sets)))
    return head, lines


def main() -> int:
    """Run the missing sets and print the table."""
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--sets", nargs="+", choices=tuple(SETS), default=list(SETS))
    command.share(parser, "rows", rows=FILE)
    parser.add_argument("--list", action="store_true", help="only print the table of what is in --rows")
    asked = parser.parse_args()
    results = Results(asked.rows, lambda row: (row["set"], row["method"]))
    if not asked.list:
        data = command.measured_data(__name__)
        if data is None:
            return 0
        for name in asked.sets:
            if (name, METHODS[-1]) not in results:
                for row in trial(data.parent / name, name):
                    results.add(row)
    head, lines = table(read_rows(asked.rows))
    command.print_table(head, lines)
    return 0
