"""Select the most informative of many logs: repetitions are left out, whole logs at a time.

Rates that sink with the total length would remove the information of the logs: at 900 s a reversal would be placed to
10 ms, at
an hour to 40. So a log counts by where it has been: seconds in cells of speed, direction, load, angle, warmth, bending
and time since its start, each cell worth less the longer others have been there. Greedily chosen, the logs are within
1 - 1/e of the best choice of that length (Nemhauser, Wolsey, Fisher, Math. Programming 14, 1978), and more of the same
changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tsa_ctrl.identify.dataset import FEWEST_LOGS, Dataset, matches
from tsa_ctrl.identify.diagnosis.data.frame import Run
from tsa_ctrl.model.functions import Array

LONGEST = 600.0  # s, of all logs together: up to here reversals are placed to 7 ms (prepare.COMPUTE_SAMPLES)
HELD = 1.0 / 3.0  # of LONGEST, for logs that a pattern holds out: the share that is held out without one
PERIOD = 0.1  # s between the samples that are counted: at 5 Hz a motion is still seen in each of its cells
BINS = 6  # of each signal over its range in all logs: a pair has 36 cells, of which a log of 20 s can see each
ENOUGH = 1.0  # s in a cell, from which on more of it counts for half: a second holds tens of score samples
PAIRS = (("speed", "load"), ("angle", "load"), ("warmth", "speed"), ("bending", "load"), ("age", "load"))


def informative(logs: Sequence[Dataset], hold_out: str | None, longest: float = LONGEST) -> list[Dataset]:
    """Return the most informative logs, at most `longest` s, in the given order; all where there are few.

    hold_out: pattern of the logs that are held out; of these and of the others as many stay as their shares allow.
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
    """Return the note on the logs that were left out of the `given` ones; nothing where none was."""
    if len(runs) == given:
        return ()
    seconds = sum(run.raw.seconds for run in runs)
    return (f"{len(runs)} of {given} logs, {seconds:.0f} s, are used: the others repeat them",)


def _chosen(own: Sequence[int], cells: Array, seconds: Sequence[float], longest: float) -> list[int]:
    """Return the numbers of the logs, of `own`, that add most information per second, as long as they fit.

    cells (logs, k): seconds of each log in each cell. At least FEWEST_LOGS stay, as whole logs are held out.
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
    """Seconds of each log in each cell of the pairs of signals that it has, (logs, k)."""
    signals = [_signals(log) for log in logs]
    edges = {}
    for name in {name for each in signals for name in each}:
        values = np.concatenate([each[name] for each in signals if name in each])
        low, high = np.quantile(values, (0.01, 0.99))  # one wild sample must not make all others alike
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
    """Return the states of a log, once per PERIOD: velocity, motor torque, angle, temperature, bending, age."""
    step = max(1, round(PERIOD / log.period))
    columns = {name: log[name][::step] for name in log.columns if name not in log.derived}
    angle = columns.get("q_j", columns.get("q_m"))
    velocity = columns.get("omega_j", columns.get("omega_m"))
    if velocity is None and angle is not None:
        velocity = np.gradient(angle, step * log.period) if len(angle) > 1 else np.zeros(len(angle))
    age = np.log1p(columns["t"] - columns["t"][0])  # what relaxes or warms up changes by the logarithm of time
    found = {
        "speed": velocity,
        "load": columns.get("tau_m"),
        "angle": angle,
        "warmth": columns.get("temperature"),
        "bending": columns.get("theta"),
        "age": age,
    }
    return {name: values for name, values in found.items() if values is not None}
