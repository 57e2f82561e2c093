"""Decide which causes are reported, and repeat the search without each dropped cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import BLOCKS, LEAST_GAIN
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import (
    fit_on_simulation_error,
    full_residuals,
    models_reversals,
    simulation_error,
)
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue
from tsa_ctrl.identify.diagnosis.parameters.formula import (
    Formula,
    formula_of_what_is_left,
    with_direction,
)
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut, held_out
from tsa_ctrl.identify.diagnosis.residual.changes import DRIFT
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.diagnosis.residual.flatness import not_flat
from tsa_ctrl.identify.diagnosis.residual.structure import error_criterion, residual_structure, structure_share
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import VISIBLY, Elsewhere
from tsa_ctrl.identify.diagnosis.rivals.groups import UNRECORDED, Group, Rival, compared, groups, made_up
from tsa_ctrl.identify.diagnosis.rivals.stretched import parted
from tsa_ctrl.identify.diagnosis.selection.entry import FEWEST_LOGS, left_out_error, used_logs
from tsa_ctrl.identify.diagnosis.selection.forward import (
    Round,
    Selection,
    leaves_more_than_noise,
    other_starts,
    select,
)
from tsa_ctrl.identify.diagnosis.selection.meaning import SIMPLER, meaningless, meaningless_by_error
from tsa_ctrl.identify.diagnosis.selection.step import backward_step
from tsa_ctrl.model.parameters import Model

# If a formula explains the logs clearly better than a cause, the true cause is outside the catalogue.
#
# For example, the search may fit differing sheaths to a torque sensor with two gains, an offset to a zero that follows
# the temperature, or a spring to a tendon that creeps, and report the remainder as structure. The formula is compared
# on held-out data with the cause together with the cause's own formula. It replaces the cause if its error is clearly
# smaller, or if it has an equal error and fewer terms. No formula describes an effect of the catalogue better, or with
# fewer terms, than the effect itself.

# Least ratio of the mean square residuals of cause and formula at which the formula replaces the cause: half the RMS.
# A true cause leaves only noise, and no formula removes half of that.
FAR = 4.0
SAME = 0.99  # least correlation at which formula and cause are the same: they differ by 2 % of the mean square


def stand_in(
    problem: Problem, found: Fit, groups: Sequence[Group], split: Split, formula: Formula | None
) -> int | None:
    """Return the index of the cause that a formula replaces, or None if no formula is clearly better.

    `formula` describes the residual of `found` and is reported with it. A cause with alternatives is less specific. It
    is replaced only by a formula with a single term that is also better than each alternative. An error of the torque
    sensor does not count as an alternative here, because the formula may describe that error. Logs of one program
    share the times of their events without a physical reason, so a formula of time must be better by the factor `FAR`.
    """
    held = with_direction(problem, found, split.held)
    model = _described(problem, found, formula, split)
    present, whole = (_squares(problem, model, mask) for mask in (held, split.held))
    terms = 1 if formula is None else 1 + formula.terms
    best, least = None, np.inf
    for index, group in enumerate(groups):
        described = formula_of_what_is_left(problem, backward_step(problem, found, index), split)
        if described is None or (group.catalogued and described.terms > 1):
            continue
        if _is_written_by(problem, described, found, index, held):
            continue
        error = _squares(problem, described.model, held)
        if error.error >= least or not _does_better(described, error, terms, present):
            continue
        if (1.0 - LEAST_GAIN) * _squares(problem, described.model, split.held).error > whole.error:
            continue  # A delay shows only in the reversals, where the direction is unknown.
        others = (rival.fitted for rival in group.catalogued if not made_up(problem, rival.name))
        twins = (_described(problem, other, None, split) for other in others)
        if all(VISIBLY * error.error < _squares(problem, twin, held).error for twin in twins):
            best, least = index, error.error
    return best


def _is_written_by(problem: Problem, formula: Formula, found: Fit, index: int, held: NDArray[np.bool_]) -> bool:
    """Return True if the formula is merely the cause with this index, written as an expression."""
    with_it = problem.predicted(found.hypothesis.model(found.point))
    smaller = found.hypothesis.without(index)
    rest = np.delete(found.point, found.hypothesis.places[index])
    own = (with_it - problem.predicted(smaller.model(rest)))[held]
    bare = {name: effect for name, effect in formula.model.effects.items() if name != "custom"}
    told = (problem.predicted(formula.model) - problem.predicted(replace(formula.model, effects=bare)))[held]
    return float(own @ told) ** 2 > SAME**2 * float(own @ own) * float(told @ told)


def _does_better(formula: Formula, error: Elsewhere, terms: int, named: Elsewhere) -> bool:
    """Return True if a formula with `error` replaces a cause that has `terms` terms and the error `named`."""
    as_good = formula.terms < terms and (1.0 - LEAST_GAIN) * error.error <= named.error
    beats = error.clearly_beats(named) and not formula.tells_when
    return as_good or beats or FAR * error.error < named.error


def keeps_its_promise(
    problem: Problem, split: Split, named: tuple[Fit, Formula | None], instead: tuple[Fit, Formula | None]
) -> bool:
    """Return True if the error of the result `instead` is not clearly larger than that of the result `named`.

    `instead` is the result without one cause of `named`. Without that cause the selection runs again, and another cause
    may be dropped.
    """
    held = with_direction(problem, named[0], split.held)
    before, after = (_squares(problem, _described(problem, *told, split), held) for told in (named, instead))
    return (1.0 - LEAST_GAIN) * after.error <= before.error


def _described(problem: Problem, found: Fit, formula: Formula | None, split: Split) -> Model:
    """Return the model of `formula`; without a formula, the model with the causes fitted on `split.fit`."""
    if formula is not None:
        return formula.model
    learned = fit_on_simulation_error(problem, found, mask=split.fit)
    return learned.hypothesis.model(learned.point)


def _squares(problem: Problem, model: Model, held: NDArray[np.bool_]) -> Elsewhere:
    """Return the squares of the simulation error over the held-out samples, in BLOCKS blocks of time."""
    left = (problem.frame.target - problem.predicted(model))[held]
    blocks = np.arange(len(left)) * BLOCKS // max(len(left), 1)
    return Elsewhere(np.bincount(blocks, left**2, BLOCKS).astype(np.float64))


@dataclass(frozen=True)
class Claims:
    """Reported causes with their groups of alternatives; `base` is the recalibration under the same noise model."""

    selection: Selection
    base: Fit
    findings: tuple[Finding, ...]  # structure of the residual
    groups: tuple[Group, ...]
    errors: HeldOut
    formula: Formula | None  # formula of that structure

    @property
    def share(self) -> float:
        """Return the share of the residual's mean square that is not noise."""
        return structure_share(self.findings)


def claims(problem: Problem, base: Fit, catalogue: Catalogue, split: Split, rng: np.random.Generator) -> Claims:
    """Return the causes that the data require, if they are meaningful and reduce the error on held-out data."""
    return _without(problem, base, base, catalogue, (), split, rng)


def _without(
    problem: Problem,
    base: Fit,
    start: Fit,
    catalogue: Catalogue,
    names: Sequence[str],
    split: Split,
    rng: np.random.Generator,
) -> Claims:
    """Return the claims of a selection that starts from the causes of `start`, without the effects in `names`.

    A dropped cause may have hidden another one, so the selection is repeated without the dropped effect. Each
    repetition excludes one more effect, so the search ends. An excluded effect that returns as the alternative of
    another cause is not dropped again.
    """
    left = {name: variants for name, variants in catalogue.items() if name not in names}
    rounds: tuple[Round, ...] = ()
    while True:
        selection, findings = _searched(problem, start, left, rng)
        rounds = (*rounds, *selection.rounds)
        named = selection.fitted.names
        selection, grouped = alternatives(selection, catalogue, findings)
        selection, groups = parted(selection, catalogue, findings, grouped)
        problem, start = selection.problem, selection.fitted
        dropped = _dropped(named, start.names)
        if not dropped:
            base = fit(problem, base.hypothesis, base.point)
            errors = held_out(problem, base, start, split, structure_share(findings))
            if errors.worthless is None or start.names[errors.worthless] not in left:
                break
            dropped = [start.names[errors.worthless]]
            start = selection.without([errors.worthless]).fitted
        left = {name: variants for name, variants in left.items() if name not in dropped}
    if not structure_share(findings):
        bent = _not_flat(problem, start, split, errors.noise_floor)
        findings = (*findings, bent) if bent is not None else findings
    formula = formula_of_what_is_left(problem, start, split) if structure_share(findings) else None
    found = Claims(replace(selection, rounds=rounds), base, findings, groups, errors, formula)
    if not structure_share(findings):
        return found
    index = stand_in(problem, start, groups, split, formula)
    if index is None or start.names[index] not in left:
        return found
    others = selection.without([index]).fitted
    gone = [*(name for name in catalogue if name not in left), start.names[index]]
    instead = _without(problem, base, others, catalogue, gone, split, rng)
    instead = replace(instead, selection=replace(instead.selection, rounds=(*rounds, *instead.selection.rounds)))
    told, described = ((each.selection.fitted, each.formula) for each in (found, instead))
    return instead if keeps_its_promise(problem, split, told, described) else found


def _searched(
    problem: Problem, start: Fit, catalogue: Catalogue, rng: np.random.Generator
) -> tuple[Selection, tuple[Finding, ...]]:
    """Return the selected causes and the structure of their residual.

    If structure remains, the noise model contains it, and comparisons under this model are unreliable. With at least
    FEWEST_LOGS logs the selection is then repeated from other first causes. If one of these selections leaves more than
    noise, it is also repeated from other second causes after the same first one. The selection with the best prediction
    of logs not used in the fit is returned, if it is clearly better than the first selection.
    """
    greedy = select(problem, start, catalogue, rng)
    found = [residual_structure(greedy, catalogue, rng)]
    if len(used_logs(problem)) >= FEWEST_LOGS and structure_share(found[0][1]) and not start.names:
        for begin, first in other_starts(problem, greedy.rounds[0], catalogue):
            other = select(begin, first, catalogue, rng)
            found.append(residual_structure(other, catalogue, rng))
            if leaves_more_than_noise(other.problem, other.fitted):
                found += [
                    residual_structure(select(*each, catalogue, rng), catalogue, rng)
                    for each in other_starts(begin, other.rounds[0], catalogue)
                ]
    if len(found) == 1:
        return found[0]
    errors = [left_out_error(each.problem, each.fitted) for each, _ in found]
    best = int(np.argmin(errors))
    return found[best] if errors[best] < (1.0 - LEAST_GAIN) * errors[0] else found[0]


def _not_flat(problem: Problem, found: Fit, split: Split, noise: float) -> Finding | None:
    """Return the signal on which the sliding error depends after the best fit of these causes; None if it is flat."""
    best = fit_on_simulation_error(problem, found, mask=split.shipped)
    residuals = full_residuals(problem.frame, best.hypothesis.model(best.point))
    learned = [bool(split.shipped[part].any()) for part in problem.frame.slices]
    pairs = [pair for pair, own in zip(zip(problem.frame.runs, residuals, strict=True), learned, strict=True) if own]
    return not_flat([run for run, _ in pairs], [residual for _, residual in pairs], noise)


def _dropped(before: Sequence[str], after: Sequence[str]) -> list[str]:
    """Return the names that are missing in `after`; an empty list if `after` is not shorter than `before`."""
    return [name for name in before if name not in after] if len(after) < len(before) else []


# Determine the alternatives of each cause, and drop the causes that these logs do not support.


def alternatives(
    chosen: Selection, catalogue: Catalogue, findings: Sequence[Finding]
) -> tuple[Selection, tuple[Group, ...]]:
    """Return the selection without causes that would be a guess, and the group of each remaining cause.

    `findings` is the structure of the residual.
    """
    problem = chosen.problem
    structure = error_criterion(problem, chosen.fitted, findings)
    grouped = groups(problem, chosen.fitted, catalogue, structure)
    while (found := _simpler(problem, chosen.fitted, grouped)) is not None:
        chosen = chosen.with_fit(found)
        structure = error_criterion(problem, chosen.fitted, findings)
        grouped = groups(problem, chosen.fitted, catalogue, structure)
    guesses = _less_than_structure(problem, chosen.fitted, grouped, findings)
    unmeant = meaningless if structure is None else meaningless_by_error
    while guesses or (guesses := unmeant(problem, chosen.fitted)):
        chosen = chosen.without(guesses)
        grouped = groups(problem, chosen.fitted, catalogue, structure)
        guesses = []
    return chosen, tuple(grouped)


def _takes_the_place(rival: Rival) -> bool:
    """Return True if an alternative is an effect of the catalogue, not a wider recalibration or unrecorded input."""
    return not rival.fitted.hypothesis.wide_prior and rival.fitted.names[-1] == rival.name != UNRECORDED


def _simpler(problem: Problem, fitted: Fit, grouped: Sequence[Group]) -> Fit | None:
    """Return the fit with one cause replaced by its simpler limit, if the logs do not exclude that.

    For example, a spring whose stiffness may be zero is a constant torque. The spring is kept only if its simulation
    error is clearly smaller. The result is None if no cause is replaced.
    """
    reversals = models_reversals(fitted)
    for group in grouped:
        for rival in group.alternatives:
            if rival.name != SIMPLER.get(group.name) or not _takes_the_place(rival):
                continue
            error = simulation_error(problem, rival.fitted, reversals)
            if (1.0 - LEAST_GAIN) * error <= simulation_error(problem, fitted, reversals):
                return rival.fitted
    return None


def _less_than_structure(
    problem: Problem, fitted: Fit, grouped: Sequence[Group], findings: Sequence[Finding]
) -> list[int]:
    """Return the indices of those causes that explain less than the unexplained structure.

    A cause with alternatives in the catalogue is not listed. Any other cause is listed only if it explains less of the
    white residual and also less of the simulation error, because structure distorts the noise model.
    """
    shares = [finding.share for finding in findings if finding.found and finding.what != DRIFT]
    left = min(max(shares, default=0.0), 1.0)
    error = simulation_error(problem, fitted) if left > 0.0 else 0.0
    out = []
    for i, group in enumerate(grouped):
        if left <= 0.0 or group.catalogued:
            continue
        smaller = backward_step(problem, fitted, i)
        explained = simulation_error(problem, smaller, models_reversals(fitted)) - error
        if compared(problem, fitted, smaller, "nothing").worse < left * fitted.rss and explained < left * error:
            out.append(i)
    return out
