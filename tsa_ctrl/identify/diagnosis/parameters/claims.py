"""Decide the reported causes: those that gain, elsewhere too, and that nothing simpler does better than."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import fit_on_simulation_error
from tsa_ctrl.identify.diagnosis.parameters.formula import (
    LEAST_GAIN,
    Formula,
    formula_of_what_is_left,
    with_direction,
)
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut, held_out
from tsa_ctrl.identify.diagnosis.parameters.transfer import Transfer, local, transfer
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import Elsewhere
from tsa_ctrl.identify.diagnosis.rivals.groups import Group, made_up
from tsa_ctrl.identify.diagnosis.selection.forward import Selection, without_causes
from tsa_ctrl.identify.diagnosis.selection.step import backward_step
from tsa_ctrl.model.parameters import Model

# Causes that a formula explains clearly better: the true cause is outside the catalogue.
#
# Examples: sheaths that differ are fitted to a torque sensor with two gains, an offset to a zero that follows the
# temperature, and a spring to a tendon that creeps. The rest would be reported as structure. The formula replaces the
# cause if, on held-out data, its error is clearly smaller than that of the cause with its own formula, or equal with
# fewer terms. No formula describes an effect of the catalogue better, or with fewer terms, than the effect itself.

# Ratio of the mean square residuals of identified cause and formula, from which the formula replaces the cause: half of
# the RMS. A cause from the catalogue leaves noise, and no formula removes half of that.
FAR = 4.0
BLOCKS = 24  # of the held-out samples: as many as the evidence of a cause is taken from


def stand_in(
    problem: Problem, found: Fit, groups: Sequence[Group], split: Split, formula: Formula | None
) -> int | None:
    """Return the number of the cause that a formula replaces; None if no formula is clearly better.

    `formula` describes the residual of `found` and is reported with it. A cause with alternatives claims less, so only
    a formula with a single term that is better than each alternative replaces it. Logs of one program share the moments
    of their events without a physical reason, so a formula of time needs an improvement of `FAR`.
    """
    held = with_direction(problem, found, split.held)
    model = _described(problem, found, formula, split)
    present, whole = (_squares(problem, model, mask) for mask in (held, split.held))
    terms = 1 if formula is None else 1 + formula.terms
    best, least = None, np.inf
    for index, group in enumerate(groups):
        described = formula_of_what_is_left(problem, backward_step(problem, found, index), split)
        if described is None or (group.alternatives and described.terms > 1):
            continue
        error = _squares(problem, described.model, held)
        if error.error >= least or not _does_better(described, error, terms, present):
            continue
        if (1.0 - LEAST_GAIN) * _squares(problem, described.model, split.held).error > whole.error:
            continue  # a delay shows only in the reversals, where the direction is unknown
        others = (rival.fitted for rival in group.alternatives if not made_up(problem, rival.name))
        twins = (_described(problem, other, None, split) for other in others)
        if all(_does_better(described, error, terms, _squares(problem, twin, held)) for twin in twins):
            best, least = index, error.error
    return best


def _does_better(formula: Formula, error: Elsewhere, terms: int, named: Elsewhere) -> bool:
    """Return True if a formula with `error` replaces a cause that has `terms` terms and the error `named`."""
    as_good = formula.terms < terms and (1.0 - LEAST_GAIN) * error.error <= named.error
    beats = error.clearly_beats(named) and not formula.tells_when
    return as_good or beats or FAR * error.error < named.error


def keeps_its_promise(
    problem: Problem, split: Split, named: tuple[Fit, Formula | None], instead: tuple[Fit, Formula | None]
) -> bool:
    """Return True if the result `instead` of the named cause has no larger error than the result with it.

    Without this cause the selection runs again, and another cause may be dropped.
    """
    held = with_direction(problem, named[0], split.held)
    before, after = (_squares(problem, _described(problem, *told, split), held) for told in (named, instead))
    return (1.0 - LEAST_GAIN) * after.error <= before.error


def _described(problem: Problem, found: Fit, formula: Formula | None, split: Split) -> Model:
    """Return the model of the causes, with its formula; without one fitted on the samples that are learned from."""
    if formula is not None:
        return formula.model
    learned = fit_on_simulation_error(problem, found, mask=split.fit)
    return learned.hypothesis.model(learned.point)


def _squares(problem: Problem, model: Model, held: NDArray[np.bool_]) -> Elsewhere:
    """Squares of the simulation error over the held-out samples, in blocks of time."""
    left = (problem.frame.target - problem.predicted(model))[held]
    blocks = np.arange(len(left)) * BLOCKS // max(len(left), 1)
    return Elsewhere(np.bincount(blocks, left**2, BLOCKS).astype(np.float64))


@dataclass(frozen=True)
class Claims:
    """Return the reported causes, each with its group and its gain on halves that were not fitted."""

    selection: Selection
    groups: tuple[Group, ...]
    errors: HeldOut
    transfer: tuple[Transfer, ...]
    formula: Formula | None  # of what they leave


def claims(selection: Selection, groups: tuple[Group, ...], base: Fit, split: Split, share: float) -> Claims:
    """Without the causes that gain nothing on held-out data, that belong to one half of the logs, or whose place a
    formula takes.

    base: the recalibration. share: of the mean square that is left, that is no noise.
    """
    problem = selection.problem
    while True:
        errors = held_out(problem, base, selection.fitted, split, share)
        carried = transfer(problem, selection.fitted) if errors.worthless is None else ()
        index = errors.worthless if errors.worthless is not None else local(carried)
        if index is None:
            break
        selection, groups = _without(selection, groups, index)
    if share <= 0.0:
        return Claims(selection, groups, errors, carried, None)
    formula = formula_of_what_is_left(problem, selection.fitted, split)
    found = Claims(selection, groups, errors, carried, formula)
    index = stand_in(problem, selection.fitted, groups, split, formula)
    if index is None:
        return found
    instead = claims(*_without(selection, groups, index), base, split, share)
    named, described = ((each.selection.fitted, each.formula) for each in (found, instead))
    return instead if keeps_its_promise(problem, split, named, described) else found


def _without(selection: Selection, groups: tuple[Group, ...], index: int) -> tuple[Selection, tuple[Group, ...]]:
    return without_causes(selection, [index]), (*groups[:index], *groups[index + 1 :])
