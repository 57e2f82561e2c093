"""Does an effect hold up? Family-wise threshold, block-robust test, blocked cross-validation, size.

With the effects' own columns thousands of samples make any trifle significant in white noise; so an entry must also
hold between about 24 blocks, predict blocks that it was not fitted on, and be large enough to matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import Score

DRAWS = 300
FAMILY_LEVEL = 0.002  # chance that the best of all candidates passes the threshold on noise alone
FOLDS = 6


@dataclass(frozen=True)
class Evidence:
    """Of one effect beside the others."""

    gain: float  # decrease of the sum of squares, white units
    block_t: float  # block-robust t of its strength
    cross_validated: float  # decrease on blocks not fitted on, white units
    spread: float  # share of the gain that is left without the block that gains most
    size: float  # RMS of what it adds, N*m at the score rate

    @property
    def kept(self) -> float:
        """Share of the gain that holds on blocks not fitted on."""
        return self.cross_validated / self.gain if self.gain > 0.0 else 0.0


def family_threshold(rng: np.random.Generator, found: Sequence[Score]) -> float:
    """Decrease of the sum of squares that the best candidate exceeds on noise with probability FAMILY_LEVEL.

    Parametric bootstrap: white noise projected on every candidate's response; the maximum's tail by a Gumbel law.
    """
    bases = [orthonormal(score.columns) for score in found]
    bases = [basis for basis in bases if basis.shape[1]]
    if not bases:
        return 0.0
    columns = np.concatenate(bases, axis=1)
    groups = np.repeat(np.arange(len(bases)), [basis.shape[1] for basis in bases])
    gram = columns.T @ columns
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    projections = (root @ rng.standard_normal((len(values), DRAWS))) ** 2
    sums = np.zeros((len(bases), DRAWS))
    np.add.at(sums, groups, projections)
    best = sums.max(axis=0)
    scale = float(np.std(best)) * np.sqrt(6.0) / np.pi
    return float(np.mean(best) - 0.5772 * scale - scale * np.log(-np.log1p(-FAMILY_LEVEL)))


def evidence(problem: Problem, smaller: Fit, larger: Fit) -> Evidence:
    """What `larger` has over `smaller`, of which it is an extension."""
    difference = smaller.residual - larger.residual
    basis = orthonormal(smaller.jacobian)
    difference = difference - basis @ (basis.T @ difference)
    blocks = problem.blocks
    count = int(blocks[-1]) + 1
    scores = np.bincount(blocks, difference * larger.residual, count)
    spread = float(np.sqrt(np.sum(scores**2) * count / max(count - 1, 1)))
    strength = float(difference @ smaller.residual)
    gains = np.bincount(blocks, smaller.residual**2 - larger.residual**2, count)
    gain = float(gains.sum())
    before = problem.predicted(smaller.hypothesis.model(smaller.point))
    after = problem.predicted(larger.hypothesis.model(larger.point))
    change = (after - before)[problem.mask]
    return Evidence(
        gain=gain,
        block_t=strength / max(spread, 1e-12),
        cross_validated=cross_validated(smaller, blocks) - cross_validated(larger, blocks),
        spread=1.0 - float(gains.max()) / gain if gain > 0.0 else 0.0,
        size=float(np.sqrt(np.mean(change**2))),
    )


def cross_validated(fitted: Fit, blocks: NDArray[np.int64]) -> float:
    """Sum of squares over blocks that the coordinates were not fitted on (one Gauss-Newton step from the full fit)."""
    jacobian = fitted.jacobian
    if jacobian.shape[1] == 0:
        return fitted.rss
    width = 0.5 * (fitted.hypothesis.high - fitted.hypothesis.low)[fitted.free]
    prior = np.diag(1.0 / width**2)  # a coordinate moves within its bounds, however little one fold knows of it
    gram = jacobian.T @ jacobian + prior
    total = 0.0
    for fold in range(FOLDS):
        inside = blocks % FOLDS == fold
        part, rest = jacobian[inside], fitted.residual[inside]
        left = gram - part.T @ part
        left[np.diag_indices(len(left))] *= 1.0 + 1e-9
        step = np.linalg.solve(left, jacobian[~inside].T @ fitted.residual[~inside])
        total += float(np.sum((rest - part @ step) ** 2))
    return total
