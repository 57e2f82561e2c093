"""Where the model is off by more than noise: what is decided by the simulation error instead of by the noise.

On measured drives most of what is left is structure that nothing in the catalogue explains. There white residuals say
which of two wrong models has the whiter error, and a difference smaller than what is left unexplained excludes nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Variant
from tsa_ctrl.identify.diagnosis.parameters.refit import refit

STRUCTURE = 0.5  # share of what is left that is structure, from which on it decides
PART = 0.5  # of what a cause explains, that a rival must explain


@dataclass(frozen=True)
class Misfit:
    """`share` of what is left that is structure; `error`: (N*m)^2, sum of squares of the simulation error."""

    share: float
    error: float

    def covers(self, rival: float, without: float) -> bool:
        """Whether a rival with this simulation error, where `without` any it is that much, does as well as the cause.

        It does when it explains more than half as much, and is worse by less than what is left unexplained.
        """
        worse = rival - self.error
        return worse < self.share * self.error and worse < (1.0 - PART) * (without - self.error)


def misfit(problem: Problem, fitted: Fit, share: float) -> Misfit | None:
    """None where noise decides. `share` of what is left that is structure."""
    share = min(share, 1.0)
    return Misfit(share, plain_error(problem, fitted)) if share > STRUCTURE and fitted.names else None


def plain_error(problem: Problem, fitted: Fit, reversals: bool | None = None) -> float:
    """Sum of squares of the simulation error of a hypothesis fitted on it, (N*m)^2 at the score rate.

    `reversals` as of `refit`.
    """
    return refit(problem, fitted, reversals=reversals).fitted.rss * problem.noise.rms**2


def by_simulation_error(problem: Problem, fitted: Fit, catalogue: Mapping[str, tuple[Variant, ...]]) -> Fit:
    """The same effects, in those of their variants (elements, profiles, laws) that simulate best."""
    best, least = fitted, plain_error(problem, fitted)
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
            error = plain_error(problem, found)
            if error < least:
                best, least = found, error
    return best
