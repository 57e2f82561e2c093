"""Each cause with what these logs cannot tell from it, without those that are no more than a guess."""

from __future__ import annotations

from collections.abc import Sequence

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import models_reversals, simulation_error
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue
from tsa_ctrl.identify.diagnosis.residual.changes import DRIFT
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.diagnosis.residual.structure import error_criterion
from tsa_ctrl.identify.diagnosis.rivals.groups import UNRECORDED, Group, Rival, compared, groups
from tsa_ctrl.identify.diagnosis.selection.forward import Selection
from tsa_ctrl.identify.diagnosis.selection.meaning import SIMPLER, meaningless, meaningless_by_error
from tsa_ctrl.identify.diagnosis.selection.step import backward_step

CLEARLY_BETTER = 0.9  # of the mean square: 5 % of the RMS, which a user sees in a picture of both


def alternatives(
    chosen: Selection, catalogue: Catalogue, findings: Sequence[Finding]
) -> tuple[Selection, tuple[Group, ...]]:
    """The causes, those that are no more than a guess left out, and the group of each. `findings`: what they leave."""
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
    """Whether a rival is an effect that can be named: no wider recalibration, and nothing made up."""
    return not rival.fitted.hypothesis.wide_prior and rival.fitted.names[-1] == rival.name != UNRECORDED


def _simpler(problem: Problem, fitted: Fit, grouped: Sequence[Group]) -> Fit | None:
    """The causes with the simpler effect that one turns into in its place, where the logs do not exclude it.

    A spring whose stiffness may as well be none is a constant torque; it is named only where it simulates clearly
    better. None where no cause has such a twin.
    """
    reversals = models_reversals(fitted)
    for group in grouped:
        for rival in group.alternatives:
            if rival.name != SIMPLER.get(group.name) or not _takes_the_place(rival):
                continue
            error = simulation_error(problem, rival.fitted, reversals)
            if CLEARLY_BETTER * error <= simulation_error(problem, fitted, reversals):
                return rival.fitted
    return None


def _less_than_structure(
    problem: Problem, fitted: Fit, grouped: Sequence[Group], findings: Sequence[Finding]
) -> list[int]:
    """Causes that stand alone, but explain less than what is left and no cause explains: a name would be a guess.

    Less of the white residual and of the simulation error, for what is left colours the noise that whitens.
    """
    shares = [finding.share for finding in findings if finding.found and finding.what != DRIFT]
    left = min(max(shares, default=0.0), 1.0)
    error = simulation_error(problem, fitted) if left > 0.0 else 0.0
    out = []
    for i, group in enumerate(grouped):
        if left <= 0.0 or group.alternatives:
            continue
        smaller = backward_step(problem, fitted, i)
        explained = simulation_error(problem, smaller, models_reversals(fitted)) - error
        if compared(problem, fitted, smaller, "nothing").worse < left * fitted.rss and explained < left * error:
            out.append(i)
    return out
