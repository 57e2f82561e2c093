"""Whitening of noise, compared with the covariance of the process. Values that are not finite raise an error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz

from tsa_ctrl.identify.diagnosis.noise.autoregressive import Noise

FILTER = np.array([1.0, -0.9, 0.3])
DEVIATION = 0.02


def noise() -> tuple[Noise, np.ndarray]:
    """Return a second-order process and its covariance at 40 lags, computed from its impulse response."""
    response = np.zeros(2000)
    response[0] = 1.0
    for n in range(1, len(response)):
        response[n] = 0.9 * response[n - 1] - (0.3 * response[n - 2] if n > 1 else 0.0)
    covariance = np.array([response[: len(response) - k] @ response[k:] for k in range(40)]) * DEVIATION**2
    return Noise(FILTER, DEVIATION, covariance[:2]), covariance


@pytest.mark.parametrize("columns", [None, 3, 20])
def test_white_samples_have_no_covariance_from_the_first_on(columns: int | None) -> None:
    """Whitened unit vectors form W, and W C W' is the identity matrix."""
    known, covariance = noise()
    white = known.whiten(np.eye(40), [slice(0, 40)])
    np.testing.assert_allclose(white @ toeplitz(covariance) @ white.T, np.eye(40), atol=1e-9)
    y = np.random.default_rng(1).normal(size=(40,) if columns is None else (40, columns))
    np.testing.assert_allclose(known.whiten(y, [slice(0, 40)]), white @ y, atol=1e-9)


def test_runs_are_made_white_each_for_itself() -> None:
    known, _ = noise()
    y = np.random.default_rng(2).normal(size=50)
    both = known.whiten(y, [slice(0, 20), slice(20, 50)])
    np.testing.assert_array_equal(both, np.concatenate([known.whiten(p, [slice(0, len(p))]) for p in (y[:20], y[20:])]))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_ends_a_fit(bad: float) -> None:
    y = np.ones(30)
    y[1] = bad
    with pytest.raises(FloatingPointError):
        noise()[0].whiten(y, [slice(0, 30)])
