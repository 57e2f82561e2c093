"""Define the data of a diagnosis: denoised runs, stacked at the score rate, at which torques are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.criteria import BLOCKS
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import Signals, last_reversal

SHORT_BIN = 8  # samples below which column sums take a quarter of the time of means over rows, with equal results


@dataclass(frozen=True)
class Run:
    """One log: `signals` and `target` (n,) at the compute rate, with `bin` samples per score sample.

    `full` and `full_target` are the same at the log's own rate, with `full_bin` samples per score sample.
    """

    name: str
    signals: Signals
    target: Array  # N*m, measurement of the torque that the model predicts
    bin: int
    velocity_noise: float  # rad/s, noise of the denoised velocity
    velocity_error: Array  # (n,) rad/s: noise, and possible distortion by denoising and differentiation
    raw: Dataset
    full: Signals
    full_target: Array
    full_bin: int
    band: float = math.inf  # Hz, limit of derived motion, because friction does not follow faster motion
    hidden: float = 0.0  # share of the time in which the velocity shows no direction
    told: float = math.nan  # mean probability of the direction assumed there; nan if none is assumed

    @property
    def target_name(self) -> str:
        """Return the name of the column that the model predicts."""
        return "tau_m" if self.full_target is self.raw.columns.get("tau_m") else "tau_j"

    @property
    def count(self) -> int:
        """Return the number of score samples."""
        return len(self.target) // self.bin

    @property
    def period(self) -> float:
        """Return the period of the score samples, s."""
        return self.signals.period * self.bin

    @property
    def angle(self) -> Array:
        """Return the joint angle at the compute rate, rad; it is the integral of the velocity if the log lacks it."""
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
        total = bins[:, 0] + 0.0  # a mean also starts from 0.0, so that -0.0 becomes 0.0
        for k in range(1, self.bin):
            total += bins[:, k]
        return np.asarray(total / self.bin)


@dataclass(frozen=True)
class Frame:
    """All runs stacked at the score rate; `train` (n,) is the mask of the samples to fit."""

    runs: tuple[Run, ...]
    train: NDArray[np.bool_]
    blocks: NDArray[np.int64]  # (n,), block number of each sample; all blocks have about as many train samples

    @property
    def period(self) -> float:
        """Return the period of the score samples, s."""
        return self.runs[0].period

    @cached_property
    def slices(self) -> list[slice]:
        """Return the slice of each run in a stacked array."""
        edges = np.concatenate([[0], np.cumsum([run.count for run in self.runs])])
        return [slice(int(a), int(b)) for a, b in pairwise(edges)]

    def logs(self, used: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the log number of each used sample, counted from 0 among the logs with used samples."""
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
        """Return the measured torque at the score rate, (n,) in N*m."""
        return self.stack([run.target for run in self.runs])

    @property
    def seconds(self) -> float:
        return len(self) * self.period


def block_numbers(counts: Sequence[int], used: NDArray[np.bool_], blocks: int = BLOCKS) -> NDArray[np.int64]:
    """Return the block number of each sample; a block is contiguous within one run and includes unused samples."""
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
