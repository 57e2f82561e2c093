"""Whether a cause may enter: family-wise threshold, block-robust test, cross-validation, size, simulation error.

With the effects' own columns thousands of samples make any trifle significant in white noise; so an entry must also
hold between about 24 blocks, predict blocks that it was not fitted on, and be large enough to matter.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import Score
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import (
    fit_on_simulation_error,
    models_reversals,
    noise_rms,
    on_simulation_error,
)
from tsa_ctrl.identify.diagnosis.noise.nuisance import Nuisance
from tsa_ctrl.identify.diagnosis.selection.meaning import meaningless
from tsa_ctrl.identify.diagnosis.selection.step import LATE_REVERSALS

DRAWS = 300  # of the best of all candidates: its tail is a Gumbel law of their mean and spread, known to 6 %
# Chance that the best candidate passes on noise alone: 1 % of logs in all may name something, in five rounds
FAMILY_LEVEL = 0.002
FOLDS = 6  # parts left out: each is a sixth, so that what is learned from the others is hardly less than all
BLOCK_T = 4.0  # t of 23 degrees of freedom: 0.06 % two-sided
LATE_T = 3.0  # the same of what is late beside moments that are free, before it is asked whether they show it: 0.6 %
# Share of the gain that holds on blocks not fitted on: fitted noise keeps none, a cause all but its own
LEAST_CROSS_VALIDATED = 0.4
LEAST_OUTSIDE = 0.12  # share of the gain left without the best block: an even one of 24 leaves 0.96, a burst none
# Times the threshold, of the gain outside the best block: so it would enter without it, and as much again
TIMES_OUTSIDE = 2.0
SMALLEST = 0.2  # of the noise RMS: smaller effects change the error by 2 %, which nobody would see
# Of the noise RMS at the score rate, that the simulation error must lose: a sixth of the noise's mean square
LEAST_ERROR_REDUCTION = 0.4
# Logs, each of which must lose more than half of its error by a cause fitted on the others alone: a cause that means
# nothing makes a log better about as often as worse, and halves the error of four hardly ever; fewer logs must lose so
# much more of it that their shares multiply to no more than those of four
ENOUGH_LOGS, FEWEST_LOGS, MOST_LEFT = 4, 2, 0.5
SMALLEST_GAIN = 0.008  # of the number of samples


@dataclass(frozen=True)
class Evidence:
    """Of one effect beside the others."""

    gain: float  # decrease of the sum of squares, white units
    block_t: float  # block-robust t of its strength
    cross_validated: float  # decrease on blocks not fitted on, white units
    outside_best_block: float  # share of the gain that is left without the block that gains most
    size: float  # RMS of what it adds, N*m at the score rate

    @property
    def cross_validated_share(self) -> float:
        """Share of the gain that holds on blocks not fitted on."""
        return self.cross_validated / self.gain if self.gain > 0.0 else 0.0

    @property
    def holds(self) -> bool:
        """Whether it holds between blocks, and on blocks not fitted on."""
        return self.block_t > BLOCK_T and self.cross_validated_share > LEAST_CROSS_VALIDATED


def entry_threshold(rng: np.random.Generator, found: Sequence[Score]) -> float:
    """Decrease of the sum of squares that the best candidate exceeds on noise with probability FAMILY_LEVEL.

    Parametric bootstrap: white noise projected on every candidate's response; the maximum's tail by a Gumbel law.
    """
    bases = [basis for basis in (orthonormal(score.columns) for score in found) if basis.shape[1]]
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
    """What `larger` has over `smaller`, to which it adds one effect."""
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
        outside_best_block=1.0 - float(gains.max()) / gain if gain > 0.0 else 0.0,
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


def enters(problem: Problem, before: Fit, found: Fit, threshold: float) -> bool:
    """Whether the last effect of `found` is to be named beside those of `before`.

    threshold: of the decrease of the sum of squares, for the family of candidates (white units).
    """
    if meaningless(problem, found):
        return False
    needed = max(threshold, SMALLEST_GAIN * problem.count)
    proof = evidence(problem, before, found)
    holds = proof.holds and proof.gain > needed
    if holds and _is_broad_and_large(problem, before, found, proof, needed):
        return True
    late = not before.names and found.names[-1] in LATE_REVERSALS
    if late and proof.gain > needed and proof.block_t > LATE_T and _in_all_reversals(problem, before, found, needed):
        return True
    return not holds and transfers(problem, before, found)


def _in_all_reversals(problem: Problem, before: Fit, found: Fit, needed: float) -> bool:
    """Whether a lateness shows where the moments of reversals are not free.

    Few reversals show one of a sample or two beside moments that are; all do when they are not.
    """
    bare = dataclasses.replace(problem, nuisance=Nuisance(problem.nuisance.smooth))
    smaller, larger = (fit(bare, each.hypothesis, each.point) for each in (before, found))
    proof = evidence(bare, smaller, larger)
    return proof.holds and proof.gain > needed and _is_broad_and_large(bare, smaller, larger, proof, needed)


def transfers(problem: Problem, before: Fit, found: Fit) -> bool:
    """Whether the last effect of `found` takes most of the simulation error of every log that it was not fitted on.

    Of short logs a noise model cannot tell a large cause from slow noise, for each shows one swing of it; but slow
    noise of one log does not foretell another one's.
    """
    logs = [part for part in problem.frame.slices if problem.mask[part].any()]
    if len(logs) < FEWEST_LOGS:
        return False
    reversals = models_reversals(found) or not problem.nuisance.moments
    plain = on_simulation_error(problem, reversals)
    if fit(plain, found.hypothesis, found.point).rss > MOST_LEFT * fit(plain, before.hypothesis, before.point).rss:
        return False  # cheap, and most candidates end here
    share = 1.0
    for part in logs:
        inside = np.zeros(len(problem.frame), dtype=np.bool_)
        inside[part] = True
        errors = []
        for each in (before, found):
            learned = fit_on_simulation_error(problem, each, reversals, problem.mask & ~inside)
            left = (problem.frame.target - problem.predicted(learned.hypothesis.model(learned.point)))[part]
            errors.append(float(np.sum(np.square(left[problem.mask[part]]))))
        if errors[1] > MOST_LEFT * errors[0]:
            return False
        share *= errors[1] / errors[0]
    return share <= MOST_LEFT**ENOUGH_LOGS


def _is_broad_and_large(problem: Problem, before: Fit, found: Fit, proof: Evidence, needed: float) -> bool:
    """More than a burst in one block (without a parameter there is nothing to fit one with), and large enough."""
    return (
        (proof.outside_best_block > LEAST_OUTSIDE or not found.hypothesis.variants[-1].coordinates)
        and proof.outside_best_block * proof.gain > TIMES_OUTSIDE * needed
        and proof.size > SMALLEST * noise_rms(problem, found)
        and _reduces_simulation_error(problem, before, found)
    )


def _reduces_simulation_error(problem: Problem, smaller: Fit, larger: Fit) -> bool:
    """Whether the simulation error loses enough: what noise of an input feigns gains next to nothing.

    Measured by the noise, or by all that is left where a noise model that holds structure exceeds it.
    """
    reversals = models_reversals(larger) or not problem.nuisance.moments
    before, after = (fit_on_simulation_error(problem, fitted, reversals).rss for fitted in (smaller, larger))
    return before - after > LEAST_ERROR_REDUCTION**2 * min(problem.count, after)
