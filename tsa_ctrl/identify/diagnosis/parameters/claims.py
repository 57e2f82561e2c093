"""Which causes are claimed in the end: those that gain, elsewhere too, and that nothing simpler does better than."""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula, formula_of_what_is_left
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut, held_out
from tsa_ctrl.identify.diagnosis.parameters.instead import keeps_its_promise, stand_in
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
