"""Prepare logs for scoring: check them, denoise them at the compute rate, and average torques to the score rate.

Averaging is linear and the same for the measured torque and for every prediction. Comparing averages therefore only
loses resolution: a pulse shorter than one average keeps its area.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import FEWEST_LOGS, Dataset, check_distinct, matches
from tsa_ctrl.identify.diagnosis.data.denoise import denoised, denoised_within
from tsa_ctrl.identify.diagnosis.data.frame import Run
from tsa_ctrl.identify.unused import with_unused
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model

Log = Dataset | Mapping[str, ArrayLike]
Logs = Sequence[Log] | Mapping[str, Mapping[str, ArrayLike]]

COMPUTE_RATE = 500.0  # Hz, highest compute rate: it resolves the time of a reversal to 2 ms
COMPUTE_SAMPLES = 90_000  # most compute samples of all logs together: three minutes at COMPUTE_RATE
SCORE_RATE = 125.0  # Hz, approximate rate at which torques are compared
SAME_RATE = 0.05  # largest relative difference of the score rates of two logs: it changes the noise model by as much
SCORE_SAMPLES = 12_000  # most score samples of all logs: whitened columns of a thousand responses then fit into 100 MB


def prepare(logs: Logs, model: Model, hold_out: str | None = None) -> list[Run]:
    """Return the logs after checking, selecting, denoising and downsampling them.

    Args:
        logs: datasets or columns by name.
        model: the nominal model.
        hold_out: pattern of the held-out logs; if some logs must be omitted, a part of these is kept.

    Raises:
        UsageError: a log cannot be used; the message names log and column in one line.
    """
    target = model.target
    datasets = [with_unused(log, model, "diagnose", hypotheses=True) for log in _datasets(logs)]
    for log in datasets:
        _admit(log, model, target)
    return _reduced(informative([log.completed_for(model) for log in datasets], hold_out), model)


def _datasets(logs: Logs) -> list[Dataset]:
    if isinstance(logs, Mapping):
        return [Dataset.from_arrays(columns, name) for name, columns in logs.items()]
    out = []
    for number, log in enumerate(logs):
        out.append(log if isinstance(log, Dataset) else Dataset.from_arrays(log, f"log_{number + 1}"))
    if not out:
        raise UsageError("diagnose: no log given; name at least one")
    check_distinct("diagnose", out)
    return out


def _admit(log: Dataset, model: Model, target: str) -> None:
    if target not in log:
        raise UsageError(
            f"{log.label or log.name}: column {target} is missing; this kind of model needs the measured "
            'joint torque (N·m): add it, or describe a drive without torque sensor as [actuator] kind = "rigid_drive"'
        )
    admit(log, model, target)


def _reduced(logs: Sequence[Dataset], model: Model) -> list[Run]:
    """Return the runs of the logs, with score samples of one rate, because all logs share one noise model.

    A log is resampled to a multiple of the lowest rate if no whole number of its samples has the duration of a score
    sample within SAME_RATE.
    """
    slowest = min(log.rate for log in logs)
    total = sum(log.seconds for log in logs)
    rate = min(slowest, COMPUTE_RATE, COMPUTE_SAMPLES / total)
    factor = max(1, round(slowest / rate)) if slowest / rate > 1.3 else 1
    bin_ = max(1, round(slowest / factor / min(SCORE_RATE, SCORE_SAMPLES / total)))
    runs = []
    for log in logs:
        samples = log.rate / slowest * factor * bin_  # of this log in a score sample
        bins = _bins(samples, max(1, round(log.rate / slowest * factor)))
        if bins is None:
            multiple = math.floor(log.rate / slowest)
            log, bins = log.resampled(multiple * slowest).completed_for(model), (multiple * factor, bin_)
        runs.append(_run_of(log, log[model.target], *bins))
    return runs


def _bins(samples: float, most: int) -> tuple[int, int] | None:
    """Return the numbers of samples per compute sample, at most `most`, and of compute samples per score sample.

    Their product is `samples` within SAME_RATE; None if no such numbers exist.
    """
    for factor in range(most, 0, -1):
        bin_ = max(1, round(samples / factor))
        if abs(factor * bin_ / samples - 1.0) <= SAME_RATE:
            return factor, bin_
    return None


def _run_of(log: Dataset, measured: Array, factor: int, bin_: int) -> Run:
    """Return the run of one log.

    Args:
        log: the log.
        measured: measurement of the torque that the model predicts, (n,) in N*m.
        factor: number of samples of the log per compute sample.
        bin_: number of compute samples per score sample.
    """
    full, noise, error = denoised(log)
    signals = full.means(factor)
    averages = _means(measured, factor), bin_, noise, _means(error, factor)
    return Run(log.name, signals, *averages, log, full, measured, factor * bin_)


def narrowed(run: Run, band: float) -> Run:
    """Return the run with derived motion limited to `band` Hz; unchanged arrays are shared, not copied."""
    factor = run.full_bin // run.bin
    clean, uncertain = denoised_within(run.raw, band)
    small: dict[str, Any] = {name: _means(y, factor) for name, y in clean.items()}
    noise, error = (
        (run.velocity_noise, run.velocity_error) if uncertain is None else (uncertain[0], _means(uncertain[1], factor))
    )
    return dataclasses.replace(
        run,
        signals=dataclasses.replace(run.signals, **small),
        full=dataclasses.replace(run.full, **cast(dict[str, Any], clean)),
        velocity_noise=noise,
        velocity_error=error,
        band=band,
    )


def _means(y: Array, factor: int) -> Array:
    whole = len(y) // factor * factor
    return np.asarray(y[:whole].reshape(-1, factor).mean(axis=1))


# Select the most informative of many logs; whole logs are omitted if others repeat them.
#
# A lower sample rate would lose information: for 900 s, the time of a reversal would be resolved to 10 ms, and for an
# hour to 40 ms. A log is valued by its seconds in cells of speed, direction, load, angle, temperature, wrap angle and
# time since its start. A cell counts less the longer other logs have been in it. The value of the greedy choice is at
# least 1 - 1/e of the value of the best choice of that length (Nemhauser, Wolsey, Fisher, Math. Programming 14, 1978).

LONGEST = 600.0  # s, limit for all logs together: it resolves the time of a reversal to 7 ms (COMPUTE_SAMPLES)
HELD = 1.0 / 3.0  # share of LONGEST for logs that a pattern holds out: the same share as without a pattern
PERIOD = 0.1  # s between the counted samples: a motion at 5 Hz still reaches each of its cells
BINS = 6  # bins of each signal over its range in all logs: a pair has 36 cells, and a log of 20 s can reach all of them
ENOUGH = 1.0  # s in a cell above which further time counts for less than half: a second has tens of score samples
PAIRS = (("speed", "load"), ("angle", "load"), ("warmth", "speed"), ("bending", "load"), ("age", "load"))


def informative(logs: Sequence[Dataset], hold_out: str | None, longest: float = LONGEST) -> list[Dataset]:
    """Return the most informative logs, at most `longest` s, in the given order; few or short logs are all returned.

    hold_out: pattern of the held-out logs. They and the other logs are selected separately, within their shares.
    """
    if sum(log.seconds for log in logs) <= longest or len(logs) <= FEWEST_LOGS:
        return list(logs)
    cells = _cells(logs)
    held = [hold_out is not None and matches(log.name, hold_out) for log in logs]
    parts = [(False, 1.0), (True, 0.0)] if not any(held) or all(held) else [(False, 1.0 - HELD), (True, HELD)]
    kept: set[int] = set()
    for side, share in parts:
        own = [i for i, each in enumerate(held) if each == side or share == 1.0]
        if share > 0.0:
            kept.update(_chosen(own, cells, [log.seconds for log in logs], share * longest))
    return [log for i, log in enumerate(logs) if i in kept]


def left_out(given: int, runs: Sequence[Run]) -> tuple[str, ...]:
    """Return a note if some of the `given` logs were omitted; empty otherwise."""
    if len(runs) == given:
        return ()
    seconds = sum(run.raw.seconds for run in runs)
    return (f"{len(runs)} of {given} logs, {seconds:.0f} s, are used: the others repeat them",)


def _chosen(own: Sequence[int], cells: Array, seconds: Sequence[float], longest: float) -> list[int]:
    """Return the numbers of the logs among `own` that add most information per second, up to `longest` s.

    At least FEWEST_LOGS are kept, because whole logs are held out. `cells`: time of each log in each cell, (logs, k)
    in s.
    """
    known, used, chosen, left = np.zeros(cells.shape[1]), 0.0, list[int](), list(own)
    while left:
        worth = np.log1p((known + cells[left]) / ENOUGH).sum(axis=1) - np.log1p(known / ENOUGH).sum()
        best = left.pop(int(np.argmax(worth / np.array([seconds[i] for i in left]))))
        if used + seconds[best] > longest and len(chosen) >= FEWEST_LOGS:
            continue
        chosen.append(best)
        used += seconds[best]
        known = known + cells[best]
    return chosen


def _cells(logs: Sequence[Dataset]) -> Array:
    """Return the time (s) that each log spends in each cell of its pairs of signals, (logs, k)."""
    signals = [_signals(log) for log in logs]
    edges = {}
    for name in {name for each in signals for name in each}:
        values = np.concatenate([each[name] for each in signals if name in each])
        low, high = np.quantile(values, (0.01, 0.99))  # an outlier must not put all other samples into one cell
        edges[name] = np.linspace(low, high, BINS + 1)[1:-1]
    rows = []
    for each in signals:
        number = {name: np.searchsorted(edges[name], values) for name, values in each.items()}
        counted = []
        for first, second in PAIRS:
            both = number[first] * BINS + number[second] if {first, second} <= set(number) else np.zeros(0, dtype=int)
            counted.append(np.bincount(both, minlength=BINS * BINS) * PERIOD)
        rows.append(np.concatenate(counted))
    return np.array(rows, dtype=np.float64)


def _signals(log: Dataset) -> Mapping[str, Array]:
    """Return the state of a log once per PERIOD: velocity, motor torque, angle, temperature, wrap angle and age."""
    step = max(1, round(PERIOD / log.period))
    columns = {name: log[name][::step] for name in log.columns if name not in log.derived}
    angle = columns.get("q_j", columns.get("q_m"))
    velocity = columns.get("omega_j", columns.get("omega_m"))
    if velocity is None and angle is not None:
        velocity = np.gradient(angle, step * log.period) if len(angle) > 1 else np.zeros(len(angle))
    age = np.log1p(columns["t"] - columns["t"][0])  # relaxation and warm-up change with the logarithm of time
    found = {
        "speed": velocity,
        "load": columns.get("tau_m"),
        "angle": angle,
        "warmth": columns.get("temperature"),
        "bending": columns.get("theta"),
        "age": age,
    }
    return {name: values for name, values in found.items() if values is not None}
