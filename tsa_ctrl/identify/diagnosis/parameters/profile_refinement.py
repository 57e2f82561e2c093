"""Refine parameters that are a time or a width (lag, delay, backlash, presliding) on their profile.

Along these parameters the prediction jumps at every reversal, so a gradient determines neither the best value nor its
uncertainty. The columns that free the time of each reversal remove exactly the pulses that determine the parameter.
These columns are therefore omitted here. The sum of squares of each block is computed along the parameter, and all
other parameters are solved for linearly.

The interval comes from resampling blocks with replacement (a block bootstrap, Efron and Tibshirani 1993). If the
residual has structure, states of motion are resampled as well, and the larger spread is used (`refit`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import CERTAIN, LEAST_GAIN, UNDOUBTED
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, gradients
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import models_reversals, on_simulation_error
from tsa_ctrl.identify.diagnosis.noise.nuisance import Nuisance
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit, states_of
from tsa_ctrl.model.functions import Array

# Points of a profile: the step is a twentieth of its half width, and a parabola finds the minimum between points
POINTS = 41
FIRST_SPAN = 2.0  # steps of the coordinate to either side; the span is doubled if this is too narrow
DOUBLINGS = 6  # number of spans tried, each twice the last: beyond 32 times the first one, the parameter is unknown
DRAWS = 400  # resamples: they determine a standard deviation to 4 %
# Largest ratio of the sum of squares after and before refinement: a larger one belongs to other parameters
MOST_RSS = 1.0 + LEAST_GAIN
UNEVEN = 0.5  # share of a grid step: jumps of single samples limit the smoothness of a profile


def profile_refined(problem: Problem, reported: Refit) -> Refit:
    """Return `reported` with each parameter that is a time or a width moved to the minimum of its profile.

    The variances of these parameters come from resampled blocks.
    """
    found = reported.fitted
    nonsmooth = np.flatnonzero(found.hypothesis.nonsmooth & found.free)
    if not nonsmooth.size:
        return reported
    plain = on_simulation_error(problem, models_reversals(found))
    bare = dataclasses.replace(plain, nuisance=Nuisance(plain.nuisance.smooth))
    covariance = reported.covariance.copy()
    clusters = (bare.blocks, states_of(bare)) if reported.structured else (bare.blocks,)
    for i in nonsmooth:
        before = float(np.sqrt(max(covariance[i, i], 0.0)))
        best, deviation = _resampled(bare, found, int(i), clusters, CERTAIN * before if reported.structured else 0.0)
        covariance[i, :] *= deviation / before if before > 0.0 else 0.0
        covariance[:, i] = covariance[i, :]
        covariance[i, i] = deviation**2
        found = _with_coordinate(plain, found, int(i), best)
    return dataclasses.replace(reported, fitted=found, covariance=covariance)


def _resampled(
    problem: Problem, found: Fit, index: int, clusters: Sequence[NDArray[np.int64]], reach: float
) -> tuple[float, float]:
    """Return the best value of one coordinate and its standard deviation, in the coordinate's scale.

    The profile extends at least `reach` to either side of the present value, within its bounds.
    """
    present = dataclasses.replace(found, residual=_residual(problem, found, found.point))
    others = orthonormal(np.delete(gradients(problem, present), index, axis=1))

    def squares(u: float) -> Array:
        point = found.point.copy()
        point[index] = u
        rest = _residual(problem, found, point)
        rest = rest - others @ (others.T @ rest)
        return np.asarray(rest * rest)

    grid = _grid(found, index, lambda u: float(squares(u).sum()), reach)
    profile = np.array([squares(float(u)) for u in grid])
    spread = 0.0
    for cluster in clusters:
        count = int(cluster.max(initial=0)) + 1
        within = np.array([np.bincount(cluster, each, count) for each in profile])
        drawn = np.random.default_rng(0).multinomial(count, np.full(count, 1.0 / count), DRAWS)
        spread = max(spread, float(np.std(_lowest(grid, within @ drawn.T))))
    step = float(grid[1] - grid[0])
    return float(_lowest(grid, profile.sum(axis=1, keepdims=True))[0]), float(np.hypot(spread, UNEVEN * step))


def _grid(found: Fit, index: int, total: Callable[[float], float], reach: float) -> Array:
    """Return POINTS values around the present one, (POINTS,), in the coordinate's scale.

    They extend to either side at least by `reach`, and until the sum of squares has risen well above the noise. The
    bounds and DOUBLINGS limit the range.
    """
    coordinate = found.hypothesis.coordinates[index]
    middle = float(found.point[index])
    span = max(FIRST_SPAN * coordinate.step, reach)
    enough = total(middle) + UNDOUBTED
    for _ in range(DOUBLINGS):
        low, high = max(coordinate.low, middle - span), min(coordinate.high, middle + span)
        if all(end in (coordinate.low, coordinate.high) or total(end) > enough for end in (low, high)):
            break
        span *= 2.0
    return np.linspace(low, high, POINTS)


def _residual(problem: Problem, found: Fit, point: Array) -> Array:
    return problem.measured - problem.whiten(problem.predicted(found.hypothesis.model(point)))


def _lowest(grid: Array, profiles: Array) -> Array:
    """Return the position of the minimum of each profile (points, k), by a parabola between grid points: (k,)."""
    at = np.clip(np.argmin(profiles, axis=0), 1, len(grid) - 2)
    column = np.arange(profiles.shape[1])
    before, here, after = profiles[at - 1, column], profiles[at, column], profiles[at + 1, column]
    bend = before - 2.0 * here + after
    shift = np.where(bend > 0.0, 0.5 * (before - after) / np.where(bend > 0.0, bend, 1.0), 0.0)
    return np.asarray(grid[at] + np.clip(shift, -1.0, 1.0) * (grid[1] - grid[0]))


def _with_coordinate(problem: Problem, found: Fit, index: int, value: float) -> Fit:
    """Return the fit with one coordinate set to `value`, and with the others adjusted by one step.

    The adjusted fit is used only if it is better. Return `found` if the sum of squares grows by more than MOST_RSS.
    """
    point = found.point.copy()
    point[index] = value
    alone = _at(problem, found, point)
    others = found.free & (np.arange(len(point)) != index)
    columns = gradients(problem, alone)[:, others]
    point = point.copy()
    point[others] += np.linalg.lstsq(columns, alone.residual, rcond=1e-8)[0]
    followed = _at(problem, found, np.clip(point, found.hypothesis.low, found.hypothesis.high))
    best = min(alone, followed, key=lambda each: each.rss)
    return best if best.rss < MOST_RSS * found.rss else found


def _at(problem: Problem, found: Fit, point: Array) -> Fit:
    residual = _residual(problem, found, point)
    return dataclasses.replace(found, point=point, residual=residual, rss=float(residual @ residual))
