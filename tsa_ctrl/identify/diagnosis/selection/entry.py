"""Whether a cause may enter: every test of `confirm`, and what the simulation error loses by it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.noise.nuisance import Nuisance
from tsa_ctrl.identify.diagnosis.parameters.refit import refit, through_reversals
from tsa_ctrl.identify.diagnosis.selection.evidence import Evidence, evidence
from tsa_ctrl.identify.diagnosis.selection.extension import MOVING

NoiseRms = Callable[[Problem, Fit], float]

BLOCK_T = 4.0  # t of 23 degrees of freedom: 0.06 % two-sided
KEPT = 0.4  # share of the gain that must hold on blocks not fitted on
SPREAD = 0.12  # share of the gain that must be left without the best block
ELSEWHERE = 2.0  # times the threshold, that the gain outside the best block must pass
SMALLEST = 0.2  # of the noise RMS: smaller effects are not named
LEAST_WORTH = 0.4  # of the noise RMS at the score rate, that the plain error must lose
SMALLEST_GAIN = 0.008  # of the number of samples


def enters(problem: Problem, before: Fit, found: Fit, threshold: float, noise_rms: NoiseRms) -> bool:
    """Whether the last effect of `found` is to be named beside those of `before`.

    threshold: of the decrease of the sum of squares, for the family of candidates (white units). noise_rms: RMS of the
    noise at the logs' own rate, N*m.
    """
    needed = max(threshold, SMALLEST_GAIN * problem.count)
    proof = evidence(problem, before, found)
    if not _is_sure(proof, needed):
        return False
    if _is_broad(problem, before, found, proof, needed, noise_rms):
        return True
    if before.names or found.names[-1] not in MOVING:
        return False
    # Few reversals show a lateness of a sample or two beside moments that are free; all do when they are not.
    bare = dataclasses.replace(problem, nuisance=Nuisance(problem.nuisance.smooth))
    smaller, larger = (fit(bare, each.hypothesis, each.point) for each in (before, found))
    proof = evidence(bare, smaller, larger)
    return _is_sure(proof, needed) and _is_broad(bare, smaller, larger, proof, needed, noise_rms)


def _is_sure(proof: Evidence, needed: float) -> bool:
    return proof.gain > needed and proof.block_t > BLOCK_T and proof.kept > KEPT


def _is_broad(problem: Problem, before: Fit, found: Fit, proof: Evidence, needed: float, noise_rms: NoiseRms) -> bool:
    """More than a burst in one block (without a parameter there is nothing to fit one with), and large enough."""
    return (
        (proof.spread > SPREAD or not found.hypothesis.variants[-1].coordinates)
        and proof.spread * proof.gain > ELSEWHERE * needed
        and proof.size > SMALLEST * noise_rms(problem, found)
        and _is_worth(problem, before, found)
    )


def _is_worth(problem: Problem, smaller: Fit, larger: Fit) -> bool:
    """Whether the plain error loses enough: what noise of an input feigns gains next to nothing.

    Measured by the noise, or by all that is left where a noise model that holds structure exceeds it.
    """
    reversals = through_reversals(larger) or not problem.nuisance.moments
    before, after = (refit(problem, fitted, reversals=reversals).fitted.rss for fitted in (smaller, larger))
    return before - after > LEAST_WORTH**2 * min(problem.count, after)
