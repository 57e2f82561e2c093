"""Parameters that are a moment or a width (lag, delay, play, presliding): best value and interval from their profile.

Along them a prediction jumps at every reversal, so a gradient says neither where the best value is nor how sure it is,
and the columns that free each reversal's own moment take out the very pulses that tell it. So without these columns
the sum of squares is followed along the coordinate, block by block, everything else solved for linearly; blocks drawn
with replacement then spread the best value (a block bootstrap, Efron and Tibshirani 1993); where structure is left,
states of motion are drawn as well, and the wider spread counts (`refit`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, gradients
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import models_reversals, on_simulation_error
from tsa_ctrl.identify.diagnosis.noise.nuisance import Nuisance
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit, states_of
from tsa_ctrl.model.functions import Array

POINTS = 41  # of a profile: steps of a twentieth of its half, between which a parabola places the lowest point
FIRST_SPAN = 2.0  # steps of the coordinate, to either side: doubled where that is too near
DOUBLINGS = 6  # of the span: 64 times the first, beyond which nothing is known of it
HIGH_ENOUGH = 60.0  # white units above the best, at which a profile may end: 7 standard deviations
DRAWS = 400  # a standard deviation is then known to 4 %
REACH = 4.0  # standard deviations that a profile spans where they are known: of 400 draws hardly one lies beyond
# Of the sum of squares of the fit, of the refined one: a best moment that costs the others more is theirs, not its own
MOST_RSS = 1.1
UNEVEN = 0.5  # of a grid step: jumps of single samples make a profile no smoother


def profile_refined(problem: Problem, reported: Refit) -> Refit:
    """`reported` with those coordinates at the best of their profiles, their variances from resampled blocks."""
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
        best, deviation = _resampled(bare, found, int(i), clusters, REACH * before if reported.structured else 0.0)
        covariance[i, :] *= deviation / before if before > 0.0 else 0.0
        covariance[:, i] = covariance[i, :]
        covariance[i, i] = deviation**2
        found = _with_coordinate(plain, found, int(i), best)
    return dataclasses.replace(reported, fitted=found, covariance=covariance)


def _resampled(
    problem: Problem, found: Fit, index: int, clusters: Sequence[NDArray[np.int64]], reach: float
) -> tuple[float, float]:
    """Best value of one coordinate and its standard deviation, in its own scale; the profile spans `reach` at least."""
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
    """Values about the present one, so far to either side that the sum of squares has risen well above the noise.

    And `reach`, in the coordinate's scale, at least.
    """
    coordinate = found.hypothesis.coordinates[index]
    middle = float(found.point[index])
    span = max(FIRST_SPAN * coordinate.step, reach)
    enough = total(middle) + HIGH_ENOUGH
    for _ in range(DOUBLINGS):
        low, high = max(coordinate.low, middle - span), min(coordinate.high, middle + span)
        if all(end in (coordinate.low, coordinate.high) or total(end) > enough for end in (low, high)):
            break
        span *= 2.0
    return np.linspace(low, high, POINTS)


def _residual(problem: Problem, found: Fit, point: Array) -> Array:
    return problem.measured - problem.whiten(problem.predicted(found.hypothesis.model(point)))


def _lowest(grid: Array, profiles: Array) -> Array:
    """Where each of the profiles (points, k) is lowest, between grid points by a parabola: (k,)."""
    at = np.clip(np.argmin(profiles, axis=0), 1, len(grid) - 2)
    column = np.arange(profiles.shape[1])
    before, here, after = profiles[at - 1, column], profiles[at, column], profiles[at + 1, column]
    bend = before - 2.0 * here + after
    shift = np.where(bend > 0.0, 0.5 * (before - after) / np.where(bend > 0.0, bend, 1.0), 0.0)
    return np.asarray(grid[at] + np.clip(shift, -1.0, 1.0) * (grid[1] - grid[0]))


def _with_coordinate(problem: Problem, found: Fit, index: int, value: float) -> Fit:
    """The fit with one coordinate put at `value`, the others following by one step; unchanged if it is not a fit."""
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
