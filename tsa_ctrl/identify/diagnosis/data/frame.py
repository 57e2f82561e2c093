"""The logs as a diagnosis sees them: denoised runs, stacked at the rate at which torques are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import Signals, last_reversal

BLOCKS = 24  # for block-robust statistics
SHORT_BIN = 8  # samples, below which column sums take a quarter of the time of means over rows, in the same order


@dataclass(frozen=True)
class Run:
    """One log: `signals` and `target` (n) at the compute rate, `bin` of them to one score sample.

    `full` and `full_target` are the same at the log's own rate, `full_bin` of them to one score sample.
    """

    name: str
    signals: Signals
    target: Array  # N*m, measured; what the model predicts
    bin: int
    velocity_noise: float  # rad/s, of the denoised velocity
    velocity_error: Array  # (n) rad/s: noise, and possible distortion by denoising and differentiation
    raw: Dataset
    full: Signals
    full_target: Array
    full_bin: int
    band: float = math.inf  # Hz, to which derived motion was narrowed because friction follows no more of it
    hidden: float = 0.0  # share of the time in which the velocity shows no direction
    told: float = math.nan  # mean probability of the direction that is taken there; nan where none is

    @property
    def target_name(self) -> str:
        """The column that the model predicts."""
        return "tau_m" if self.full_target is self.raw.columns.get("tau_m") else "tau_j"

    @property
    def count(self) -> int:
        """Number of score samples."""
        return len(self.target) // self.bin

    @property
    def period(self) -> float:
        """Of the score samples, s."""
        return self.signals.period * self.bin

    @property
    def angle(self) -> Array:
        """Joint angle at the compute rate, rad; the integral of the velocity where the log has none."""
        s = self.signals
        return s.q_j if s.q_j is not None else np.asarray(np.cumsum(s.omega_j) * s.period)

    def since_reversal(self) -> tuple[Array, Array]:
        """Return the time (s) and the distance (rad) since the last reversal, at the compute rate."""
        s, angle = self.signals, self.angle
        last = last_reversal(s.omega_j)
        elapsed = np.asarray((np.arange(len(s)) - last) * s.period, dtype=np.float64)
        return elapsed, np.asarray(np.abs(angle - angle[last]), dtype=np.float64)

    def average(self, y: Array) -> Array:
        """Return the means over bins: shape (count,) from (n,), or (count, k) from (n, k)."""
        bins = y[: self.count * self.bin].reshape(self.count, self.bin, *y.shape[1:])
        if self.bin >= SHORT_BIN or y.ndim > 1:
            return np.asarray(bins.mean(axis=1))
        total = bins[:, 0] + 0.0  # as a mean begins: -0.0 is 0.0
        for k in range(1, self.bin):
            total += bins[:, k]
        return np.asarray(total / self.bin)


@dataclass(frozen=True)
class Frame:
    """All runs stacked at the score rate; `train` (n) masks the samples to learn from."""

    runs: tuple[Run, ...]
    train: NDArray[np.bool_]
    blocks: NDArray[np.int64]  # (n), block number of each sample, over the train samples about equal in length

    @property
    def period(self) -> float:
        """Of the score samples, s."""
        return self.runs[0].period

    @cached_property
    def slices(self) -> list[slice]:
        """Return the place of each run in a stacked array."""
        edges = np.concatenate([[0], np.cumsum([run.count for run in self.runs])])
        return [slice(int(a), int(b)) for a, b in pairwise(edges)]

    def logs(self, used: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the log number of each used sample, counted from 0 over the logs with used samples."""
        log = np.repeat(np.arange(len(self.runs)), [run.count for run in self.runs])
        return np.asarray(np.unique(log[used], return_inverse=True)[1], dtype=np.int64)

    def __len__(self) -> int:
        return sum(run.count for run in self.runs)

    def stack(self, parts: Sequence[Array]) -> Array:
        """Return the stacked averages of per-run arrays at the compute rate."""
        return np.concatenate([run.average(part) for run, part in zip(self.runs, parts, strict=True)])

    def column(self, name: str) -> Array:
        """Return a column of `Signals` at the score rate, stacked."""
        return self.stack([getattr(run.signals, name) for run in self.runs])

    def has(self, name: str) -> bool:
        return all(getattr(run.signals, name) is not None for run in self.runs)

    @cached_property
    def target(self) -> Array:
        """N*m, measured, at the score rate, (n,)."""
        return self.stack([run.target for run in self.runs])

    @property
    def seconds(self) -> float:
        return len(self) * self.period


def block_numbers(counts: Sequence[int], used: NDArray[np.bool_], blocks: int = BLOCKS) -> NDArray[np.int64]:
    """Return the block of each sample. A block is contiguous within one run, and includes its unused samples."""
    total = int(used.sum())
    labels = np.zeros(sum(counts), dtype=np.int64)
    start, number = 0, 0
    for count in counts:
        here = used[start : start + count]
        share = max(1, round(blocks * int(here.sum()) / max(total, 1)))
        passed = np.cumsum(here)
        inside = np.minimum((passed - 1).clip(0) * share // max(int(passed[-1]), 1), share - 1)
        labels[start : start + count] = number + inside
        start, number = start + count, number + share
    return labels
