"""Test whether the residual depends on signals, by blocked cross-validation against two null distributions.

A family of columns is fitted to some blocks of the white residual and predicts the other blocks. On pure noise this
prediction increases the sum of squares. Two null distributions determine the increase. One uses new white noise. The
other uses the blocks of the residual with random signs, which keeps the true properties of the noise within a block.
The gain on the residual must exceed both null distributions and be large enough to matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import DRAWS, FOLDS, LEAST_SHARE, ROUNDING
from tsa_ctrl.identify.diagnosis.fitting.problem import orthonormal
from tsa_ctrl.model.functions import Array

# Prior precision of a coefficient, white units, for strong, weak and very weak dependence: the best of them counts
RIDGES = (3.0, 30.0, 300.0)
# Standard deviations above the null: with ten families, chance produces a finding in at most 1 % of the logs
SURE = 5.0
DISTINCT = 1e-2  # share of a column's size: smaller differences between columns are noise of the underlying signals


@dataclass(frozen=True)
class Finding:
    """Result of one test of the residual."""

    what: str  # the signal or the kind of structure, as in the report
    share: float  # part of the mean square of the residual; for a family, the part predicted on blocks outside the fit
    score: float  # test statistic; for a family, standard deviations above the null
    found: bool  # True if the result is significant and large enough to matter
    of_residual: float | None = None  # part of the residual's mean square, if `share` refers to the noise

    @property
    def shown(self) -> float:
        """Return the part of the mean square of the residual, for reports."""
        return self.share if self.of_residual is None else self.of_residual


def is_rounding(residual: Array, target: Array) -> bool:
    """Return True if a residual is as small, relative to the torque, as the rounding of the numbers."""
    return float(np.mean(np.square(residual))) <= ROUNDING * float(np.mean(np.square(target)))


def dependence(
    residual: Array, jacobian: Array, columns: Mapping[str, Array], blocks: NDArray[np.int64], rng: np.random.Generator
) -> list[Finding]:
    """Return one finding for each family.

    Args:
        residual: white residual, (m,).
        jacobian: white gradients of the fit, (m, p).
        columns: white columns of each family by its name, (m, k).
        blocks: block number of each sample, (m,).
        rng: generator of the random trials.
    """
    basis = orthonormal(jacobian)
    rest = residual - basis @ (basis.T @ residual)
    findings = []
    for what, family in columns.items():
        left = family - basis @ (basis.T @ family)
        distinct = np.linalg.norm(left, axis=0) > DISTINCT * np.linalg.norm(family, axis=0)
        free = orthonormal(left[:, distinct], DISTINCT)
        scaled = free * np.sqrt(len(rest) / max(free.shape[1], 1))
        draws = _drawn(int(blocks[-1]) + 1, free.shape[1], rng)
        share, score = _predictable(rest, scaled, blocks, draws)
        findings.append(Finding(what, share, score, score > SURE and share > LEAST_SHARE))
    return findings


def _drawn(count: int, k: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return random normal numbers (count, k, DRAWS) and signs (count, 1, DRAWS) for `count` blocks.

    For k = 0 no random number is used, and all signs are 1.
    """
    if k == 0:
        return np.zeros((count, 0, DRAWS)), np.ones((count, 1, DRAWS))
    normal = np.array([rng.standard_normal((k, DRAWS)) for _ in range(count)])
    return normal, rng.choice([-1.0, 1.0], (count, 1, DRAWS))


def _predictable(
    residual: Array, columns: Array, blocks: NDArray[np.int64], draws: tuple[Array, Array]
) -> tuple[float, float]:
    """Return the share of the residual predicted on blocks outside the fit, and its distance from the nulls.

    The distance is measured to the nearer of the two null distributions, in standard deviations.
    """
    normal, signs = draws
    count, k, _ = normal.shape
    if k == 0:
        return 0.0, 0.0
    grams = np.zeros((count, k, k))
    own = np.zeros((count, k))
    noise = np.zeros((count, k, DRAWS))
    for block in range(count):
        inside = columns[blocks == block]
        grams[block] = inside.T @ inside
        own[block] = inside.T @ residual[blocks == block]
        values, vectors = np.linalg.eigh(grams[block])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        noise[block] = root @ normal[block]
    trials = np.concatenate([own[:, :, None], noise, own[:, :, None] * signs], axis=2)
    gains = np.max([_cross_validated(grams, trials, ridge) for ridge in RIDGES], axis=0)
    total = float(residual @ residual)
    scores = []
    for null in (gains[1 : 1 + DRAWS], gains[1 + DRAWS :]):
        scores.append((gains[0] - float(np.mean(null))) / max(float(np.std(null)), 1e-9))
    return float(gains[0]) / total, float(min(scores))


def _cross_validated(grams: Array, slopes: Array, ridge: float) -> Array:
    """Return the decrease of the sum of squares on blocks outside the fit for each trial, (trials,)."""
    folds = np.arange(len(grams)) % FOLDS
    whole, total = grams.sum(axis=0), slopes.sum(axis=0)
    out = np.zeros(slopes.shape[2])
    for fold in range(FOLDS):
        gram = grams[folds == fold].sum(axis=0)
        slope = slopes[folds == fold].sum(axis=0)
        left = whole - gram + ridge * np.eye(len(whole))
        weights = np.linalg.solve(left, total - slope)
        out += 2.0 * np.sum(weights * slope, axis=0) - np.sum(weights * (gram @ weights), axis=0)
    return out
