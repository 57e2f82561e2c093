"""Each cause with what these logs cannot tell from it; where structure decides, first the name that simulates best."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import models_reversals, simulation_error
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue
from tsa_ctrl.identify.diagnosis.residual.changes import DRIFT
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.diagnosis.residual.structure import error_criterion
from tsa_ctrl.identify.diagnosis.rivals.groups import UNRECORDED, Group, Rival, compared, groups
from tsa_ctrl.identify.diagnosis.selection.forward import Selection, with_fit, without_causes
from tsa_ctrl.identify.diagnosis.selection.meaning import SIMPLER, meaningless, meaningless_by_error
from tsa_ctrl.identify.diagnosis.selection.step import backward_step

MOST_CHANGES = 8  # of a name, by a rival that does better: each leaves less, so that they end, and few are ever needed
CLEARLY_BETTER = 0.9  # of the mean square: 5 % of the RMS, which a user sees in a picture of both


def alternatives(
    chosen: Selection, catalogue: Catalogue, findings: Sequence[Finding]
) -> tuple[Selection, tuple[Group, ...]]:
    """The causes, those that are no more than a guess left out, and the group of each. `findings`: what they leave."""
    problem = chosen.problem
    structure = error_criterion(problem, chosen.fitted, findings)
    if structure is not None:
        chosen = dataclasses.replace(chosen, fitted=_by_simulation_error(problem, chosen.fitted, catalogue))
        structure = error_criterion(problem, chosen.fitted, findings)
    grouped = groups(problem, chosen.fitted, catalogue, structure)
    for _ in range(MOST_CHANGES):
        found = _winner(grouped)
        if found is None and structure is not None:
            found = _better(problem, chosen.fitted, grouped)
        if found is None:
            found = _simpler(problem, chosen.fitted, grouped)
        if found is None:
            break
        chosen = with_fit(chosen, found)
        structure = error_criterion(problem, chosen.fitted, findings)
        grouped = groups(problem, chosen.fitted, catalogue, structure)
    guesses = _less_than_structure(problem, chosen.fitted, grouped, findings)
    if guesses:
        chosen = without_causes(chosen, guesses)
        grouped = groups(problem, chosen.fitted, catalogue, structure)
    unmeant = meaningless if structure is None else meaningless_by_error
    while unfounded := unmeant(problem, chosen.fitted):  # another variant, or without a guess beside it
        chosen = without_causes(chosen, unfounded)
        grouped = groups(problem, chosen.fitted, catalogue, structure)
    return chosen, tuple(grouped)


def _by_simulation_error(problem: Problem, fitted: Fit, catalogue: Catalogue) -> Fit:
    """The same effects, in those of their variants (elements, profiles, laws) that simulate best."""
    best, least = fitted, simulation_error(problem, fitted)
    base = len(fitted.hypothesis.base.coordinates())
    for index, variant in enumerate(fitted.hypothesis.variants):
        for other in catalogue[variant.effect]:
            if other.label == variant.label or variant.effect == "torque_ripple":  # cycles are what was measured
                continue
            variants = list(best.hypothesis.variants)
            variants[index] = other
            own = best.hypothesis.own(best.point)
            if len(other.coordinates) != len(variant.coordinates):
                continue
            hypothesis = dataclasses.replace(best.hypothesis, variants=tuple(variants))
            found = fit(problem, hypothesis, np.concatenate([best.point[:base], *own]))
            error = simulation_error(problem, found)
            if error < least:
                best, least = found, error
    return best


def _winner(grouped: Sequence[Group]) -> Fit | None:
    """The causes with a rival in place of one that it beats on samples that no fit has seen; None where none does."""
    for group in grouped:
        for rival in group.alternatives:
            if rival.wins_elsewhere and _takes_the_place(rival):
                return rival.fitted
    return None


def _takes_the_place(rival: Rival) -> bool:
    """Whether a rival is an effect that can be named: no wider recalibration, and nothing made up."""
    return not rival.fitted.hypothesis.wide_prior and rival.fitted.names[-1] == rival.name != UNRECORDED


def _better(problem: Problem, fitted: Fit, grouped: Sequence[Group]) -> Fit | None:
    """The causes with an alternative in place of one, that simulates best and clearly better; None where none does.

    For what is mostly structure: there the noise that whitens is no judge between alternatives.
    """
    reversals = models_reversals(fitted)
    best, least = None, CLEARLY_BETTER * simulation_error(problem, fitted, reversals)
    for group in grouped:
        for rival in group.alternatives:
            if not _takes_the_place(rival) or meaningless_by_error(problem, rival.fitted):
                continue
            error = simulation_error(problem, rival.fitted, reversals)
            if error < least:
                best, least = rival.fitted, error
    return best


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
