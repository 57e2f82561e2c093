"""Find structure in the residual: the part beyond noise that remains after the causes are identified.

On measured drives, most of the residual is structure that no effect of the catalogue explains. White residuals then
only show which of two wrong models has the whiter error. A difference smaller than the unexplained error excludes no
model. If structure is most of the residual, hypotheses are therefore compared by their simulation error and not by the
noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import DRAWS
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, gradients
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import simulation_error
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue
from tsa_ctrl.identify.diagnosis.noise.nuisance import FASTEST, fast, fast_part
from tsa_ctrl.identify.diagnosis.residual import changes, features
from tsa_ctrl.identify.diagnosis.residual.changes import BURST
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding, dependence, is_rounding
from tsa_ctrl.identify.diagnosis.selection.forward import Selection, forward_on_simulation_error
from tsa_ctrl.model.functions import Array

# Share of structure in the residual: above one half, structure exceeds the noise, and the noise no longer decides
STRUCTURE = 0.5
# Least ratio of the errors explained by a competing hypothesis and by the cause: below one half, a hypothesis is closer
# to no effect than to the cause
PART = 0.5


@dataclass(frozen=True)
class ErrorCriterion:
    """Criterion that compares competing hypotheses by their simulation error."""

    share: float  # share of structure in the residual
    error: float  # (N*m)^2, sum of squares of the simulation error with the causes

    def covers(self, rival: float, without: float) -> bool:
        """Return True if a competing hypothesis is as good as the cause.

        It must explain more than half as much as the cause. Its error must exceed that of the cause by less than the
        unexplained structure.

        Args:
            rival: sum of squares of the simulation error of the competing hypothesis, (N*m)^2.
            without: sum of squares without the cause and without the hypothesis, (N*m)^2.
        """
        worse = rival - self.error
        return worse < self.share * self.error and worse < (1.0 - PART) * (without - self.error)


def residual_structure(
    chosen: Selection, catalogue: Catalogue, rng: np.random.Generator
) -> tuple[Selection, tuple[Finding, ...]]:
    """Return the selection and the findings in its residual.

    While structure is most of the residual, further causes are added that reduce the simulation error sufficiently.
    """
    findings = _findings(chosen.problem, chosen.fitted, rng)
    while error_criterion(chosen.problem, chosen.fitted, findings) is not None:
        more = forward_on_simulation_error(chosen, catalogue)
        if more is None:
            break
        chosen, findings = more, _findings(more.problem, more.fitted, rng)
    return chosen, tuple(findings)


def structure_share(findings: Sequence[Finding]) -> float:
    """Return the share of structure in the mean square of the residual; 0 without a significant finding."""
    return max((finding.share for finding in findings if finding.found), default=0.0)


def error_criterion(problem: Problem, fitted: Fit, findings: Sequence[Finding]) -> ErrorCriterion | None:
    """Return the simulation-error criterion, or None if the noise decides or no cause is identified."""
    share = min(structure_share(findings), 1.0)
    return ErrorCriterion(share, simulation_error(problem, fitted)) if share > STRUCTURE and fitted.names else None


def _findings(problem: Problem, fitted: Fit, rng: np.random.Generator) -> list[Finding]:
    """Return the results of all tests of the residual of a fit; none if the residual is rounding, as in exact data."""
    frame = problem.frame
    predicted = problem.predicted(fitted.hypothesis.model(fitted.point))
    told = problem.nuisance.told(len(frame)) & problem.mask
    if told.any() and is_rounding((frame.target - predicted)[told], frame.target[told]):
        return []
    sigma, load = features.direction_and_load(frame, predicted)
    families = features.families(frame, predicted, rng)
    families["time"] = features.time_family(frame, sigma, load)
    known, columns = _white(problem, fitted, predicted, families)
    factors = {"the torque": np.ones(len(frame)), "the friction": sigma, "the gain": load}
    masked = {name: factor[problem.mask] for name, factor in factors.items()}
    dependences = dependence(fitted.residual, known, columns, problem.blocks, rng)
    noise = rng.standard_normal((problem.count, DRAWS))
    rest = _interpolated(frame.target - predicted, told, frame.period)
    return [
        *dependences,
        changes.steps(problem, fitted.residual, known, factors, noise),
        changes.lines(fitted.residual, masked, problem.mask, frame.period),
        changes.bursts(fitted.residual, frame.period),
        changes.drift(rest, problem.mask, frame.slices, frame.period, problem.noise.rms, tuple(factors.values())),
    ]


def _white(
    problem: Problem, fitted: Fit, predicted: Array, families: Mapping[str, Array]
) -> tuple[Array, dict[str, Array]]:
    """Return the columns of `_explained` and the columns (m, k) of each family, all white."""
    return _explained(problem, fitted, predicted), {name: problem.whiten(family) for name, family in families.items()}


def _explained(problem: Problem, fitted: Fit, predicted: Array) -> Array:
    """Return the columns that do not count as structure, (m, k), white.

    They are the gradients for all coordinates, including those held by a bound. If the model does not predict tau_m,
    the fast parts of tau_m follow, which may be noise, and those of the model's torque. If a drive compensates
    friction, tau_m has steps, near which its noise is unknown, and the model's torque has none.
    """
    columns = [gradients(problem, fitted)]
    if problem.base.target != "tau_m":
        frame = problem.frame
        parts = [frame.stack(fast(frame, edge)) for edge in FASTEST]
        for edge in FASTEST:
            parts.append(np.concatenate([fast_part(predicted[part], frame.period, edge) for part in frame.slices]))
        columns.append(problem.whiten(np.column_stack(parts)))
    return np.concatenate(columns, axis=1)


def _interpolated(residual: Array, told: NDArray[np.bool_], period: float) -> Array:
    """Return a residual (n,) in N*m whose unknown samples are interpolated linearly.

    The interpolation starts and ends at means over BURST. With single samples, their noise on either side of a gap of
    seconds would look like drift.

    Args:
        residual: residual, (n,) in N*m.
        told: mask of the known samples, (n,).
        period: period of the samples, s.
    """
    if told.all() or not told.any():
        return residual
    from scipy.ndimage import uniform_filter1d  # slow to import

    width = max(1, round(BURST / period))
    share = np.maximum(uniform_filter1d(told.astype(np.float64), width), 0.5 / width)
    means = uniform_filter1d(np.where(told, residual, 0.0), width) / share
    index = np.arange(len(residual))
    return np.where(told, residual, np.interp(index, index[told], means[told]))
