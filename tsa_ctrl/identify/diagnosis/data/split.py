"""Which samples a diagnosis learns from and which it is checked with.

With several logs, whole logs are held out: those that match a pattern, else every third by name. With one or two logs,
every third of some stretches is held out, with gaps. The selection still learns from these stretches: without them
three of 82 short blind logs had a worse answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import held_out_blocks, held_out_logs
from tsa_ctrl.identify.diagnosis.data.frame import Frame, Run, block_numbers

STRETCHES = 12  # of one log; every third is held out
GAP = 0.3  # s between fitted and held-out samples, in which the effect of a reversal on the torque decays
# s at either end of a log whose motion was derived: a low-pass of the joints' motion sees that far beyond it
ENDS = 0.15
FIRST_SPEED = 0.01  # of the fastest: slower is standstill at the log's start
FIRST_TRAVEL = 0.02  # of half the range, after which the friction no longer depends on the motion before a rest


@dataclass(frozen=True)
class Split:
    """`frame` learns from all samples that selection may use; `fit` and `held` (n) are for the held-out figures.

    Shipped numbers are fitted on `shipped` (n).
    """

    frame: Frame
    fit: NDArray[np.bool_]
    held: NDArray[np.bool_]
    shipped: NDArray[np.bool_]
    held_logs: tuple[str, ...]  # empty: stretches were held out


def split(runs: Sequence[Run], hold_out: str | None) -> Split:
    """Split the runs into fitted and held-out samples; raise UsageError if the pattern matches no log or all logs."""
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
    """Score samples that no derivative's filter reached beyond the log for."""
    out = np.ones(run.count, dtype=np.bool_)
    if {"omega_j", "omega_m"} & run.raw.derived or "tau_j" not in run.raw:
        ends = min(round(ENDS / run.period), run.count // 20)
        out[:ends] = out[run.count - ends :] = False
    out[: _unknown(run)] = False
    return out


def _unknown(run: Run) -> int:
    """Return the number of first score samples with unknown friction of a log that begins at standstill."""
    omega = run.average(run.signals.omega_j)
    travel = np.cumsum(np.abs(omega)) * run.period
    if abs(omega[0]) > FIRST_SPEED * float(np.quantile(np.abs(omega), 0.95)):
        return 0
    return int(np.searchsorted(travel, FIRST_TRAVEL * 0.5 * float(np.ptp(np.cumsum(omega))) * run.period))


def _stretches(counts: Sequence[int], period: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Hold out the stretches 1, 4, 7 ... of each log; the gap on either side belongs to neither part."""
    fit, held = [], []
    for count in counts:
        gap = min(round(GAP / period), count // (8 * STRETCHES))
        outside, inside = held_out_blocks(count, STRETCHES, 1, gap)
        held.append(inside)
        fit.append(outside)
    return np.concatenate(fit), np.concatenate(held)
