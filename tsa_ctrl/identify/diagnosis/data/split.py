"""Split the samples of a diagnosis into fitted and held-out samples.

With several logs, whole logs are held out: those that match a pattern, or else every third by name. With one or two
logs, every third of STRETCHES parts of each log is held out, with gaps. The selection still uses these parts: without
them, three of 82 short blind logs had a worse answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import held_out_blocks, held_out_logs
from tsa_ctrl.identify.diagnosis.data.frame import Frame, Run, block_numbers

STRETCHES = 12  # number of parts of one log, every third of them held out
GAP = 0.3  # s between fitted and held-out samples, in which the effect of a reversal on the torque decays
# s excluded at either end of a log with derived motion: the low-pass of the motion reaches this far beyond the log
ENDS = 0.15
FIRST_SPEED = 0.01  # share of the 95th percentile of speed: slower motion at the start of a log is standstill
FIRST_TRAVEL = 0.02  # share of half the range after which friction no longer depends on the motion before a rest


@dataclass(frozen=True)
class Split:
    """Hold the frame with all samples that the selection may use, and the masks (n,) of other fits.

    The held-out errors are fitted on `fit` and measured on `held`. The reported parameters are fitted on `shipped`.
    """

    frame: Frame
    fit: NDArray[np.bool_]
    held: NDArray[np.bool_]
    shipped: NDArray[np.bool_]
    held_logs: tuple[str, ...]  # empty if parts of each log were held out


def split(runs: Sequence[Run], hold_out: str | None) -> Split:
    """Return the runs split into fitted and held-out samples.

    Raises:
        UsageError: the pattern matches no log, or every log.
    """
    names = [run.name for run in runs]
    chosen = held_out_logs(names, hold_out)
    counts = [run.count for run in runs]
    inner = np.concatenate([settled(run) for run in runs])
    if chosen:
        held = np.repeat([name in chosen for name in names], counts)
        return Split(_frame(runs, ~held & inner), ~held & inner, held, ~held & inner, tuple(sorted(chosen)))
    fit, held = _stretches(counts, runs[0].period)
    return Split(_frame(runs, inner), fit & inner, held, inner, ())


def _frame(runs: Sequence[Run], train: NDArray[np.bool_]) -> Frame:
    return Frame(tuple(runs), train, block_numbers([run.count for run in runs], train))


def settled(run: Run) -> NDArray[np.bool_]:
    """Return a mask of the score samples with valid derivatives and known friction.

    It excludes the ends of a log with derived motion, where the filters reach beyond the log.
    """
    out = np.ones(run.count, dtype=np.bool_)
    if {"omega_j", "omega_m"} & run.raw.derived or "tau_j" not in run.raw:
        ends = min(round(ENDS / run.period), run.count // 20)
        out[:ends] = out[run.count - ends :] = False
    out[: _unknown(run)] = False
    return out


def _unknown(run: Run) -> int:
    """Return the number of score samples with unknown friction at the start of a log that begins at standstill."""
    omega = run.average(run.signals.omega_j)
    travel = np.cumsum(np.abs(omega)) * run.period
    if abs(omega[0]) > FIRST_SPEED * float(np.quantile(np.abs(omega), 0.95)):
        return 0
    return int(np.searchsorted(travel, FIRST_TRAVEL * 0.5 * float(np.ptp(np.cumsum(omega))) * run.period))


def _stretches(counts: Sequence[int], period: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the masks of fitted and held-out samples; parts 1, 4, 7 ... of each log are held out.

    The gap on either side of a held-out part belongs to neither mask.
    """
    fit, held = [], []
    for count in counts:
        gap = min(round(GAP / period), count // (8 * STRETCHES))
        outside, inside = held_out_blocks(count, STRETCHES, 1, gap)
        held.append(inside)
        fit.append(outside)
    return np.concatenate(fit), np.concatenate(held)
