"""Detect changes of a rig over its runs: friction torque, stiffness, lever and zero of each log, with intervals.

The runs are in chronological order. A change is detected by the largest two-sample t statistic over all positions that
divide the runs in two. Without a change, the distribution of this statistic does not depend on the scatter between
runs, and is simulated here with white noise. The rate of false alarms is therefore known: `ALARM` for each quantity of
a folder. A change within the runs' intervals is not reported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl import outputs
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.calibrate.stretch import fit_stretch
from tsa_ctrl.identify.dataset import Dataset, load_log
from tsa_ctrl.identify.quantity import BLOCKS, Quantity, jackknife, spelled
from tsa_ctrl.identify.simulation_picture import COLOURS, MEASURED
from tsa_ctrl.log.info import inspect
from tsa_ctrl.log.table import ENDINGS, sha256_of
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.outputs import json_types

ALARM = 0.01  # probability of a false alarm for each quantity of a folder if the rig does not change
FEWEST = 6  # least number of runs for the detection, with at least two on either side of a change
WARMTH = 2.0  # K, least range of the runs' temperatures for a regression of the friction on temperature
DRAWS = 20_000  # random trials of white noise: they determine the quantile to a thirtieth
SIDE = 2  # fewest runs on either side of a change: a mean needs two
SWING = 0.05  # share of the bending angle that a log must span to determine the lever
SLIDING = 0.05  # share of the highest speed: at lower speeds the direction of the friction is uncertain
WORDS = {  # likely causes of an increase and of a decrease
    "half_loop_torque": (
        "more friction: a liner wears or is dirty, the sheath is bent more, or the tensioner is tighter",
        "less friction: a tendon has stretched, the tensioner gave way, or the sheath is bent less",
    ),
    "tension_per_path": (
        "the pretension follows the bending more: a stiffer tendon, or a series spring is blocked",
        "the pretension follows the bending less: a softer tendon, or the tensioner gives way",
    ),
    "axial_stiffness": ("stiffer tendons: another tendon, or a series spring is blocked", "softer tendons: one frays"),
    "zero": ("a pulley slipped, a tendon crept, or an encoder restarts at every start",) * 2,
}


@dataclass(frozen=True)
class Run:
    """One log: its start, temperature (°C, nan if not measured), results, and the reasons for missing results."""

    log: str
    started: str  # ISO 8601: start of the log, or the file's time if the log does not state it
    temperature: float
    quantities: dict[str, Quantity]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Change:
    """A change of a quantity from `before` to `after` (in `unit`), beginning with the run `since`."""

    quantity: str
    since: str
    before: float
    after: float
    unit: str

    def __str__(self) -> str:
        up, down = WORDS[self.quantity]
        name = "zero of the stretch" if self.quantity == "zero" else self.quantity.replace("_", " ")
        words = up if self.after > self.before else down
        return f"{name} changed with {self.since}: {self.before:.4g} -> {self.after:.4g} {self.unit}: {words}"


@dataclass(frozen=True)
class Trend:
    """All runs in chronological order, and the detected changes.

    `by_temperature`: slope of the friction torque over temperature, N*m/K; None if it is not known.
    """

    runs: tuple[Run, ...]
    changes: tuple[Change, ...]
    by_temperature: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the public JSON object of `tsa log trend`."""
        found: dict[str, Any] = json_types(
            {
                "schema": 1,
                "runs": self.runs,
                "changes": [{**vars(change), "words": str(change)} for change in self.changes],
                "false_alarm_rate": ALARM,
                "half_loop_by_temperature": {"value": self.by_temperature, "unit": "N*m/K"},
            }
        )
        return found


def trend(folder: Path, model: TendonSheath, tick: Callable[[float], None] = lambda share: None) -> Trend:
    """Return the results of all logs of a folder, and the detected changes.

    A log that cannot be read, or that does not determine a quantity, stays in the list with the reason. A second file
    with the same content, such as a link, is not another run.

    Raises:
        UsageError: the folder has no logs, or no log has a result.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; give the one that holds the logs of one axis, a run each")
    paths = sorted(path for path in folder.iterdir() if path.name.lower().endswith(ENDINGS))
    if not paths:
        raise UsageError(f"{folder}: holds no log; expected are files that end with {', '.join(ENDINGS)}")
    runs: list[Run] = []
    same: dict[str, str] = {}
    for number, path in enumerate(paths):
        tick(number / len(paths))
        try:
            first = same.setdefault(sha256_of(path), path.name)
        except UsageError as error:
            runs.append(Run(path.name, "-", math.nan, {}, (str(error),)))
            continue
        if first == path.name:
            runs.append(measured(path, model))
        else:
            runs.append(Run(path.name, "-", math.nan, {}, (f"{path}: has the same data as {first}",)))
    if not any(run.quantities for run in runs):
        raise UsageError(f"{folder}: none of {len(runs)} logs shows friction torque or stiffness; {runs[0].notes[0]}")
    return judged(sorted(runs, key=lambda run: (run.started, run.log)))


def measured(path: Path, model: TendonSheath) -> Run:
    """Return the results of a single log."""
    started = datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds")
    try:
        started = str(inspect(path).about.get("started") or started)
        log = load_log(path)
    except UsageError as error:
        return Run(path.name, started, math.nan, {}, (str(error),))
    quantities: dict[str, Quantity] = {}
    notes = []
    for find in (_by_sensor, _by_bending, _by_stretch):
        try:
            for name, quantity in find(log, model):
                quantities.setdefault(name, quantity)
        except UsageError as error:
            notes.append(str(error))
    if not quantities and not notes:
        notes.append(
            f"{log.label or log.name}: has neither column tau_j nor both q_m and q_j; log the joint torque, or the "
            "angles of motor and joint"
        )
    warmth = log.columns.get("temperature")
    return Run(path.name, started, math.nan if warmth is None else float(np.mean(warmth)), quantities, tuple(notes))


def _by_sensor(log: Dataset, model: TendonSheath) -> Iterator[tuple[str, Quantity]]:
    if "tau_j" in log:
        yield "half_loop_torque", calibrate([log], model).half_loop_torque


def _by_bending(log: Dataset, model: TendonSheath) -> Iterator[tuple[str, Quantity]]:
    """Return the lever k_t of (3.56), N/m, at the file's friction coefficient: (3.55) with T_p0 + k_t (p + d/2) dTheta.

    The interval follows from the log. It does not contain an error of mu, which affects all runs in the same way.
    """
    if not {"tau_j", "theta", "omega_j"} <= log.columns.keys() or not model.lever > 0.0:
        return
    theta, omega = log["theta"], log["omega_j"]
    if np.ptp(theta) < SWING * model.bending_angle:
        return
    x = model.friction_coefficient * theta
    loop = -2.0 * model.joint_pulley_radius * np.sign(omega) * np.sinh(x)
    turned = model.joint_pulley_radius / model.motor_pulley_radius * np.cosh(x) * log["tau_m"]
    rows = np.column_stack([turned, loop, loop * model.lever * (theta - model.bending_angle), np.ones(len(x))])
    part = np.arange(len(x)) * BLOCKS // len(x)
    slides = np.abs(omega) > SLIDING * np.max(np.abs(omega))
    grams = [(rows[k].T @ rows[k], rows[k].T @ log["tau_j"][k]) for k in (slides & (part == n) for n in range(BLOCKS))]
    value, half = jackknife(grams, lambda gram, right: float(np.linalg.lstsq(gram, right, rcond=None)[0][2]))
    yield "tension_per_path", Quantity(value, value - half, value + half, "N/m")


def _by_stretch(log: Dataset, model: TendonSheath) -> Iterator[tuple[str, Quantity]]:
    if "q_m" not in log or "q_j" not in log:
        return
    fit = fit_stretch([log], model)
    yield "half_loop_torque", fit.half_loop_torque
    yield "axial_stiffness", fit.axial_stiffness
    yield "zero", next(iter(fit.zeros.values()))


def judged(runs: Sequence[Run]) -> Trend:
    """Return the trend of runs in chronological order, after testing each quantity for a change."""
    found = []
    slope = None
    for name in WORDS:
        having = [run for run in runs if name in run.quantities]
        if len(having) < FEWEST:
            continue
        quantities = [run.quantities[name] for run in having]
        values = np.array([quantity.value for quantity in quantities])
        if name == "half_loop_torque":
            values, slope = _at_one_temperature(values, np.array([run.temperature for run in having]))
        place, statistic = step(values)
        if statistic <= by_chance(len(values)):
            continue
        before, after = float(np.mean(values[:place])), float(np.mean(values[place:]))
        half = np.array([0.5 * (quantity.high - quantity.low) for quantity in quantities])
        left_open = math.hypot(*(float(np.sqrt(np.mean(part**2) / part.size)) for part in (half[:place], half[place:])))
        if abs(after - before) > left_open:
            found.append(Change(name, having[place].log, before, after, quantities[0].unit))
    return Trend(tuple(runs), tuple(found), slope)


def _at_one_temperature(
    values: NDArray[np.float64], warmth: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float | None]:
    """Return the values converted to the mean temperature, and their slope over temperature.

    The values are unchanged and the slope is None if the temperatures are nearly equal or were not measured. The slope
    is fitted to differences between successive runs, because a lasting change affects only one of them.
    """
    if not np.isfinite(warmth).all() or np.ptp(warmth) < WARMTH:
        return values, None
    steps = np.diff(warmth)
    slope = float(np.sum(steps * np.diff(values)) / np.sum(steps**2))
    return values - slope * (warmth - np.mean(warmth)), slope


def step(values: NDArray[np.float64]) -> tuple[int, float]:
    """Return the index that divides a series (n,) best, and the t statistic of the means on either side of it."""
    places, statistics = _statistics(values[None, :])
    best = int(np.argmax(statistics[0]))
    return places[best], float(statistics[0, best])


def _statistics(series: NDArray[np.float64]) -> tuple[list[int], NDArray[np.float64]]:
    """Return the possible division indices and the statistic of every series (m, n) there, (m, number of indices)."""
    n = series.shape[1]
    places = list(range(SIDE, n - SIDE + 1))
    found = []
    for place in places:
        a, b = series[:, :place], series[:, place:]
        inside = a.var(axis=1) * place + b.var(axis=1) * (n - place)
        scatter = np.sqrt(inside / (n - 2) * (1.0 / place + 1.0 / (n - place)))
        found.append(np.abs(a.mean(axis=1) - b.mean(axis=1)) / np.maximum(scatter, 1e-300))
    return places, np.stack(found, axis=1)


@cache
def by_chance(count: int) -> float:
    """Return the value that the statistic of `count` runs of noise exceeds with probability `ALARM`."""
    noise = np.random.default_rng(count).standard_normal((DRAWS, count))
    return float(np.quantile(_statistics(noise)[1].max(axis=1), 1.0 - ALARM))


def draw(path: Path, found: Trend) -> None:
    """Write a picture of the trend in the format of the suffix, such as PNG.

    Raises:
        UsageError: the file cannot be written.
    """
    from matplotlib.figure import Figure  # slow to import

    names = [name for name in WORDS if any(name in run.quantities for run in found.runs)]
    figure = Figure(figsize=(9.0, 2.6 * len(names)))
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)
    for axis, name in zip(axes[:, 0], names, strict=True):
        places = [k for k, run in enumerate(found.runs) if name in run.quantities]
        quantities = [found.runs[k].quantities[name] for k in places]
        values = np.array([quantity.value for quantity in quantities])
        reach = [values - [q.low for q in quantities], [q.high for q in quantities] - values]
        axis.errorbar(places, values, yerr=np.maximum(reach, 0.0), fmt="o", color=MEASURED, capsize=3)
        for change in found.changes:
            if change.quantity == name:
                since = next(k for k, run in enumerate(found.runs) if run.log == change.since)
                axis.axvline(since - 0.5, color=COLOURS[1])
        axis.set_ylabel(f"{name.replace('_', ' ')} ({spelled(quantities[0].unit)})")
        axis.grid(alpha=0.3)
    axes[-1, 0].set_xticks(range(len(found.runs)), [run.log for run in found.runs], rotation=30, ha="right")
    figure.tight_layout()
    outputs.save_picture(figure, path, dpi=130)
