"""Which causes are claimed in the end: those that gain, elsewhere too, and that nothing simpler does better than."""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula, formula_of_what_is_left
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut, held_out
from tsa_ctrl.identify.diagnosis.parameters.instead import stand_in
from tsa_ctrl.identify.diagnosis.parameters.transfer import Transfer, local, transfer
from tsa_ctrl.identify.diagnosis.rivals.groups import Group
from tsa_ctrl.identify.diagnosis.selection.forward import Selection, without_causes


@dataclass(frozen=True)
class Claims:
    """The causes that are claimed, each with its group and what it takes of halves that it was not fitted on."""

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
    while True:
        problem, fitted = selection.problem, selection.fitted
        errors = held_out(problem, base, fitted, split, share)
        carried = transfer(problem, fitted) if errors.worthless is None else ()
        index = errors.worthless if errors.worthless is not None else local(carried)
        if index is None:
            formula = formula_of_what_is_left(problem, fitted, split) if share > 0.0 else None
            index = stand_in(problem, fitted, groups, split, formula) if share > 0.0 else None
            if index is None:
                return Claims(selection, groups, errors, carried, formula)
        selection = without_causes(selection, [index])
        groups = (*groups[:index], *groups[index + 1 :])
