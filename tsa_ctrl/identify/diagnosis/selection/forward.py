"""Forward and backward selection of causes (stepwise regression); `entry` says what may enter."""

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
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import models_reversals, on_simulation_error
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue, all_but
from tsa_ctrl.identify.diagnosis.noise.nuisance import nuisance
from tsa_ctrl.identify.diagnosis.selection.entry import (
    FEWEST_LOGS,
    LEAST_OUTSIDE,
    MOST_LEFT,
    SMALLEST_GAIN,
    Evidence,
    enters,
    entry_threshold,
    evidence,
    transfers,
)
from tsa_ctrl.identify.diagnosis.selection.meaning import BY_NOISE, SIMPLER, meaningless
from tsa_ctrl.identify.diagnosis.selection.step import (
    FITTED,
    LATE_REVERSALS,
    NEAR_BEST,
    backward_step,
    best_scores,
    best_steps,
    forward_step,
    step_from_nominal,
    step_with_late_reversals,
)

MOST_CAUSES = 4  # beyond which a list of causes is a fit of functions: targets and tests hide two
PER_COORDINATE = 7.0  # decrease of the sum of squares that a further coordinate must bring (logarithm of samples)
# Of the number of samples, of the sum of squares (white units): 5 % are three deviations of 7,000 samples
MORE_THAN_NOISE = 1.05


@dataclass(frozen=True)
class Round:
    """One round of forward selection: what could be added to `fitted`, best first, and the threshold it must pass."""

    fitted: Fit
    steps: tuple[Fit, ...]  # with one effect more
    scores: tuple[Score, ...]  # of each effect, the best
    responses: tuple[Response, ...]  # of each start of each variant
    threshold: float


@dataclass(frozen=True)
class Selection:
    """The causes found, in the order of their entry; `rounds` is how it came to them."""

    problem: Problem
    fitted: Fit
    evidence: tuple[Evidence, ...]
    rounds: tuple[Round, ...]

    def with_fit(self, fitted: Fit) -> Selection:
        """The selection with these causes, under the same noise model."""
        return dataclasses.replace(self, fitted=fitted, evidence=_evidence(self.problem, fitted))

    def without(self, indices: Sequence[int]) -> Selection:
        """The selection without these causes, under the same noise model."""
        fitted = self.fitted
        for index in sorted(indices, reverse=True):
            fitted = backward_step(self.problem, fitted, index)
        return self.with_fit(fitted)


def select(problem: Problem, start: Fit, catalogue: Catalogue, rng: np.random.Generator) -> Selection:
    """Causes that the data demand beside those of `start`, which is the recalibrated base.

    An entry that pruning takes back to causes already looked at is none: it would enter and go again without end.
    """
    fitted = start
    rounds: list[Round] = []
    seen = {frozenset(start.names)}
    while True:
        rounds.append(_round(problem, fitted, catalogue, rng))
        if len(fitted.names) >= MOST_CAUSES:
            break
        steps = rounds[-1].steps, _nominal_steps(problem, fitted, catalogue), _plain_steps(problem, fitted, catalogue)
        for found in chain.from_iterable(steps):
            if not enters(problem, fitted, found, rounds[-1].threshold):
                continue
            entered = _entered(problem, found, catalogue)
            if (names := frozenset(entered[1].names)) not in seen:
                seen.add(names)
                break
        else:
            break
        problem, fitted = entered
    return Selection(problem, fitted, _evidence(problem, fitted), tuple(rounds))


def _entered(problem: Problem, entry: Fit, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """Noise model and causes with a new one among them, which may make others unnecessary or be so itself."""
    problem, fitted = _under_new_noise(problem, entry, catalogue)
    return _pruned(problem, _best_variants(problem, fitted, catalogue), catalogue)


def _round(problem: Problem, fitted: Fit, catalogue: Catalogue, rng: np.random.Generator) -> Round:
    variants = all_but(fitted.names, catalogue)
    found = responses(problem, fitted, variants)
    scored = scores(problem, fitted, found)
    best = best_scores(problem, fitted, scored, found)
    promising = [s for s in best if s.gain > NEAR_BEST * best[0].gain]
    steps = [forward_step(problem, fitted, score) for score in promising]
    for variant in variants:
        late = variant.effect in LATE_REVERSALS
        hidden = late and not fitted.names  # what these do then may be hidden without a trace
        if hidden or fitted.rss > MORE_THAN_NOISE * problem.count:
            tried = step_with_late_reversals if late else step_from_nominal
            steps += [tried(problem, fitted, variant, start) for start in variant.full_strength]
    ranked = [found for found in steps if found is not None and found.rss < fitted.rss]
    ranked.sort(key=lambda found: found.rss + PER_COORDINATE * len(found.point))
    return Round(fitted, tuple(_simpler_first(ranked)), tuple(best), tuple(found), entry_threshold(rng, scored))


def _simpler_first(ranked: Sequence[Fit]) -> list[Fit]:
    """The same, an effect behind the simpler one that it turns into, where noise alone may explain the difference."""
    out: list[Fit] = []
    for found in ranked:
        name = SIMPLER.get(found.names[-1])
        twin = next((other for other in ranked if other.names[-1] == name), None)
        if twin is not None and twin.rss - found.rss < BY_NOISE:
            out.append(twin)
        out.append(found)
    return list({id(found): found for found in out}.values())


def _nominal_steps(problem: Problem, fitted: Fit, catalogue: Catalogue) -> Iterator[Fit]:
    """Effects without a parameter that recalibration may have made up for: tried when nothing else enters."""
    if fitted.rss > MORE_THAN_NOISE * problem.count:
        variants = all_but(fitted.names, catalogue)
        found = [step_from_nominal(problem, fitted, v) for v in variants if not v.coordinates]
        yield from sorted((each for each in found if each is not None), key=lambda each: each.rss)


def _plain_steps(problem: Problem, fitted: Fit, catalogue: Catalogue) -> Iterator[Fit]:
    """Effects by what they take off the simulation error of several logs: tried when nothing else enters.

    What is as slow as the noise of short logs scores little where that noise is whitened, but may transfer.
    """
    if sum(bool(problem.mask[part].any()) for part in problem.frame.slices) < FEWEST_LOGS:
        return
    plain = on_simulation_error(problem, models_reversals(fitted))
    present = fit(plain, fitted.hypothesis, fitted.point)
    for found in best_steps(plain, present, catalogue, fitted.names, FITTED):
        if found.rss < MOST_LEFT * present.rss:
            yield fit(problem, found.hypothesis, found.point)


def forward_on_simulation_error(selection: Selection, catalogue: Catalogue) -> Selection | None:
    """The causes with one more that takes more off the simulation error than it leaves; None where none does.

    For what is mostly structure, which colours the noise that whitens until it hides whatever is as slow.
    """
    problem, fitted = selection.problem, selection.fitted
    if len(fitted.names) >= MOST_CAUSES:
        return None
    plain = on_simulation_error(problem, models_reversals(fitted))
    present = fit(plain, fitted.hypothesis, fitted.point)
    for larger in best_steps(plain, present, catalogue, fitted.names, FITTED):
        if meaningless(problem, larger):
            continue
        proof = evidence(plain, present, larger)
        if proof.holds and proof.outside_best_block > LEAST_OUTSIDE and proof.gain > larger.rss:
            problem, fitted = _under_new_noise(problem, larger, catalogue)
            return dataclasses.replace(selection, problem=problem).with_fit(fitted)
    return None


def _under_new_noise(problem: Problem, fitted: Fit, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """Nuisance and noise model as the causes found so far leave them, and the fit under them.

    The moments follow the causes unless the fit becomes worse. A moment hides when a gap closes, so the fitted gap may
    be wrong by some samples. The moment that follows it then no longer covers the reversal.
    """
    for _ in range(2):  # a delay moves the moments of unknown direction, and they bias the delay
        columns = nuisance(problem.frame, problem.base, fitted.hypothesis.model(fitted.point))
        moved = dataclasses.replace(problem, nuisance=columns)
        refitted = fit(moved, fitted.hypothesis, fitted.point)
        if refitted.rss > MORE_THAN_NOISE * max(fitted.rss, problem.count):
            break
        problem, fitted = moved, refitted
    return pilot_noise(problem, fitted, catalogue)


def _best_variants(problem: Problem, fitted: Fit, catalogue: Catalogue) -> Fit:
    """The same causes, each in the variant that fits best now; scores under the first noise model may mistake it."""
    for effect in fitted.names:
        index = fitted.names.index(effect)
        own = fitted.hypothesis.variants[index]
        others = [v for v in catalogue.get(effect, ()) if v is not own and v.coordinates and not v.amplitude]
        if not others:
            continue
        smaller = backward_step(problem, fitted, index)
        found = responses(problem, smaller, others)
        for score in best_scores(problem, smaller, scores(problem, smaller, found), found, each=True):
            swapped = forward_step(problem, smaller, score)
            if swapped is not None and swapped.rss < fitted.rss:
                fitted = swapped
    return fitted


def _pruned(problem: Problem, fitted: Fit, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """Causes that the others make unnecessary are dropped."""
    while len(fitted.names) > 1 and (smaller := _backward(problem, fitted)) is not None:
        problem, fitted = _under_new_noise(problem, smaller, catalogue)
    return problem, fitted


def _backward(problem: Problem, fitted: Fit) -> Fit | None:
    """Without a cause that says nothing, or that neither stands out of the noise nor transfers; None: all stay."""
    unfounded = meaningless(problem, fitted)
    for index in range(len(fitted.names)):
        smaller = backward_step(problem, fitted, index)
        proof = evidence(problem, smaller, fitted)
        stands = proof.gain >= SMALLEST_GAIN * problem.count and proof.holds
        if index in unfounded or not (stands or transfers(problem, smaller, fitted)):
            return smaller
    return None


def _evidence(problem: Problem, fitted: Fit) -> tuple[Evidence, ...]:
    return tuple(evidence(problem, backward_step(problem, fitted, i), fitted) for i in range(len(fitted.names)))
