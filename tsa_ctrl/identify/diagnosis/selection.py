"""Forward, swap and backward selection of causes; every entry must pass all of `confirm`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from tsa_ctrl.identify.diagnosis.candidates import Variant
from tsa_ctrl.identify.diagnosis.confirm import Evidence, evidence, family_threshold
from tsa_ctrl.identify.diagnosis.fit import Fit, fit, safely
from tsa_ctrl.identify.diagnosis.nuisance import Nuisance, nuisance
from tsa_ctrl.identify.diagnosis.pilot import pilot_noise
from tsa_ctrl.identify.diagnosis.problem import Problem
from tsa_ctrl.identify.diagnosis.profile import refined
from tsa_ctrl.identify.diagnosis.refit import on_plain_error, refit, through_reversals
from tsa_ctrl.identify.diagnosis.screen import Response, Score, best_by_effect, responses, scores

Catalogue = Mapping[str, tuple[Variant, ...]]

MOVING = ("transport_delay", "velocity_lag")  # effects by which reversals come later than the log's velocity
MOST_CAUSES = 4
FITTED = 5  # best candidates of one stage that are fitted in full
WITHIN = 0.25  # of the best gain: candidates below are not fitted
BLOCK_T = 4.0  # t of 23 degrees of freedom: 0.06 % two-sided
KEPT = 0.4  # share of the gain that must hold on blocks not fitted on
SPREAD = 0.12  # share of the gain that must be left without the best block
ELSEWHERE = 2.0  # times the threshold, that the gain outside the best block must pass
SMALLEST = 0.2  # of the noise RMS: smaller effects are not named
LEAST_WORTH = 0.4  # of the noise RMS at the score rate, that the plain error must lose
PER_COORDINATE = 7.0  # decrease of the sum of squares that a further coordinate must bring (logarithm of samples)
LEFT = 1.05  # of the number of samples, above which the sum of squares (white units) holds more than noise
SMALLEST_GAIN = 0.008  # of the number of samples


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
    noise_rms: Callable[[Problem, Fit], float],
) -> Selection:
    """Causes that the data demand. `noise_rms`: RMS of the noise at the logs' own rate, N*m."""
    fitted = start
    stages: list[Stage] = []
    while True:
        stage = _stage(problem, fitted, catalogue, rng)
        stages.append(stage)
        if len(fitted.names) >= MOST_CAUSES:
            break
        tried = chain(stage.ranked, _hidden(problem, fitted, catalogue))
        entry = next((found for found in tried if _enters(problem, stage, found, noise_rms)), None)
        if entry is None:
            break
        problem, fitted = _renoised(problem, entry, catalogue)
        fitted = _rechosen(problem, fitted, catalogue)
        problem, fitted = _settled(problem, fitted, catalogue)
    return Selection(problem, fitted, _evidence(problem, fitted), tuple(stages))


def _stage(problem: Problem, fitted: Fit, catalogue: Catalogue, rng: np.random.Generator) -> Stage:
    variants = [v for name, options in catalogue.items() if name not in fitted.names for v in options]
    found = responses(problem, fitted, variants)
    screened = scores(problem, fitted, found)
    best = _refined(problem, fitted, screened, found)
    promising = [s for s in best if s.gain > WITHIN * best[0].gain][:FITTED]
    extensions = [extended(problem, fitted, score) for score in promising]
    if fitted.rss > LEFT * problem.count:
        for variant in variants:
            tried = _moved if variant.effect in MOVING else from_the_file
            extensions += [tried(problem, fitted, variant, start) for start in variant.bold]
    ranked = [found for found in extensions if found is not None and found.rss < fitted.rss]
    ranked.sort(key=lambda found: found.rss + PER_COORDINATE * len(found.point))
    return Stage(fitted, tuple(ranked), tuple(best), tuple(found), family_threshold(rng, screened))


def _hidden(problem: Problem, fitted: Fit, catalogue: Catalogue) -> Iterator[Fit]:
    """Effects without a parameter that recalibration may have made up for: tried when nothing else enters."""
    if fitted.rss > LEFT * problem.count:
        variants = [v for name, options in catalogue.items() if name not in fitted.names for v in options]
        found = [from_the_file(problem, fitted, v) for v in variants if not v.coordinates]
        yield from sorted((each for each in found if each is not None), key=lambda each: each.rss)


def from_the_file(problem: Problem, fitted: Fit, variant: Variant, start: Sequence[float] = ()) -> Fit | None:
    """`fitted` with an effect more, from full strength `start` and from the base model's numbers in the file.

    Where recalibration has made up for such an effect, it changes nothing any more: a high pretension hides slack.
    """
    base = fitted.hypothesis.base.start()
    begin = np.concatenate([base, fitted.point[len(base) :], np.array(start)])
    return safely(problem, fitted.hypothesis.plus(variant), begin)


def _moved(problem: Problem, fitted: Fit, variant: Variant, start: Sequence[float]) -> Fit | None:
    """`fitted` with a lag or a delay more, under moments of unknown direction that move with the reversals.

    As many as before, so that the sums of squares compare; where they stay they hide a lateness of a sample or two.
    """
    hypothesis, point = fitted.hypothesis.plus(variant), np.concatenate([fitted.point, np.array(start)])
    found = None
    for _ in range(2):
        columns = nuisance(problem.frame, problem.base, hypothesis.model(point))
        found = safely(dataclasses.replace(problem, nuisance=columns), hypothesis, point)
        if found is None:
            return None
        point = found.point
    return found


def _refined(
    problem: Problem, fitted: Fit, screened: list[Score], found: list[Response], each: bool = False
) -> list[Score]:
    """The best score of each effect, best first, each variant of the leading ones refined on its own.

    `each`: of each variant.
    """
    if not screened:
        return []
    leading = best_by_effect(screened)[:FITTED]
    names = {score.variant.effect for score in leading if score.gain > WITHIN * leading[0].gain}
    by_variant: dict[int, Score] = {}
    for score in screened:
        number = id(score.variant)
        if score.variant.effect in names and (number not in by_variant or score.whole > by_variant[number].whole):
            by_variant[number] = score
    finer = [refined(problem, fitted, score, found) for score in by_variant.values()]
    others = [score for score in best_by_effect(screened) if score.variant.effect not in names]
    return finer if each else best_by_effect([*finer, *others])


def extended(problem: Problem, fitted: Fit, score: Score) -> Fit | None:
    """The fit with one effect more, from where the score begins; if that goes astray, from no effect at all."""
    hypothesis = fitted.hypothesis.plus(score.variant)
    found = safely(problem, hypothesis, np.concatenate([fitted.point, score.start]))
    if score.variant.amplitude and (found is None or found.rss > fitted.rss - 0.5 * score.gain):
        start = score.start.copy()
        start[list(score.variant.amplitude)] = np.array(score.variant.starts[0])[list(score.variant.amplitude)]
        again = safely(problem, hypothesis, np.concatenate([fitted.point, start]))
        if again is not None and (found is None or again.rss < found.rss):
            return again
    return found


def _enters(problem: Problem, stage: Stage, found: Fit, noise_rms: Callable[[Problem, Fit], float]) -> bool:
    if _holds_up(problem, stage, found, noise_rms):
        return True
    if stage.fitted.names or found.names[-1] not in MOVING:
        return False
    # Few reversals show a lateness of a sample or two beside moments that are free; all do when they are not.
    bare = dataclasses.replace(problem, nuisance=Nuisance(problem.nuisance.smooth))
    smaller, larger = (fit(bare, each.hypothesis, each.point) for each in (stage.fitted, found))
    return _holds_up(bare, dataclasses.replace(stage, fitted=smaller), larger, noise_rms)


def _holds_up(problem: Problem, stage: Stage, found: Fit, noise_rms: Callable[[Problem, Fit], float]) -> bool:
    proof = evidence(problem, stage.fitted, found)
    needed = max(stage.threshold, SMALLEST_GAIN * problem.count)
    return (
        proof.gain > needed
        and proof.block_t > BLOCK_T
        and proof.kept > KEPT
        and (proof.spread > SPREAD or not found.hypothesis.variants[-1].coordinates)  # nothing to fit a burst with
        and proof.spread * proof.gain > ELSEWHERE * needed
        and proof.size > SMALLEST * noise_rms(problem, found)
        and _is_worth(problem, stage.fitted, found)
    )


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


def _is_worth(problem: Problem, smaller: Fit, larger: Fit) -> bool:
    """Whether the plain error loses enough: what noise of an input feigns gains next to nothing.

    Measured by the noise, or by all that is left where a noise model that holds structure exceeds it.
    """
    reversals = through_reversals(larger) or not problem.nuisance.moments
    before, after = (refit(problem, fitted, reversals=reversals).fitted.rss for fitted in (smaller, larger))
    return before - after > LEAST_WORTH**2 * min(problem.count, after)


def _renoised(problem: Problem, fitted: Fit, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """Nuisance and noise model as the causes found so far leave them, and the fit under them."""
    for _ in range(2):  # a delay moves the moments of unknown direction, and they bias the delay
        columns = nuisance(problem.frame, problem.base, fitted.hypothesis.model(fitted.point))
        problem = dataclasses.replace(problem, nuisance=columns)
        fitted = fit(problem, fitted.hypothesis, fitted.point)
    variants = [v for name, options in catalogue.items() if name not in fitted.names for v in options]
    return pilot_noise(problem, fitted, responses(problem, fitted, variants))


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
        for score in _refined(problem, smaller, scores(problem, smaller, found), found, each=True):
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


def rivals(problem: Problem, smaller: Fit, catalogue: Catalogue, barred: Sequence[str], most: int) -> list[Fit]:
    """The best fits of `smaller` with one more effect that is not barred, best first."""
    variants = [v for name, options in catalogue.items() if name not in barred for v in options]
    found = responses(problem, smaller, variants)
    best = _refined(problem, smaller, scores(problem, smaller, found), found)
    fits = []
    for score in best[:most]:
        rival = extended(problem, smaller, score)
        if rival is not None:
            fits.append(rival)
    return sorted(fits, key=lambda f: f.rss)


def without(problem: Problem, fitted: Fit, index: int) -> Fit:
    """The fit with one effect taken out."""
    hypothesis = fitted.hypothesis.without(index)
    base = len(hypothesis.base.coordinates())
    own = fitted.hypothesis.own(fitted.point)
    return fit(problem, hypothesis, np.concatenate([fitted.point[:base], *own[:index], *own[index + 1 :]]))


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
