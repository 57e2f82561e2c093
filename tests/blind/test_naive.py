"""Test that the baseline strategies find a clear effect, and that they report effects in logs without one."""

from __future__ import annotations

import tomllib
from collections.abc import Callable

import numpy as np
import pytest

from . import case
from .cases import Case
from .naive import Bank, best_validation, feature_bank, forward_bic, lasso, thresholded

Strategy = Callable[[Bank], list[int]]
COMPILED = pytest.mark.soak  # takes half a second, but eight seconds with compilation in a new clone


def bank(seed: int, signal: float) -> Bank:
    """Return a bank of twelve random features. The residual contains two of them and white noise of RMS 1."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((3000, 12))
    residual = signal * (columns[:, 3] - 0.7 * columns[:, 7]) + rng.standard_normal(3000)
    return Bank(columns, tuple(f"f{k}" for k in range(12)), residual)


@pytest.mark.parametrize("strategy", [forward_bic, best_validation, pytest.param(lasso, marks=COMPILED), thresholded])
def test_finds_the_features_that_carry_the_signal(strategy: Strategy) -> None:
    assert {3, 7} <= set(strategy(bank(0, 2.0)))


@pytest.mark.parametrize("strategy", [forward_bic, thresholded])
def test_keeps_nothing_of_white_noise(strategy: Strategy) -> None:
    """For white noise, as they assume, both strategies report no feature. Measured noise is not white."""
    assert strategy(bank(1, 0.0)) == []


@COMPILED
def test_lasso_path_solves_the_normal_equations_without_penalty() -> None:
    from .naive import _descend

    data = bank(2, 1.0)
    gram = data.columns.T @ data.columns / 3000
    moment = data.columns.T @ data.residual / 3000
    beta = _descend(gram, moment, np.array([1e-9]))[0]
    np.testing.assert_allclose(beta, np.linalg.solve(gram, moment), atol=1e-4)


def named_by_bic(drawn: Case) -> set[str]:
    bank = feature_bank(drawn.logs, tomllib.loads(drawn.model))
    return {bank.names[k] for k in forward_bic(bank)}


def test_bic_names_the_hidden_effect_among_others() -> None:
    drawn = case("single", "viscous_friction", 1, short=True)
    assert "viscous_friction" in named_by_bic(drawn)


def test_bic_accuses_logs_without_effect() -> None:
    """BIC reports an effect in at least three of five logs without one.

    BIC assumes white noise, and the noise of the logs is coloured.
    """
    accused = 0
    for seed in range(5):
        drawn = case("none", "rich", seed, short=True)
        accused += bool(named_by_bic(drawn))
    assert accused >= 3
