"""Decide whether a cause enters: family-wise threshold, block-robust test, cross-validation, size, simulation error.

With thousands of samples of white noise, even a negligible effect is statistically significant. A cause must therefore
also be consistent over about 24 blocks, predict blocks that it was not fitted on, and be large enough to matter.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import BEYOND, CERTAIN, FOLDS
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

DRAWS = 300  # random trials of the gain of the best candidate: they determine the spread of its Gumbel tail to 6 %
# Probability that the best candidate passes on noise alone: over five rounds, 1 % of all logs may yield a false cause
FAMILY_LEVEL = 0.002
# Least share of the gain that remains on blocks not used in the fit. Fitted noise keeps nothing; a true cause loses
# only what it gained by fitting noise.
LEAST_CROSS_VALIDATED = 0.4
# Least share of the gain without the best block: a gain spread evenly over 24 blocks keeps 0.96, a single burst keeps
# nothing
LEAST_OUTSIDE = 0.12
# Least ratio of the gain outside the best block to the threshold: without that block, the gain is still twice the
# threshold
TIMES_OUTSIDE = 2.0
SMALLEST = 0.2  # share of the noise RMS: a smaller effect changes the error by 2 %, which is not visible
# Least reduction of the simulation error as a share of the noise RMS at the score rate: a sixth of the mean square of
# the noise
LEAST_ERROR_REDUCTION = 0.4
# A cause fitted only on the other logs must remove more than half of the error of each log. A meaningless cause
# improves a log about as often as it makes it worse, and hardly ever halves the error of four logs. With fewer logs,
# more must be removed from each, so that the product of the remaining shares is not larger than with four.
ENOUGH_LOGS, FEWEST_LOGS, MOST_LEFT = 4, 2, 0.5
SMALLEST_GAIN = 0.008  # least gain as a share of the number of samples: significant but smaller gains are negligible


@dataclass(frozen=True)
class Evidence:
    """Evidence for one effect in addition to the other effects of a fit."""

    gain: float  # decrease of the sum of squares, white units
    block_t: float  # block-robust t statistic of the effect
    cross_validated: float  # decrease of the sum of squares on blocks not used in the fit, white units
    outside_best_block: float  # share of the gain that remains without the block with the largest gain
    size: float  # RMS change of the prediction, N*m at the score rate

    @property
    def cross_validated_share(self) -> float:
        """Return the share of the gain that remains on blocks not used in the fit; 0 without a gain."""
        return self.cross_validated / self.gain if self.gain > 0.0 else 0.0

    @property
    def holds(self) -> bool:
        """Return True if the effect is consistent between blocks and predicts blocks not used in the fit."""
        return self.block_t > CERTAIN and self.cross_validated_share > LEAST_CROSS_VALIDATED


def entry_threshold(rng: np.random.Generator, found: Sequence[Score]) -> float:
    """Return the decrease of the sum of squares that the best candidate exceeds on noise with probability FAMILY_LEVEL.

    The threshold is computed by a parametric bootstrap: white noise is projected on the response of every candidate.
    The tail of the maximum is modelled by a Gumbel distribution. The threshold is 0 if there is no candidate.
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
    """Return the evidence for the effect that `larger` has in addition to those of `smaller`."""
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
    """Return the sum of squares over blocks that were not used to fit the coordinates, white units.

    Each fold takes one Gauss-Newton step from the fit on all samples.
    """
    jacobian = fitted.jacobian
    if jacobian.shape[1] == 0:
        return fitted.rss
    width = 0.5 * (fitted.hypothesis.high - fitted.hypothesis.low)[fitted.free]
    prior = np.diag(1.0 / width**2)  # keeps coordinates within their bounds if a fold hardly determines them
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
    """Return True if the last effect of `found` is accepted in addition to the effects of `before`.

    An effect whose parameters are not meaningful never enters. Any other effect enters in one of three cases:

    1. It passes all tests.
    2. It is a lag or a delay, is the first cause, and passes all tests with fixed reversal times. With free reversal
       times, only its gain and a lower t are tested.
    3. Its evidence is too weak, but it transfers to other logs.

    Args:
        problem: the logs with the noise model.
        before: the fit without the effect.
        found: the fit with the effect, which is its last one.
        threshold: least decrease of the sum of squares for the family of candidates, white units.
    """
    if meaningless(problem, found):
        return False
    needed = max(threshold, SMALLEST_GAIN * problem.count)
    proof = evidence(problem, before, found)
    holds = proof.holds and proof.gain > needed
    if holds and _is_broad_and_large(problem, before, found, proof, needed):
        return True
    late = not before.names and found.names[-1] in LATE_REVERSALS
    if late and proof.gain > needed and proof.block_t > BEYOND and _in_all_reversals(problem, before, found, needed):
        return True
    return not holds and transfers(problem, before, found)


def _in_all_reversals(problem: Problem, before: Fit, found: Fit, needed: float) -> bool:
    """Return True if a lag or a delay passes all tests when the times of the reversals are not free.

    With free reversal times, only few reversals show a delay of one or two samples. With fixed times, all of them do.
    """
    bare = dataclasses.replace(problem, nuisance=Nuisance(problem.nuisance.smooth))
    smaller, larger = (fit(bare, each.hypothesis, each.point) for each in (before, found))
    proof = evidence(bare, smaller, larger)
    return proof.holds and proof.gain > needed and _is_broad_and_large(bare, smaller, larger, proof, needed)


def transfers(problem: Problem, before: Fit, found: Fit) -> bool:
    """Return True if the last effect of `found` removes most of the simulation error of each log not used in the fit.

    In short logs a noise model cannot distinguish a large cause from slow noise, because each log shows only one period
    of it. However, slow noise of one log does not predict that of another log. The result is False for fewer than
    FEWEST_LOGS logs.
    """
    logs = used_logs(problem)
    if len(logs) < FEWEST_LOGS:
        return False
    reversals = models_reversals(found) or not problem.nuisance.moments
    plain = on_simulation_error(problem, reversals)
    if fit(plain, found.hypothesis, found.point).rss > MOST_LEFT * fit(plain, before.hypothesis, before.point).rss:
        return False  # This test is cheap and rejects most candidates.
    share = 1.0
    for part in logs:
        without, with_it = (_error_on_logs(problem, each, reversals, [part]) for each in (before, found))
        if with_it > MOST_LEFT * without:
            return False
        share *= with_it / without
    return share <= MOST_LEFT**ENOUGH_LOGS


def left_out_error(problem: Problem, found: Fit) -> float:
    """Return the sum of squares of the simulation error of logs that were not used in the fit, (N*m)^2.

    Up to FOLDS groups of successive logs are left out, one group at a time. All coordinates are then fitted to the
    other logs.
    """
    logs = used_logs(problem)
    reversals = models_reversals(found) or not problem.nuisance.moments
    groups = np.array_split(np.arange(len(logs)), min(FOLDS, len(logs)))
    return sum(_error_on_logs(problem, found, reversals, [logs[number] for number in group]) for group in groups)


def used_logs(problem: Problem) -> list[slice]:
    """Return the slice of the frame for each log with samples that are used in the fit."""
    return [part for part in problem.frame.slices if problem.mask[part].any()]


def _error_on_logs(problem: Problem, found: Fit, reversals: bool, logs: Sequence[slice]) -> float:
    """Return the sum of squares of the simulation error on these logs after a fit to the others, (N*m)^2."""
    inside = np.zeros(len(problem.frame), dtype=np.bool_)
    for part in logs:
        inside[part] = True
    learned = fit_on_simulation_error(problem, found, reversals, problem.mask & ~inside)
    left = problem.frame.target - problem.predicted(learned.hypothesis.model(learned.point))
    return float(np.sum(np.square(left[problem.mask & inside])))


def _is_broad_and_large(problem: Problem, before: Fit, found: Fit, proof: Evidence, needed: float) -> bool:
    """Return True if the gain is spread over several blocks and the effect is large enough.

    An effect without parameters is exempt from the limit LEAST_OUTSIDE, because it cannot be fitted to a burst in one
    block.
    """
    return (
        (proof.outside_best_block > LEAST_OUTSIDE or not found.hypothesis.variants[-1].coordinates)
        and proof.outside_best_block * proof.gain > TIMES_OUTSIDE * needed
        and proof.size > SMALLEST * noise_rms(problem, found)
        and _reduces_simulation_error(problem, before, found)
    )


def _reduces_simulation_error(problem: Problem, smaller: Fit, larger: Fit) -> bool:
    """Return True if the simulation error decreases enough from `smaller` to `larger`.

    An effect that only fits the noise of an input hardly reduces the simulation error. The limit is a share of the
    noise, or of the residual of `larger` if that is smaller because the noise model contains structure.
    """
    reversals = models_reversals(larger) or not problem.nuisance.moments
    before, after = (fit_on_simulation_error(problem, fitted, reversals).rss for fitted in (smaller, larger))
    return before - after > LEAST_ERROR_REDUCTION**2 * min(problem.count, after)
