"""Is anything left that no effect of the catalogue explains? Blocked cross-validation against two nulls.

A family of columns is fitted to some blocks of the white residual and predicts the others. On noise it predicts worse
than nothing; how much worse is drawn twice: with new noise, and with the residual's own blocks under random signs,
which keeps whatever noise is really like within a block. What is left must beat both, and be large enough to matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.problem import orthonormal
from tsa_ctrl.identify.diagnosis.selection.entry import FOLDS
from tsa_ctrl.model.functions import Array

DRAWS = 200  # mean and spread of a null are then known to 7 %, and five of these to a third
# Precision of a coefficient before the data, white units: small, large, and hardly any dependence, the best counts
RIDGES = (3.0, 30.0, 300.0)
# Standard deviations of the null: ten families are looked at, of which none may be found by chance in 1 % of the logs
SURE = 5.0
DISTINCT = 1e-2  # of a column's size: what two columns differ by less is the noise of what they are made from
# Least share of the mean square of the white residual: 2.5 % of its RMS has no practical use. A smaller share also gets
# no term in a formula (parameters.formula.LEAST_PART).
LEAST_SHARE = 0.05


@dataclass(frozen=True)
class Finding:
    """One test of what is left. `share` of the white residual's mean square is predicted on blocks not fitted on."""

    what: str
    share: float
    score: float  # standard deviations above the null
    found: bool


def dependence(
    residual: Array, jacobian: Array, columns: Mapping[str, Array], blocks: NDArray[np.int64], rng: np.random.Generator
) -> list[Finding]:
    """Return one finding per family.

    residual (m,) and columns (m, k) white; jacobian (m, p) of what was fitted.
    """
    basis = orthonormal(jacobian)
    rest = residual - basis @ (basis.T @ residual)
    findings = []
    for what, family in columns.items():
        free = orthonormal(family - basis @ (basis.T @ family), DISTINCT)
        scaled = free * np.sqrt(len(rest) / max(free.shape[1], 1))
        draws = _drawn(int(blocks[-1]) + 1, free.shape[1], rng)
        share, score = _predictable(rest, scaled, blocks, draws)
        findings.append(Finding(what, share, score, score > SURE and share > LEAST_SHARE))
    return findings


def _drawn(count: int, k: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Of `count` blocks normal numbers (count, k, DRAWS) and signs (count, 1, DRAWS); none are drawn for no column."""
    if k == 0:
        return np.zeros((count, 0, DRAWS)), np.ones((count, 1, DRAWS))
    normal = np.array([rng.standard_normal((k, DRAWS)) for _ in range(count)])
    return normal, rng.choice([-1.0, 1.0], (count, 1, DRAWS))


def _predictable(
    residual: Array, columns: Array, blocks: NDArray[np.int64], draws: tuple[Array, Array]
) -> tuple[float, float]:
    """Share of the residual that is predicted on other blocks, and its distance from the nulls."""
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
    """Decrease of the sum of squares on blocks not fitted on, for each trial: (trials,)."""
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
