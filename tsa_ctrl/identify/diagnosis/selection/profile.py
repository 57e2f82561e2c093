"""The exact profile of one nonlinear coordinate: the sum of squares along it, everything else solved for linearly.

Play, presliding, delays and lags have no amplitude, and their sum of squares is neither smooth nor convex in their one
coordinate; so it is searched, not descended.
"""

from __future__ import annotations

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import Response, Score
from tsa_ctrl.model.functions import Array

SHRINK = 0.5 * (np.sqrt(5.0) - 1.0)  # golden section
STEPS = 9


def refined(problem: Problem, fitted: Fit, score: Score, found: list[Response]) -> Score:
    """`score` moved to the best value between its neighbours on the grid; unchanged for other kinds of variants."""
    variant = score.variant
    if variant.amplitude or len(variant.coordinates) != 1:
        return score
    basis = orthonormal(fitted.jacobian)
    residual = fitted.residual - basis @ (basis.T @ fitted.residual)
    present = problem.predicted(fitted.hypothesis.model(fitted.point))
    hypothesis = fitted.hypothesis.plus(variant)

    def gain(u: float) -> tuple[float, Array]:
        model = hypothesis.model(np.concatenate([fitted.point, [u]]))
        column = problem.whiten(problem.predicted(model) - present)
        column -= basis @ (basis.T @ column)
        return float(2.0 * column @ residual - column @ column), column

    grid = sorted({float(r.start[0]) for r in found if r.variant is variant} | {float(score.start[0])})
    at = grid.index(float(score.start[0]))
    coordinate = variant.coordinates[0]
    low = grid[at - 1] if at else coordinate.low
    high = grid[at + 1] if at + 1 < len(grid) else min(coordinate.high, 2.0 * grid[at] - low)
    best, (most, column) = float(score.start[0]), gain(float(score.start[0]))
    a, b = high - SHRINK * (high - low), low + SHRINK * (high - low)
    at_a, at_b = gain(a), gain(b)
    for _ in range(STEPS):
        for u, (value, response) in ((a, at_a), (b, at_b)):
            if value > most:
                best, most, column = u, value, response
        if at_a[0] > at_b[0]:
            high, b, at_b = b, a, at_a
            a = high - SHRINK * (high - low)
            at_a = gain(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + SHRINK * (high - low)
            at_b = gain(b)
    return Score(variant, np.array([best]), most, column[:, None], most)
