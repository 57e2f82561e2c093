"""Forward, swap and backward selection of causes; every entry must pass all of `confirm`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.noise_model import pilot_noise
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.score_test import Response, Score, responses, scores
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import on_plain_error, through_reversals
from tsa_ctrl.identify.diagnosis.hypotheses.variants import Catalogue, all_but
from tsa_ctrl.identify.diagnosis.noise.nuisance import nuisance
from tsa_ctrl.identify.diagnosis.selection.entry import (
    BLOCK_T,
    KEPT,
    SMALLEST_GAIN,
    SPREAD,
    Evidence,
    enters,
    evidence,
    family_threshold,
)
from tsa_ctrl.identify.diagnosis.selection.extension import (
    FITTED,
    MOVING,
    WITHIN,
    best_scores,
    extended,
    from_the_file,
    moved,
    rivals,
    without,
)

MOST_CAUSES = 4
PER_COORDINATE = 7.0  # decrease of the sum of squares that a further coordinate must bring (logarithm of samples)
LEFT = 1.05  # of the number of samples, above which the sum of squares (white units) holds more than noise


@dataclass(frozen=True)
class Stage:
    """One step of the selection: what could be added to `fitted`, best first, and the threshold it must pass."""

    fitted: Fit
    ranked: tuple[Fit, ...]
    screened: tuple[Score, ...]
    found: tuple[Response, ...]
    threshold: float


@dataclass(frozen=True)
class Selection:
    """The causes found, in the order of their entry; `stages` is how it came to them."""

    problem: Problem
    fitted: Fit
    evidence: tuple[Evidence, ...]
    stages: tuple[Stage, ...]


def select(
    problem: Problem,
    start: Fit,
    catalogue: Catalogue,
    rng: np.random.Generator,
) -> Selection:
    """Causes that the data demand beside those of `start`, which is the recalibrated base."""
    fitted = start
    stages: list[Stage] = []
    while True:
        stage = _stage(problem, fitted, catalogue, rng)
        stages.append(stage)
        if len(fitted.names) >= MOST_CAUSES:
            break
        tried = chain(stage.ranked, _hidden(problem, fitted, catalogue))
        entry = next((found for found in tried if enters(problem, fitted, found, stage.threshold)), None)
        if entry is None:
            break
        problem, fitted = _renoised(problem, entry, catalogue)
        fitted = _rechosen(problem, fitted, catalogue)
        problem, fitted = _settled(problem, fitted, catalogue)
    return Selection(problem, fitted, _evidence(problem, fitted), tuple(stages))


def _stage(problem: Problem, fitted: Fit, catalogue: Catalogue, rng: np.random.Generator) -> Stage:
    variants = all_but(fitted.names, catalogue)
    found = responses(problem, fitted, variants)
    screened = scores(problem, fitted, found)
    best = best_scores(problem, fitted, screened, found)
    promising = [s for s in best if s.gain > WITHIN * best[0].gain][:FITTED]
    extensions = [extended(problem, fitted, score) for score in promising]
    for variant in variants:
        if variant.effect in MOVING and not fitted.names:  # what these do may be hidden without a trace
            extensions += [moved(problem, fitted, variant, start) for start in variant.bold]
        elif fitted.rss > LEFT * problem.count:
            tried = moved if variant.effect in MOVING else from_the_file
            extensions += [tried(problem, fitted, variant, start) for start in variant.bold]
    ranked = [found for found in extensions if found is not None and found.rss < fitted.rss]
    ranked.sort(key=lambda found: found.rss + PER_COORDINATE * len(found.point))
    return Stage(fitted, tuple(ranked), tuple(best), tuple(found), family_threshold(rng, screened))


def _hidden(problem: Problem, fitted: Fit, catalogue: Catalogue) -> Iterator[Fit]:
    """Effects without a parameter that recalibration may have made up for: tried when nothing else enters."""
    if fitted.rss > LEFT * problem.count:
        variants = all_but(fitted.names, catalogue)
        found = [from_the_file(problem, fitted, v) for v in variants if not v.coordinates]
        yield from sorted((each for each in found if each is not None), key=lambda each: each.rss)


def one_more(selection: Selection, catalogue: Catalogue) -> Selection | None:
    """The causes with one more that takes more off the simulation error than it leaves; None where none does.

    For what is mostly structure, which colours the noise that whitens until it hides whatever is as slow.
    """
    problem, fitted = selection.problem, selection.fitted
    if len(fitted.names) >= MOST_CAUSES:
        return None
    plain = on_plain_error(problem, through_reversals(fitted))
    present = fit(plain, fitted.hypothesis, fitted.point)
    for larger in rivals(plain, present, catalogue, fitted.names, FITTED):
        proof = evidence(plain, present, larger)
        holds = proof.block_t > BLOCK_T and proof.kept > KEPT and proof.spread > SPREAD
        if holds and proof.gain > larger.rss:
            problem, fitted = _renoised(problem, larger, catalogue)
            return replaced(dataclasses.replace(selection, problem=problem), fitted)
    return None


def _renoised(problem: Problem, fitted: Fit, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """Nuisance and noise model as the causes found so far leave them, and the fit under them."""
    for _ in range(2):  # a delay moves the moments of unknown direction, and they bias the delay
        columns = nuisance(problem.frame, problem.base, fitted.hypothesis.model(fitted.point))
        problem = dataclasses.replace(problem, nuisance=columns)
        fitted = fit(problem, fitted.hypothesis, fitted.point)
    return pilot_noise(problem, fitted, catalogue)


def _rechosen(problem: Problem, fitted: Fit, catalogue: Catalogue) -> Fit:
    """The same causes, each in the variant that fits best now; a screening on the first noise model may mistake it."""
    for effect in fitted.names:
        index = fitted.names.index(effect)
        own = fitted.hypothesis.variants[index]
        others = [v for v in catalogue.get(effect, ()) if v is not own and v.coordinates and not v.amplitude]
        if not others:
            continue
        smaller = without(problem, fitted, index)
        found = responses(problem, smaller, others)
        for score in best_scores(problem, smaller, scores(problem, smaller, found), found, each=True):
            rival = extended(problem, smaller, score)
            if rival is not None and rival.rss < fitted.rss:
                fitted = rival
    return fitted


def _settled(problem: Problem, fitted: Fit, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """Causes that the others make unnecessary are dropped, and each is swapped for a better one where there is one."""
    for _ in range(2 * MOST_CAUSES):
        if len(fitted.names) < 2:
            return problem, fitted
        changed = _dropped(problem, fitted) or _swapped(problem, fitted, catalogue)
        if changed is None:
            return problem, fitted
        problem, fitted = _renoised(problem, changed, catalogue)
    return problem, fitted


def _dropped(problem: Problem, fitted: Fit) -> Fit | None:
    for index in range(len(fitted.names)):
        smaller = without(problem, fitted, index)
        proof = evidence(problem, smaller, fitted)
        if proof.gain < SMALLEST_GAIN * problem.count or proof.block_t < BLOCK_T or proof.kept < KEPT:
            return smaller
    return None


def _swapped(problem: Problem, fitted: Fit, catalogue: Catalogue) -> Fit | None:
    for index in range(len(fitted.names) - 1):
        smaller = without(problem, fitted, index)
        for rival in rivals(problem, smaller, catalogue, fitted.names, 3):
            if rival.rss + PER_COORDINATE * len(rival.point) < fitted.rss + PER_COORDINATE * len(fitted.point) - 2.0:
                return rival
    return None


def dropped(selection: Selection, indices: Sequence[int]) -> Selection:
    """The selection without these causes, under the same noise model."""
    fitted = selection.fitted
    for index in sorted(indices, reverse=True):
        fitted = without(selection.problem, fitted, index)
    return replaced(selection, fitted)


def replaced(selection: Selection, fitted: Fit) -> Selection:
    """The selection with these causes, under the same noise model."""
    return dataclasses.replace(selection, fitted=fitted, evidence=_evidence(selection.problem, fitted))


def _evidence(problem: Problem, fitted: Fit) -> tuple[Evidence, ...]:
    return tuple(evidence(problem, without(problem, fitted, i), fitted) for i in range(len(fitted.names)))
