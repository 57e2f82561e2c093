"""Which other effects this log cannot exclude in place of a named one.

A rival takes the place of the cause and everything is fitted anew; it stays an alternative unless it fits worse by more
than noise explains, that of the blocks included. `parameter_error` is the rival that needs no effect: recalibration
without regard to [uncertainty].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.candidates import Variant
from tsa_ctrl.identify.diagnosis.fit import Fit, safely
from tsa_ctrl.identify.diagnosis.problem import Problem
from tsa_ctrl.identify.diagnosis.selection import PER_COORDINATE, rivals, without

PARAMETER_ERROR = "parameter_error"
SURELY_WORSE = 14.0  # increase of the sum of squares (white units) that noise alone does not explain
MOST_SPREAD = 3.0  # times the deviation in white noise that blocks may show
FITTED = 6  # rivals that are fitted in full


@dataclass(frozen=True)
class Rival:
    """`worse`: increase of the sum of squares, in units in which its deviation is that of white noise."""

    name: str
    fitted: Fit
    worse: float

    @property
    def excluded(self) -> bool:
        return self.worse > SURELY_WORSE


@dataclass(frozen=True)
class Group:
    """A cause with what it was compared to, best rival first; `probability` is that of the cause within its group."""

    name: str
    rivals: tuple[Rival, ...]

    @property
    def alternatives(self) -> tuple[Rival, ...]:
        return tuple(rival for rival in self.rivals if not rival.excluded)

    @property
    def probability(self) -> float:
        weights = [np.exp(-0.5 * max(rival.worse, 0.0)) for rival in self.alternatives]
        return float(1.0 / (1.0 + sum(weights)))


def groups(problem: Problem, fitted: Fit, catalogue: Mapping[str, tuple[Variant, ...]]) -> list[Group]:
    """One group for each cause of `fitted`."""
    return [_group(problem, fitted, index, catalogue) for index in range(len(fitted.names))]


def _group(problem: Problem, fitted: Fit, index: int, catalogue: Mapping[str, tuple[Variant, ...]]) -> Group:
    smaller = without(problem, fitted, index)
    found = []
    for rival in rivals(problem, smaller, catalogue, fitted.names, FITTED):
        found.append(compared(problem, fitted, rival, rival.names[-1]))
    wide = dataclasses.replace(smaller.hypothesis, wide=True)
    if not np.all(smaller.free[: len(wide.base.coordinates())]):
        free = safely(problem, wide, smaller.point)
        if free is not None:
            found.append(compared(problem, fitted, free, PARAMETER_ERROR))
    return Group(fitted.names[index], tuple(sorted(found, key=lambda rival: rival.worse)))


def compared(problem: Problem, fitted: Fit, rival: Fit, name: str) -> Rival:
    """How much worse `rival` fits; a further coordinate counts as in the selection.

    In white noise the increase of the sum of squares has the deviation 2 |d|, where d is the difference of the
    predictions; where the products of d with the residual add up to more within blocks, the increase counts less.
    """
    difference = fitted.residual - rival.residual
    total = rival.rss - fitted.rss
    within = np.bincount(problem.blocks, difference * fitted.residual)
    expected = max(float(np.linalg.norm(difference)), 1e-9)
    spread = min(max(1.0, float(np.linalg.norm(within - within.mean())) / expected), MOST_SPREAD)
    extra = PER_COORDINATE * (len(rival.point) - len(fitted.point))
    return Rival(name, rival, (total + min(extra, 0.0)) / spread**2)
