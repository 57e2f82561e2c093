"""A least-squares step within bounds, compared with scipy's solution."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from tsa_ctrl.identify.diagnosis.fitting.fit import bounded_step

UNDAMPED = 1e-9


def test_along_a_valley_a_bound_moves_the_other_coordinates_too() -> None:
    """Two columns are nearly equal.

    If one coordinate is only clipped at its bound, the other stays far from its optimum.
    """
    rng = np.random.default_rng(4)
    both = rng.normal(size=200)
    jacobian = np.column_stack([both, both + 0.01 * rng.normal(size=200), rng.normal(size=200)])
    residual = jacobian @ np.array([3.0, -2.5, 0.4]) + 0.01 * rng.normal(size=200)
    low, high = np.array([-1.0, -10.0, -10.0]), np.array([1.0, 10.0, 10.0])
    step = bounded_step(jacobian, residual, low, high, UNDAMPED)
    best = lsq_linear(jacobian, residual, (low, high)).x
    clipped = np.clip(np.linalg.lstsq(jacobian, residual, rcond=None)[0], low, high)
    left = [float(np.sum((residual - jacobian @ each) ** 2)) for each in (step, best, clipped)]
    assert left[0] < 1.001 * left[1]
    assert left[2] > 100.0 * left[0]


def test_no_step_leaves_its_bounds_or_does_worse_than_none() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        jacobian, residual = rng.normal(size=(40, 4)) * rng.uniform(0.1, 10.0, 4), rng.normal(size=40) * 5.0
        low, high = -rng.uniform(0.0, 1.0, 4), rng.uniform(0.0, 1.0, 4)
        step = bounded_step(jacobian, residual, low, high, UNDAMPED)
        assert np.all((step >= low) & (step <= high))
        assert np.sum((residual - jacobian @ step) ** 2) <= np.sum(residual**2) * (1.0 + 1e-9)


def test_without_a_coordinate_there_is_no_step() -> None:
    assert bounded_step(np.zeros((5, 0)), np.ones(5), np.zeros(0), np.zeros(0), UNDAMPED).shape == (0,)
