"""Add or remove one effect in a step of the selection, with start values from which the fit finds the effect."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit, fit_or_none
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import Response, Score, best_by_effect, responses, scores
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue, all_but
from tsa_ctrl.identify.diagnosis.noise.nuisance import nuisance
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.search import Variant
from tsa_ctrl.model.effects.specification import Stage
from tsa_ctrl.model.functions import Array

# Effects that delay friction reversals relative to the velocity in the log
LATE_REVERSALS = tuple(name for name, spec in CATALOGUE.items() if spec.stage in (Stage.VELOCITY, Stage.DELAY))
FITTED = 5  # number of best candidates that are refined and fitted: one enters, and the others are tested again
NEAR_BEST = 0.25  # least share of the best gain at which a candidate is fitted
# Golden section: the interval that remains after each step already contains one of its two points
SHRINK = 0.5 * (np.sqrt(5.0) - 1.0)
# Factors of an effect's amplitude at which a fit with its companion starts: the minima differ by the ratio of the
# relative changes of wrap angle and pretension, which is near 2 for typical tendons
COMPANION_STARTS = (0.4, 1.0, 2.5)
STEPS = 9  # golden-section steps: 1 % of the first interval remains


def step_from_nominal(problem: Problem, fitted: Fit, variant: Variant, start: Sequence[float] = ()) -> Fit | None:
    """Return the fit with one more effect, or None if it cannot be computed.

    The fit starts from the nominal coordinates of the base and from the coordinates `start` of the effect.
    Recalibration may have compensated for the effect, which then has no influence: for example, a high pretension hides
    slack.
    """
    base = fitted.hypothesis.base.start()
    begin = np.concatenate([base, fitted.point[len(base) :], np.array(start)])
    return fit_or_none(problem, fitted.hypothesis.plus(variant), begin)


def companion_steps(problem: Problem, fitted: Fit, catalogue: Catalogue) -> dict[str, list[Fit]]:
    """Return the fits with the companion (catalogue) of each effect of `fitted`, by the name of the effect.

    The companion can replace a part of the effect, so such a fit may have several minima. It therefore starts from the
    nominal base and several amplitudes of the effect.
    """
    hypothesis = fitted.hypothesis
    found: dict[str, list[Fit]] = {}
    for name, place in zip(hypothesis.names, hypothesis.places, strict=True):
        companion = CATALOGUE[name].companion
        if companion not in catalogue or companion in hypothesis.names:
            continue
        for variant in catalogue[companion]:
            for scale in COMPANION_STARTS:
                start = np.concatenate([fitted.point, variant.starts[0]])
                start[: hypothesis.places[0].start] = hypothesis.base.start()
                start[place] *= scale
                step = fit_or_none(problem, hypothesis.plus(variant), start)
                found.setdefault(name, []).extend([] if step is None else [step])
    return found


def step_with_late_reversals(problem: Problem, fitted: Fit, variant: Variant, start: Sequence[float]) -> Fit | None:
    """Return the fit with one more lag or delay, or None if it cannot be computed.

    The moments of unknown direction move with the reversals. At their former times, they would hide a delay of one or
    two samples. Their number is kept, so that the sums of squares can be compared.
    """
    hypothesis, point = fitted.hypothesis.plus(variant), np.concatenate([fitted.point, np.array(start)])
    found = None
    for _ in range(2):
        columns = nuisance(problem.frame, problem.base, hypothesis.model(point))
        found = fit_or_none(dataclasses.replace(problem, nuisance=columns), hypothesis, point)
        if found is None:
            return None
        point = found.point
    return found


def forward_step(problem: Problem, fitted: Fit, score: Score) -> Fit | None:
    """Return the fit with one more effect, started from the score's estimate; None if it cannot be computed.

    If that fit fails or achieves less than half of the expected gain, it is repeated from the amplitude of no effect.
    """
    hypothesis = fitted.hypothesis.plus(score.variant)
    found = fit_or_none(problem, hypothesis, np.concatenate([fitted.point, score.start]))
    if score.variant.amplitude and (found is None or found.rss > fitted.rss - 0.5 * score.gain):
        start = score.start.copy()
        start[list(score.variant.amplitude)] = np.array(score.variant.starts[0])[list(score.variant.amplitude)]
        again = fit_or_none(problem, hypothesis, np.concatenate([fitted.point, start]))
        if again is not None and (found is None or again.rss < found.rss):
            return again
    return found


def best_steps(
    problem: Problem,
    smaller: Fit,
    catalogue: Catalogue,
    names: Sequence[str],
    most: int,
    always: Collection[str] = (),
) -> list[Fit]:
    """Return the fits with one more effect, the best first.

    Effects in `names` are excluded. At most `most` effects are fitted, those with the best scores, plus those in
    `always`.
    """
    variants = all_but(names, catalogue)
    found = responses(problem, smaller, variants)
    best = best_scores(problem, smaller, scores(problem, smaller, found), found)
    tried = [*best[:most], *(score for score in best[most:] if score.variant.effect in always)]
    fits = (forward_step(problem, smaller, score) for score in tried)
    return sorted((step for step in fits if step is not None), key=lambda f: f.rss)


def best_scores(
    problem: Problem, fitted: Fit, scored: list[Score], found: list[Response], each: bool = False
) -> list[Score]:
    """Return the best score of each effect, the best first.

    Each variant of the leading effects is refined separately. If `each` is True, the refined scores of all these
    variants are returned instead, in no particular order.
    """
    if not scored:
        return []
    leading = best_by_effect(scored)[:FITTED]
    names = {score.variant.effect for score in leading if score.gain > NEAR_BEST * leading[0].gain}
    by_variant: dict[int, Score] = {}
    for score in scored:
        number = id(score.variant)
        if score.variant.effect in names and (number not in by_variant or score.whole > by_variant[number].whole):
            by_variant[number] = score
    finer = [_refined(problem, fitted, score, found) for score in by_variant.values()]
    others = [score for score in best_by_effect(scored) if score.variant.effect not in names]
    return finer if each else best_by_effect([*finer, *others])


def backward_step(problem: Problem, fitted: Fit, index: int) -> Fit:
    """Return the fit without the effect at this index."""
    hypothesis = fitted.hypothesis.without(index)
    base = len(hypothesis.base.coordinates())
    own = fitted.hypothesis.own(fitted.point)
    return fit(problem, hypothesis, np.concatenate([fitted.point[:base], *own[:index], *own[index + 1 :]]))


def _refined(problem: Problem, fitted: Fit, score: Score, found: list[Response]) -> Score:
    """Return the score moved to the best value between its neighbours on the grid.

    Only variants with a single coordinate and no amplitude are refined: backlash, presliding, delays and lags. Their
    sum of squares is neither smooth nor convex in that coordinate, so a golden-section search of the exact profile
    replaces a descent. All other coordinates are solved for linearly. Other variants are returned unchanged.
    """
    variant = score.variant
    if variant.amplitude or len(variant.coordinates) != 1:
        return score
    basis = orthonormal(fitted.jacobian)
    residual = fitted.residual - basis @ (basis.T @ fitted.residual)
    present = problem.predicted(fitted.hypothesis.model(fitted.point))
    hypothesis = fitted.hypothesis.plus(variant)

    def gain(u: float) -> tuple[float, Array]:
        model = hypothesis.model(np.concatenate([fitted.point, [u]]))
        column = problem.whiten(problem.predicted(model) - present)
        column -= basis @ (basis.T @ column)
        return float(2.0 * column @ residual - column @ column), column

    grid = sorted({float(r.start[0]) for r in found if r.variant is variant} | {float(score.start[0])})
    at = grid.index(float(score.start[0]))
    coordinate = variant.coordinates[0]
    low = grid[at - 1] if at else coordinate.low
    high = grid[at + 1] if at + 1 < len(grid) else min(coordinate.high, 2.0 * grid[at] - low)
    best, (most, column) = float(score.start[0]), gain(float(score.start[0]))
    a, b = high - SHRINK * (high - low), low + SHRINK * (high - low)
    at_a, at_b = gain(a), gain(b)
    for _ in range(STEPS):
        for u, (value, response) in ((a, at_a), (b, at_b)):
            if value > most:
                best, most, column = u, value, response
        if at_a[0] > at_b[0]:
            high, b, at_b = b, a, at_a
            a = high - SHRINK * (high - low)
            at_a = gain(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + SHRINK * (high - low)
            at_b = gain(b)
    return Score(variant, np.array([best]), most, column[:, None], most)
