"""Estimate the noise from the part that the whole catalogue cannot explain, before the first cause and after each.

A spectrum of the residual of the base model would contain the hidden effect and hide it. All responses are therefore
projected out first. Under the resulting noise model, only the relevant responses are then projected out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import ROUNDING
from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Hypothesis, Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import Response, responses, scores
from tsa_ctrl.identify.diagnosis.hypotheses.base import base_of
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue, all_but
from tsa_ctrl.identify.diagnosis.noise.autoregressive import Noise, estimate, white_noise
from tsa_ctrl.identify.diagnosis.noise.nuisance import Nuisance, nuisance
from tsa_ctrl.model.effects.search import Scales
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model

# Share of the torque: assumed white noise, which only the first fit uses as a weight; its residual replaces it
PILOT_NOISE = 0.02
# Least decrease of the sum of squares: the best of a thousand columns of noise takes 12 (twice the logarithm, less its
# own)
LEAST_DECREASE = 12.0
MOST_COLUMNS = 16  # most projected responses: several for each of the possible causes (selection.forward.MOST_CAUSES)
# Largest number of projected directions as a share of the samples: more would remove a part of the estimated noise
MOST_SHARE = 0.1


def recalibrated(frame: Frame, model: Model, scales: Scales, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """Return the noise model of the part that the catalogue cannot explain, and the recalibrated base under it."""
    base = base_of(model, scales)
    start = Hypothesis(base)
    nothing = Nuisance(np.zeros((len(frame), 0)))
    problem = Problem(frame, base, white_noise(PILOT_NOISE * scales.torque), nothing, frame.train)
    fitted = fit(problem, start, base.start())
    problem = dataclasses.replace(problem, nuisance=nuisance(frame, base, start.model(fitted.point)))
    fitted = fit(problem, start, fitted.point)
    return pilot_noise(problem, fitted, catalogue)


def pilot_noise(problem: Problem, fitted: Fit, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """Return the problem under its noise model, and the same hypothesis refitted under it."""
    found = responses(problem, fitted, all_but(fitted.names, catalogue))
    for span in (_saturated, _pursuit):
        problem, fitted = _under(problem, fitted, span(problem, fitted, found))
    return problem, fitted


def _under(problem: Problem, fitted: Fit, basis: Array) -> tuple[Problem, Fit]:
    problem = problem.with_noise(_noise_after(problem, fitted.residual, basis))
    return problem, fit(problem, fitted.hypothesis, fitted.point)


def _noise_after(problem: Problem, residual: Array, basis: Array) -> Noise:
    """Estimate the noise from the white residual (m,) after `basis` (m, k) is projected out."""
    rest = residual - basis @ (basis.T @ residual)
    count = len(problem.frame)
    full, spread = np.zeros(count), np.zeros((count, basis.shape[1]))
    full[problem.mask], spread[problem.mask] = rest, basis
    frame = problem.frame
    least = ROUNDING * float(np.mean(np.square(frame.target)))
    return estimate(full, spread, problem.mask, frame.slices, frame.period, problem.noise, least)


def _saturated(problem: Problem, fitted: Fit, found: Sequence[Response]) -> Array:
    """Return a basis of the fitted parameters and the leading directions of all responses."""
    columns = np.concatenate([score.columns for score in scores(problem, fitted, found)], axis=1)
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 1e-9 * max(norms.max(initial=0.0), 1e-300)]
    columns = columns / np.linalg.norm(columns, axis=0)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    most = max(4, int(MOST_SHARE * problem.count))
    keep = np.flatnonzero(values > 1e-4 * values[-1])[-most:]
    return orthonormal(np.concatenate([fitted.jacobian, columns @ vectors[:, keep]], axis=1))


def _pursuit(problem: Problem, fitted: Fit, found: Sequence[Response]) -> Array:
    """Return a basis of the fitted parameters and of the responses that orthogonal matching pursuit selects."""
    basis = orthonormal(fitted.jacobian)
    columns = np.concatenate([score.columns for score in scores(problem, fitted, found)], axis=1)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-9)
    gram = columns.T @ columns
    slope = columns.T @ (fitted.residual - basis @ (basis.T @ fitted.residual))
    chosen: list[int] = []
    for _ in range(MOST_COLUMNS):
        sizes = np.diag(gram)
        decrease = np.where(sizes > 1e-4, slope**2 / np.maximum(sizes, 1e-4), 0.0)
        best = int(np.argmax(decrease))
        if decrease[best] < LEAST_DECREASE:
            break
        chosen.append(best)
        ratio = gram[best] / gram[best, best]
        slope = slope - ratio * slope[best]
        gram = gram - np.outer(gram[best], ratio)
    return np.column_stack([basis, orthonormal(columns[:, chosen])])
