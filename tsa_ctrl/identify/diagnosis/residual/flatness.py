"""Test whether the sliding error of the extended model is flat against time, angle, speed and load, in both directions.

A model explains a log if neither the mean nor the mean square of its residual depends on any signal. The test divides
each signal into ranges and computes the mean of the residual in each range. Each mean is computed twice, from alternate
pieces of time. Noise differs between the two means, while a dependence is the same. Their product is therefore the mean
square of the dependence, without a contribution of the noise. A mean square that varies indicates an error of both
signs, for example of a drive that reports 0 below a threshold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.data.frame import Run
from tsa_ctrl.identify.diagnosis.data.split import settled
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding, is_rounding
from tsa_ctrl.identify.three_errors import UNKNOWN, known_direction
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import hold_direction

RANGES = 10  # ranges of each signal, with equal numbers of samples
PIECES = 16  # pieces of time in each range of time, assigned alternately to the two halves
# Least dependence in units of the sensor noise: in one blind log of 15 s, slow noise alone showed a dependence of 0.75
LEAST = 1.0
FEWEST = 40  # least number of samples of a range in each half


def not_flat(runs: Sequence[Run], residuals: Sequence[Array], noise: float) -> Finding | None:
    """Return the finding for the signal on which the sliding error depends most.

    The result is None if no dependence exceeds LEAST times the noise or rounding, or if there are too few samples. A
    sample counts only if the denoised velocity also shows its direction. A wrong direction is an error of the log, not
    of the model.

    Args:
        runs: the logs.
        residuals: measured minus predicted torque of each run at the log's own rate, (n,) in N*m.
        noise: sensor noise, N*m RMS.
    """
    known = [known_direction(run.raw) & _sure(run) for run in runs]
    rest = np.concatenate([each[slides] for each, slides in zip(residuals, known, strict=True)])
    target = np.concatenate([run.full_target[slides] for run, slides in zip(runs, known, strict=True)])
    if noise <= 0.0 or len(rest) < 2 * FEWEST * RANGES or is_rounding(rest, target):
        return None
    signals: dict[str, list[Array]] = {"the time": [], "the joint angle": [], "the speed": [], "the load": []}
    ways, halves, start = [], [], 0.0
    for run, residual, slides in zip(runs, residuals, known, strict=True):
        s = run.full
        angle = np.cumsum(s.omega_j) * s.period if s.q_j is None else s.q_j
        moment = start + np.arange(len(s)) * s.period
        of = (moment, angle, s.omega_j, run.full_target - residual)
        for values, column in zip(signals.values(), of, strict=True):
            values.append(np.asarray(column[slides], dtype=np.float64))
        ways.append(hold_direction(s.omega_j)[slides])
        halves.append((np.arange(len(s)) * RANGES * PIECES // max(len(s), 1) % 2 == 0)[slides])
        start = float(moment[-1])
    way, half = np.concatenate(ways), np.concatenate(halves)
    total = float(rest @ rest)
    best = None
    for name, parts in signals.items():
        driver, size = np.concatenate(parts), np.square(rest)
        square = dependent(rest, driver, way, half)
        square = max(square, math.sqrt(max(dependent(size - size.mean(), driver, way, half), 0.0)))
        if square > (LEAST * noise) ** 2 and (best is None or square * len(rest) / total > best.share):
            best = Finding(name, min(square * len(rest) / total, 1.0), math.sqrt(square) / noise, True)
    return best


def _sure(run: Run) -> NDArray[np.bool_]:
    """Return a mask of the samples with a known direction, (n,) at the log's own rate.

    At these samples the denoised velocity exceeds UNKNOWN times its error, and the velocity of the log has the same
    direction. The ends of the log are excluded, because a derived acceleration is not reliable there.
    """
    error = _at_full_rate(run, run.velocity_error, run.full_bin // run.bin)
    inside = _at_full_rate(run, settled(run), run.full_bin)
    alike = hold_direction(run.full.omega_j) == hold_direction(run.raw.signals().omega_j)
    return np.asarray(inside & alike & (np.abs(run.full.omega_j) > UNKNOWN * error))


def _at_full_rate(run: Run, values: NDArray[Any], factor: int) -> NDArray[Any]:
    """Return each value repeated for `factor` samples, (n,); the last value fills the rest of the log."""
    out = np.repeat(values, factor)
    return np.concatenate([out, np.full(max(0, len(run.full) - len(out)), out[-1])])[: len(run.full)]


def dependent(rest: Array, values: Array, way: Array, half: NDArray[np.bool_]) -> float:
    """Return the mean square of the part of `rest` (m,) that depends on `values` (m,) and the direction `way` (m,).

    half: mask of the first half, (m,). The expected value for pure noise is 0.
    """
    edges = np.quantile(values, np.linspace(0.0, 1.0, RANGES + 1)[1:-1])
    cell = np.searchsorted(edges, values) * 2 + (way > 0.0)
    sums = [np.bincount(cell[use], rest[use], 2 * RANGES) for use in (half, ~half)]
    counts = [np.bincount(cell[use], minlength=2 * RANGES) for use in (half, ~half)]
    enough = (counts[0] >= FEWEST) & (counts[1] >= FEWEST)
    if not enough.any():
        return 0.0
    means = [each[enough] / count[enough] for each, count in zip(sums, counts, strict=True)]
    return float(np.sum((counts[0] + counts[1])[enough] * means[0] * means[1]) / len(rest))
