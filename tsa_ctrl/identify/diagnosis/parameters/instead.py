"""Names that a plain formula does clearly better than: they stand for something that the catalogue lacks.

A torque sensor with two gains is fitted by sheaths that differ, a zero that follows the temperature by an offset, and
what the name leaves is told as structure. Where a formula without the name leaves visibly less on data that neither has
seen than the name does with all that a formula adds to it, or as little with fewer terms, the name is no claim, and the
formula is told alone. An effect of the catalogue is described no better, and by no fewer terms, than by itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import fit_on_simulation_error
from tsa_ctrl.identify.diagnosis.parameters.formula import LEAST_GAIN, Formula, formula_of_what_is_left
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import Elsewhere
from tsa_ctrl.identify.diagnosis.rivals.groups import Group
from tsa_ctrl.identify.diagnosis.selection.step import backward_step
from tsa_ctrl.model.parameters import Model

BLOCKS = 24  # of the held-out samples: as many as the evidence of a cause is taken from


def stand_in(
    problem: Problem, found: Fit, groups: Sequence[Group], split: Split, formula: Formula | None
) -> int | None:
    """Number of a cause without alternatives in whose place a formula does clearly better; None where none is.

    formula: what `found` leaves, told beside it.
    """
    alone = [index for index, group in enumerate(groups) if not group.alternatives]
    if not alone:
        return None
    present = _held(problem, _learned(problem, found, split) if formula is None else formula.model, split)
    terms = 1 if formula is None else 1 + formula.terms
    best, least = None, np.inf
    for index in alone:
        described = formula_of_what_is_left(problem, backward_step(problem, found, index), split)
        if described is None:
            continue
        error = _held(problem, described.model, split)
        as_good = described.terms < terms and (1.0 - LEAST_GAIN) * error.error <= present.error
        if (as_good or error.clearly_beats(present)) and error.error < least:
            best, least = index, error.error
    return best


def _learned(problem: Problem, found: Fit, split: Split) -> Model:
    """The model of what was found, fitted on the samples that are learned from."""
    learned = fit_on_simulation_error(problem, found, mask=split.fit)
    return learned.hypothesis.model(learned.point)


def _held(problem: Problem, model: Model, split: Split) -> Elsewhere:
    """Squares of the simulation error over the held-out samples, in blocks of time."""
    left = (problem.frame.target - problem.predicted(model))[split.held]
    blocks = np.arange(len(left)) * BLOCKS // max(len(left), 1)
    return Elsewhere(np.bincount(blocks, left**2, BLOCKS).astype(np.float64))
