"""Regressions from the signals of a log to its torque, without knowledge of causes.

All take columns (n, k) and a torque (n,) in N*m of the samples that may be learned from, and predict it for others.
None was chosen for a set: the settings are the libraries' own, or stand here with their reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Predict = Callable[[Array], Array]

MOST_SAMPLES = (
    20_000  # learned from, evenly spaced: neighbours at 1 kHz tell the same, and trees need seconds per 10,000
)
LAYERS = (32, 32)  # of the network: a few thousand weights, the size of the published ones for single joints
THRESHOLDS = (0.01, 0.02, 0.05, 0.1, 0.2)  # of the torque's RMS, below which a term is dropped; by cross-validation
ROUNDS = 10  # of dropping and fitting anew, as in Brunton, Proctor, Kutz, PNAS 2016
FOLDS = 5  # contiguous, to choose a threshold


def least_squares(columns: Array, torque: Array) -> Predict:
    """A straight line in the columns."""
    factors = np.linalg.lstsq(columns, torque, rcond=None)[0]
    return lambda other: np.asarray(other @ factors)


def boosted_trees(columns: Array, torque: Array) -> Predict:
    """scikit-learn's histogram gradient boosting as it comes."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    model = HistGradientBoostingRegressor(random_state=0).fit(*_thinned(columns, torque))
    return lambda other: np.asarray(model.predict(other))


def small_network(columns: Array, torque: Array) -> Predict:
    """scikit-learn's perceptron with two layers, on scaled signals, stopped by samples that it keeps back."""
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    x, y = _thinned(columns, torque)
    middle, size = float(np.mean(y)), max(float(np.std(y)), 1e-12)
    network = MLPRegressor(hidden_layer_sizes=LAYERS, early_stopping=True, max_iter=500, random_state=0)
    model = make_pipeline(StandardScaler(), network).fit(x, (y - middle) / size)
    return lambda other: np.asarray(middle + size * model.predict(other))


def sparse_regression(columns: Array, torque: Array) -> Predict:
    """Products of up to two signals and of their absolute values; small terms dropped again and again (SINDy)."""
    low, high = columns.min(axis=0), columns.max(axis=0)
    size = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    terms = library(np.clip(columns, low, high) / size)
    thinned, y = _thinned(terms, torque)
    level = float(np.sqrt(np.mean(y**2)))
    parts = np.arange(len(y)) * FOLDS // len(y)
    errors = []
    for share in THRESHOLDS:
        left = 0.0
        for part in range(FOLDS):
            factors = thresholded(thinned[parts != part], y[parts != part], share * level)
            left += float(np.sum((y[parts == part] - thinned[parts == part] @ factors) ** 2))
        errors.append(left)
    factors = thresholded(thinned, y, THRESHOLDS[int(np.argmin(errors))] * level)
    return lambda other: np.asarray(library(np.clip(other, low, high) / size) @ factors)


def library(signals: Array) -> Array:
    """1, the signals, their absolute values, and products of two of all these, (n, terms)."""
    plain = [*signals.T, *(np.abs(column) for column in signals.T)]
    products = [a * b for a, b in combinations_with_replacement(plain, 2)]
    return np.column_stack([np.ones(len(signals)), *plain, *products])


def thresholded(terms: Array, torque: Array, least: float) -> Array:
    """Least squares in which terms whose part of the torque is below `least` (N*m, RMS) are dropped, (terms,)."""
    sizes = np.sqrt(np.mean(terms**2, axis=0))
    kept = np.zeros(len(sizes), dtype=np.bool_)
    kept[np.unique(terms, axis=1, return_index=True)[1]] = True  # twins would share what is theirs, each below `least`
    kept &= sizes > 0.0
    factors = np.zeros(terms.shape[1])
    for _ in range(ROUNDS):
        factors[:] = 0.0
        factors[kept] = np.linalg.lstsq(terms[:, kept], torque, rcond=None)[0]
        small = kept & (np.abs(factors) * sizes < least)
        if not small.any():
            break
        kept &= ~small
    return factors


METHODS: Mapping[str, Callable[[Array, Array], Predict]] = {
    "boosted trees": boosted_trees,
    "small network": small_network,
    "sparse regression": sparse_regression,
}


def _thinned(columns: Array, torque: Array) -> tuple[Array, Array]:
    step = max(1, -(-len(torque) // MOST_SAMPLES))
    return columns[::step], torque[::step]


def error(predict: Predict, columns: Array, torque: Array) -> float:
    """RMS, N*m."""
    return float(np.sqrt(np.mean((torque - predict(columns)) ** 2)))


def best_by_blocks(candidates: Sequence[Array], torque: Array) -> int:
    """Number of the columns whose least squares leaves least on contiguous parts that it was not fitted on."""
    parts = np.arange(len(torque)) * FOLDS // len(torque)
    left = [
        sum(
            error(
                least_squares(columns[parts != part], torque[parts != part]),
                columns[parts == part],
                torque[parts == part],
            )
            ** 2
            for part in range(FOLDS)
        )
        for columns in candidates
    ]
    return int(np.argmin(left))
