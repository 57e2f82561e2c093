"""Coverage of intervals when a model error repeats in every pass, on synthetic data."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import t as student

from tsa_ctrl.identify.diagnosis.parameters.refit import ANGLES, VELOCITIES, states, widened

Array = NDArray[np.float64]
RATE, CYCLES = 125.0, 16
T = np.arange(0.0, 2.0 * CYCLES, 1.0 / RATE)
Q, OMEGA = (
    0.5 * np.sin(np.pi * T) + 0.2 * np.sin(3.0 * np.pi * T + 0.4),
    np.gradient(0.5 * np.sin(np.pi * T) + 0.2 * np.sin(3.0 * np.pi * T + 0.4), T),
)
SPRING, FRICTION, DRAG, NOISE = 1.3, 0.4, 0.1, 0.05


def not_in_the_model(rng: np.random.Generator) -> Array:
    """Return a random function of angle and direction that is the same in each pass, (n,) in N*m."""
    waves = np.arange(2, 9)[:, None]
    phases, sizes = rng.uniform(0.0, 6.28, (2, 7, 1)), rng.normal(0.0, 0.1, (2, 7, 1))
    ways = [np.sum(sizes[way] * np.sin(waves * 2.0 * Q + phases[way]), axis=0) for way in (0, 1)]
    return np.where(OMEGA > 0.0, *ways)


def fitted(torque: Array) -> tuple[Array, Array, Array, Array]:
    """Return the least-squares fit of a torque (n,).

    Returns:
        spring, friction and drag (3,)
        their covariance under white noise (3, 3)
        the influence of each sample (n, 3)
        the residual (n,)
    """
    columns = np.column_stack([Q, np.sign(OMEGA), OMEGA])
    influence = np.linalg.pinv(columns).T
    found = influence.T @ torque
    residual = torque - columns @ found
    return found, influence.T @ influence * np.mean(residual**2), influence, residual


def shares_held(seeds: int) -> tuple[float, float]:
    """Return the coverage of the 95 % intervals of spring, friction and drag, with and without widening.

    Intervals without widening follow from the noise alone.
    """
    truth, cells, factor = np.array([SPRING, FRICTION, DRAG]), states(OMEGA, Q), student(12).ppf(0.975)
    inside, before = [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        torque = np.column_stack([Q, np.sign(OMEGA), OMEGA]) @ truth + rng.normal(0.0, NOISE, T.size)
        found, covariance, influence, residual = fitted(torque + not_in_the_model(rng))
        wider = widened(covariance, influence, residual, cells)
        inside.append(np.abs(found - truth) < factor * np.sqrt(np.diag(wider)))
        before.append(np.abs(found - truth) < factor * np.sqrt(np.diag(covariance)))
    return float(np.mean(inside)), float(np.mean(before))


def test_an_interval_holds_the_truth_beside_an_error_that_each_pass_repeats() -> None:
    widened_ones, before = shares_held(100)
    assert widened_ones > 0.9
    assert before < 0.3


def test_noise_alone_widens_little() -> None:
    cells, wider = states(OMEGA, Q), []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        _, covariance, influence, residual = fitted(SPRING * Q + rng.normal(0.0, NOISE, T.size))
        wider.append(np.sqrt(np.diag(widened(covariance, influence, residual, cells)) / np.diag(covariance)))
    assert 1.0 <= np.mean(wider) < 1.35


def test_a_sum_that_is_known_stays_known_while_its_parts_trade_places() -> None:
    """Two columns differ very little.

    Each coefficient is uncertain, but their sum is not, and a repeated error does not change it.
    """
    rng = np.random.default_rng(1)
    columns = np.column_stack([Q, Q + 1e-4 * rng.normal(size=T.size)])
    influence = np.linalg.pinv(columns).T
    residual = not_in_the_model(rng) * 0.1
    residual = residual - columns @ (influence.T @ residual)
    covariance = widened(influence.T @ influence * np.mean(residual**2), influence, residual, states(OMEGA, Q))
    both = np.array([1.0, 1.0])
    assert np.sqrt(both @ covariance @ both) < 1e-2 * np.sqrt(covariance[0, 0])


def test_states_are_as_many_cells_with_as_many_samples() -> None:
    cells = states(OMEGA, Q)
    counts = np.bincount(cells)
    assert len(counts) <= VELOCITIES * ANGLES
    assert counts.max() < 4 * T.size / (VELOCITIES * ANGLES)
    one_way = [np.unique(np.sign(OMEGA[cells == cell])).size for cell in range(len(counts))]
    assert np.mean(np.array(one_way) == 1) > 0.7


@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_units_of_a_coordinate_change_nothing(scale: float) -> None:
    _, covariance, influence, residual = fitted(not_in_the_model(np.random.default_rng(3)))
    units = np.array([1.0, scale, 1.0])
    told = widened(covariance, influence, residual, states(OMEGA, Q))
    other = widened(covariance * np.outer(units, units), influence * units, residual, states(OMEGA, Q))
    assert other == pytest.approx(told * np.outer(units, units), rel=1e-6)
