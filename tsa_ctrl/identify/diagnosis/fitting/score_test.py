"""Find the effect that would explain a residual best, by one projection on the exact response of each candidate.

A response is the difference between the model with and without the effect, not a linearisation: a linearised delay
caused a false second cause in ten of ten logs. Only amplitudes, which are nearly linear, are solved for. All other
coordinates are refined by a subsequent fit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.model.effects.search import Variant
from tsa_ctrl.model.functions import Array

# Amplitude (in units of the torque) of a nearly linear response: small, so that it is linear; far above rounding
TRIAL = 0.02
STRETCH = 1.6  # largest factor by which the response of a grid point may be scaled before the fit refines it


@dataclass(frozen=True)
class Response:
    """Hold the contribution of a variant to the prediction from one start.

    `columns` (n, k) are in N*m at the score rate, per unit of each amplitude.
    """

    variant: Variant
    start: Array
    columns: Array


@dataclass(frozen=True)
class Score:
    """Hold the expected gain of a response (decrease of the sum of squares), and the start values for a fit."""

    variant: Variant
    start: Array
    gain: float
    columns: Array  # (m, k), white, with the fitted parameters projected out
    whole: float  # decrease by the response without scaling


def responses(problem: Problem, fitted: Fit, variants: Iterable[Variant]) -> list[Response]:
    """Return the response of each start of each variant in addition to the effects of `fitted`.

    Impossible combinations are omitted.
    """
    present = problem.predicted(fitted.hypothesis.model(fitted.point))
    out = []
    for variant in variants:
        hypothesis = fitted.hypothesis.plus(variant)
        for start in variant.starts:
            begin = np.array(start)
            try:
                raw = [
                    (problem.predicted(hypothesis.model(np.concatenate([fitted.point, point]))) - present) / unit
                    for point, unit in _trial_points(variant, begin)
                ]
            except UsageError:
                break
            columns = np.column_stack(raw)
            if np.all(np.isfinite(columns)):
                out.append(Response(variant, begin, columns))
    return out


def _trial_points(variant: Variant, start: Array) -> list[tuple[Array, float]]:
    if not variant.amplitude:
        return [(start, 1.0)]
    points = []
    for index in variant.amplitude:
        unit = min(TRIAL, 0.5 * (variant.coordinates[index].high - start[index]))
        point = start.copy()
        point[index] += unit
        points.append((point, unit))
    return points


def scores(problem: Problem, fitted: Fit, found: Sequence[Response]) -> list[Score]:
    """Return one score per response, whitened under the problem's noise."""
    if not found:
        return []
    basis = orthonormal(fitted.jacobian)
    residual = fitted.residual - basis @ (basis.T @ fitted.residual)
    white = problem.whiten(np.concatenate([response.columns for response in found], axis=1))
    white -= basis @ (basis.T @ white)
    ends = np.cumsum([response.columns.shape[1] for response in found])
    parts = np.split(white, ends[:-1], axis=1)
    return [_score(response, columns, residual) for response, columns in zip(found, parts, strict=True)]


def _score(response: Response, columns: Array, residual: Array) -> Score:
    """Return the score of a response with its white columns (m, k)."""
    variant = response.variant
    if variant.amplitude:
        start, gain = _amplitudes(variant, response.start, columns, residual)
        return Score(variant, start, gain, columns, gain)
    start, gain = _whole(variant, response.start, columns, residual)
    whole = 2.0 * float(columns[:, 0] @ residual) - float(columns[:, 0] @ columns[:, 0])
    return Score(variant, start, gain, columns, whole)


def best_by_effect(found: Iterable[Score]) -> list[Score]:
    """Return the best score of each effect, best effect first."""
    best: dict[str, Score] = {}
    for score in found:
        name = score.variant.effect
        if name not in best or score.gain > best[name].gain:
            best[name] = score
    return sorted(best.values(), key=lambda score: -score.gain)


def _whole(variant: Variant, start: Array, columns: Array, residual: Array) -> tuple[Array, float]:
    """Return start and gain of an effect without an amplitude; its response may be scaled, as the grid is coarse."""
    size = float(columns[:, 0] @ columns[:, 0])
    overlap = float(columns[:, 0] @ residual)
    share = min(max(overlap / size, 0.0), STRETCH) if variant.coordinates and size > 1e-9 else 1.0
    return start, 2.0 * share * overlap - share**2 * size


def _amplitudes(variant: Variant, start: Array, columns: Array, residual: Array) -> tuple[Array, float]:
    """Return the start with the best amplitudes within their bounds, and its gain.

    If a bound limits one amplitude, the others are solved again.
    """
    index = list(variant.amplitude)
    gram, slope = columns.T @ columns, columns.T @ residual
    gram = gram + (1e-9 * float(np.trace(gram)) + 1e-12) * np.eye(len(gram))
    low = np.array([variant.coordinates[i].low for i in index]) - start[index]
    high = np.array([variant.coordinates[i].high for i in index]) - start[index]
    free = np.linalg.solve(gram, slope)
    size = np.clip(free, low, high)
    for i in np.flatnonzero(size != free):
        others = [j for j in range(len(size)) if j != i]
        if others:
            part = gram[np.ix_(others, others)]
            size[others] = np.linalg.solve(part, slope[others] - gram[others, i] * size[i])
    begin = start.copy()
    begin[index] += size
    return begin, float(2.0 * slope @ size - size @ gram @ size)
