"""Fit a hypothesis to whitened residuals by a bounded Gauss-Newton method (Levenberg-Marquardt)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.diagnosis.fitting.problem import Hypothesis, Problem
from tsa_ctrl.model.functions import Array

ITERATIONS = 12  # most Gauss-Newton iterations; the fit ends earlier if a step gains less than ENOUGH
ENOUGH = 0.05  # decrease of the sum of squares (white units): a twentieth of what one coordinate gains on noise
TRIES = 5  # damping values tried in one iteration: a factor of 1e5 from a Newton step to hardly any step


@dataclass(frozen=True)
class Fit:
    """The optimum of a hypothesis.

    `residual` (m,) is white. `jacobian` (m, free) has the derivatives of the prediction with respect to the coordinates
    that no bound holds, which are True in `free`.
    """

    hypothesis: Hypothesis
    point: Array
    residual: Array
    jacobian: Array
    free: NDArray[np.bool_]
    rss: float

    @property
    def names(self) -> tuple[str, ...]:
        return self.hypothesis.names


def fit(problem: Problem, hypothesis: Hypothesis, start: Array, iterations: int = ITERATIONS) -> Fit:
    """Return the fit that minimises the sum of squares of the whitened residual within the bounds, from `start`."""
    point = np.clip(start, hypothesis.low, hypothesis.high)
    residual = problem.measured - problem.whiten(problem.predicted(hypothesis.model(point)))
    rss = float(residual @ residual)
    damping = 1e-4
    jacobian = _jacobian(problem, hypothesis, point, residual)
    for _ in range(iterations):
        if len(point) == 0:
            break
        improved = False
        small = False  # True if the last step gained too little for another one
        nonsmooth = hypothesis.nonsmooth
        for attempt in range(2 * TRIES if nonsmooth.any() else TRIES):
            if attempt == TRIES:  # a gradient is not reliable along some coordinates, so try without them
                damping = 1e-4
            used = jacobian if attempt < TRIES else np.where(nonsmooth, 0.0, jacobian)
            step = bounded_step(used, residual, hypothesis.low - point, hypothesis.high - point, damping)
            trial = np.clip(point + step, hypothesis.low, hypothesis.high)
            change = trial - point
            expected = rss - float(np.sum((residual - jacobian @ change) ** 2))
            if expected < ENOUGH:
                small = True
                damping = max(damping * 30.0, 1e-3)
                continue
            predicted = problem.predicted(hypothesis.model(trial))
            found = residual
            reached = np.inf
            if np.all(np.isfinite(predicted)):
                found = problem.measured - problem.whiten(predicted)
                reached = float(found @ found)
            if reached < rss:
                small = rss - reached < ENOUGH
                improved = True
                damping = max(damping * 0.2, 1e-7)
                point, residual, rss = trial, found, reached
                break
            damping = max(damping * 10.0, 1e-4)
        if not improved:
            break
        jacobian = _jacobian(problem, hypothesis, point, residual)
        if small:
            break
    gradient = jacobian.T @ residual if len(point) else np.zeros(0)
    free = ~((point <= hypothesis.low) & (gradient < 0.0)) & ~((point >= hypothesis.high) & (gradient > 0.0))
    return Fit(hypothesis, point, residual, jacobian[:, free], free, rss)


def _jacobian(problem: Problem, hypothesis: Hypothesis, point: Array, residual: Array) -> Array:
    """Return d prediction / d coordinates (m, k), white, by one-sided differences that stay within the bounds."""
    if len(point) == 0:
        return np.zeros((problem.count, 0))
    steps, improved = [], []
    for i, step in enumerate(hypothesis.steps):
        there = point.copy()
        there[i] += step if point[i] + step <= hypothesis.high[i] else -step
        steps.append(there[i] - point[i])
        improved.append(problem.predicted(hypothesis.model(there)))
    columns = problem.whiten(np.column_stack(improved)) - (problem.measured - residual)[:, None]
    return np.asarray(columns / np.array(steps))


def gradients(problem: Problem, fitted: Fit) -> Array:
    """Return d prediction / d coordinates at the optimum (m, k), white, including coordinates that a bound holds."""
    return _jacobian(problem, fitted.hypothesis, fitted.point, fitted.residual)


def bounded_step(jacobian: Array, residual: Array, low: Array, high: Array, damping: float) -> Array:
    """Return the damped least-squares step (k,) within `low` .. `high` for a jacobian (m, k) and a residual (m,).

    The coordinate that exceeds its bounds most is held at its bound, and the others are solved again.
    """
    count = len(low)
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
    gram = (jacobian / scale).T @ (jacobian / scale)
    slope = (jacobian / scale).T @ residual
    step = np.zeros(count)
    free = np.ones(count, dtype=np.bool_)
    for _ in range(count + 1):
        index = np.flatnonzero(free)
        if index.size == 0:
            break
        fixed = np.flatnonzero(~free)
        right = slope[index] - gram[np.ix_(index, fixed)] @ (step[fixed] * scale[fixed])
        matrix = gram[np.ix_(index, index)] + damping * np.eye(index.size)
        step[index] = np.linalg.solve(matrix, right) / scale[index]
        beyond = np.where(free, np.maximum(low - step, step - high), 0.0) * scale
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 0.0:
            break
        step[worst] = np.clip(step[worst], low[worst], high[worst])
        free[worst] = False
    return step


def fit_or_none(problem: Problem, hypothesis: Hypothesis, start: Array) -> Fit | None:
    """Return `fit`, or None if the effects exclude each other or the model cannot be computed."""
    try:
        return fit(problem, hypothesis, start)
    except (UsageError, np.linalg.LinAlgError, FloatingPointError):
        return None
