"""Structure: what is left beyond noise once the causes are named, and when it decides instead of the noise.

On measured drives most of what is left is structure that nothing in the catalogue explains. There white residuals say
which of two wrong models has the whiter error, and a difference smaller than what is left unexplained excludes nothing.
So where structure is most of what is left, the simulation error decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, gradients
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import simulation_error
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue
from tsa_ctrl.identify.diagnosis.noise.nuisance import FASTEST, fast
from tsa_ctrl.identify.diagnosis.residual import changes, features
from tsa_ctrl.identify.diagnosis.residual.changes import BURST
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding, dependence
from tsa_ctrl.identify.diagnosis.selection.forward import Selection, forward_on_simulation_error
from tsa_ctrl.model.functions import Array

# Share of what is left that is structure: from half on it is more than the noise, which then no longer decides
STRUCTURE = 0.5
PART = 0.5  # of what a cause explains, that a rival must explain: less is closer to nothing than to the cause


@dataclass(frozen=True)
class ErrorCriterion:
    """The simulation-error criterion: `share` of what is left that is structure; `error`: sum of squares, (N*m)^2."""

    share: float
    error: float

    def covers(self, rival: float, without: float) -> bool:
        """Whether a rival with this simulation error, where `without` any it is that much, does as well as the cause.

        It does when it explains more than half as much, and is worse by less than what is left unexplained.
        """
        worse = rival - self.error
        return worse < self.share * self.error and worse < (1.0 - PART) * (without - self.error)


def residual_structure(
    chosen: Selection, catalogue: Catalogue, rng: np.random.Generator
) -> tuple[Selection, tuple[Finding, ...]]:
    """What the causes leave; where that is mostly structure, first with the further causes that the error demands."""
    findings = _findings(chosen.problem, chosen.fitted, rng)
    while error_criterion(chosen.problem, chosen.fitted, findings) is not None:
        more = forward_on_simulation_error(chosen, catalogue)
        if more is None:
            break
        chosen, findings = more, _findings(more.problem, more.fitted, rng)
    return chosen, tuple(findings)


def structure_share(findings: Sequence[Finding]) -> float:
    """Of the mean square of what is left, that is structure."""
    return max((finding.share for finding in findings if finding.found), default=0.0)


def error_criterion(problem: Problem, fitted: Fit, findings: Sequence[Finding]) -> ErrorCriterion | None:
    """None where noise decides."""
    share = min(structure_share(findings), 1.0)
    return ErrorCriterion(share, simulation_error(problem, fitted)) if share > STRUCTURE and fitted.names else None


def _findings(problem: Problem, fitted: Fit, rng: np.random.Generator) -> list[Finding]:
    """All tests of what the causes found leave."""
    frame = problem.frame
    predicted = problem.predicted(fitted.hypothesis.model(fitted.point))
    sigma, load = features.direction_and_load(frame, predicted)
    families = features.families(frame, predicted, rng)
    families["time"] = features.time_family(frame, sigma, load)
    known, columns = _white(problem, fitted, families)
    factors = {"the torque": np.ones(len(frame)), "the friction": sigma, "the gain": load}
    masked = {name: factor[problem.mask] for name, factor in factors.items()}
    dependences = dependence(fitted.residual, known, columns, problem.blocks, rng)
    noise = rng.standard_normal((problem.count, changes.DRAWS))
    told = problem.nuisance.told(len(frame)) & problem.mask
    rest = _interpolated(frame.target - predicted, told, frame.period)
    return [
        *dependences,
        changes.steps(problem, fitted.residual, known, factors, noise),
        changes.lines(fitted.residual, masked, problem.mask, frame.period),
        changes.bursts(fitted.residual, frame.period),
        changes.drift(rest, problem.mask, frame.slices, frame.period, problem.noise.rms),
    ]


def _white(problem: Problem, fitted: Fit, families: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
    """What is no structure (see `_explained`), and the columns (m, k) of each family, white."""
    return _explained(problem, fitted), {name: problem.whiten(family) for name, family in families.items()}


def _explained(problem: Problem, fitted: Fit) -> Array:
    """What is no structure, (m, k) white: every coordinate, also where a bound holds it, and noise of tau_m."""
    columns = [gradients(problem, fitted)]
    if problem.base.target != "tau_m":
        frame = problem.frame
        columns.append(problem.whiten(np.column_stack([frame.stack(fast(frame, edge)) for edge in FASTEST])))
    return np.concatenate(columns, axis=1)


def _interpolated(residual: Array, told: NDArray[np.bool_], period: float) -> Array:
    """A residual (n,) in N*m, what is not told filled by straight lines between means beside it.

    One sample on either side of seconds that are not known would be a drift by itself.
    """
    if told.all() or not told.any():
        return residual
    from scipy.ndimage import uniform_filter1d  # slow to import

    width = max(1, round(BURST / period))
    share = np.maximum(uniform_filter1d(told.astype(np.float64), width), 0.5 / width)
    means = uniform_filter1d(np.where(told, residual, 0.0), width) / share
    index = np.arange(len(residual))
    return np.where(told, residual, np.interp(index, index[told], means[told]))
