"""Estimate linear models with noise on both axes and coloured errors, by lagged instruments and blocks of time.

Ordinary least squares of tau_J on tau_M is biased if tau_M is noisy (the slope becomes too small), and its standard
intervals are wrong if the errors are coloured. Here the instrument of tau_M is the mean of tau_M one lag earlier and
one lag later. The lag exceeds the correlation time of the noise, so the noise cancels and the (slow) signal remains.
Intervals follow from the scatter of whole blocks of time. The residuals of each block are scaled by
(1 - leverage)^(-1/2). The interval uses Student's t with the degrees of freedom of that variance (CR2: Bell and
McCaffrey 2002; Imbens and Kolesar 2016). A jackknife over blocks (CR3) would scale by (1 - leverage)^(-1), which is too
much if a result depends on few blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from tsa_ctrl.identify.quantity import half_width

FloatArray = NDArray[np.float64]

# With 17 degrees of freedom t is within 8 % of the normal quantile, and a block of a short log is still longer than the
# correlation time of its noise
BLOCKS = 18
MAX_LAG_LOSS = 0.10  # largest permitted loss of correlation between the instrument and its signal
ALONE = 1e-6  # below this 1 - leverage, one block alone determines a combination: it is rounding of a long sum
MOST_FREEDOM = 1e6  # upper limit, at which Student's t equals the normal distribution
NOISE_CORRELATION = 0.05  # autocorrelation of the noise below which it counts as uncorrelated


@dataclass(frozen=True)
class Estimate:
    """Coefficients (k), their covariance (k, k) from B blocks of time, and the data for its degrees of freedom.

    A score is a k-vector of one block. `influence` (B, k, k) maps the score of a block's residuals to its contribution
    to the error of `value`. `leverage` (B, k, k) is the part of a block's score that the fit absorbs. `weight`
    (B, k, k) is the covariance of each block's true score for white errors of variance 1. `of_prior` (k, k) is the part
    of the covariance that a prior contributes; its variance is known.
    """

    value: FloatArray
    covariance: FloatArray
    influence: FloatArray
    leverage: FloatArray
    weight: FloatArray
    of_prior: FloatArray | None = None

    def interval(self, index: int) -> tuple[float, float]:
        """Return the two-sided interval of one coefficient."""
        return self.interval_of(np.eye(self.value.size)[index])

    def interval_of(self, gradient: FloatArray) -> tuple[float, float]:
        """Return the interval of `gradient @ value` (delta method for a function with that gradient)."""
        centre = float(gradient @ self.value)
        deviation = float(np.sqrt(gradient @ self.covariance @ gradient))
        half = half_width(self.degrees_of_freedom(gradient)) * deviation
        return centre - half, centre + half

    def degrees_of_freedom(self, gradient: FloatArray) -> float:
        """Return the degrees of freedom of the variance of `gradient @ value` (Satterthwaite).

        They are few if the variance depends on few blocks.
        """
        b = self.influence.transpose(0, 2, 1) @ gradient
        taken = np.einsum("bji,bj->bi", self.leverage, b)
        own = np.einsum("bij,bj->bi", self.weight, b)
        cross = own @ taken.T
        joint = np.diag(np.sum(b * own, axis=1)) - cross - cross.T + taken @ self.weight.sum(axis=0) @ taken.T
        squares = float(np.sum(np.square(joint)))
        if not squares > 0.0:  # the data contribute nothing
            return MOST_FREEDOM
        freedom = max(1.0, float(np.trace(joint) ** 2) / squares)
        if self.of_prior is not None:
            whole, known = (float(gradient @ each @ gradient) for each in (self.covariance, self.of_prior))
            freedom *= (whole / max(whole - known, 1e-9 * whole)) ** 2
        return min(freedom, MOST_FREEDOM)


def block_labels(lengths: list[int]) -> list[NDArray[np.int64]]:
    """Return the labels of contiguous blocks over several logs, (n,) for each log; no block contains two logs.

    With fewer logs than `BLOCKS` the blocks have about equal length; otherwise each log is one block.
    """
    total = sum(lengths)
    labels, first = [], 0
    for n in lengths:
        count = max(1, round(BLOCKS * n / total)) if len(lengths) < BLOCKS else 1
        labels.append(first + (np.arange(n, dtype=np.int64) * count) // max(1, n))
        first += count
    return labels


def lagged(signal: FloatArray, lag: int) -> FloatArray:
    """Return the mean of the signal `lag` samples earlier and later; near an end, only one of them exists."""
    if lag == 0:
        return signal
    n = signal.size
    before = signal[np.maximum(np.arange(n) - lag, 0)]
    after = signal[np.minimum(np.arange(n) + lag, n - 1)]
    before[:lag] = after[:lag]
    after[n - lag :] = before[n - lag :]
    return 0.5 * (before + after)


def choose_lag(signal: FloatArray, residual: FloatArray, limit: int) -> int:
    """Return the shortest lag at which the fast part of the residual is uncorrelated, in samples, at most `limit`.

    The fast part is the residual minus its moving mean over 4 `limit` samples. The lag is shortened if the signal would
    lose more than `MAX_LAG_LOSS` of its correlation at that lag.
    """
    lag = _correlation_lag(residual, limit)
    while lag > 1 and _loss(signal, lag) > MAX_LAG_LOSS:
        lag = lag * 3 // 4
    return lag


def _correlation_lag(residual: FloatArray, limit: int) -> int:
    from scipy.ndimage import uniform_filter1d  # slow to import

    window = min(4 * limit, residual.size)
    fast = residual - uniform_filter1d(residual, window, mode="nearest")
    spectrum = np.abs(np.fft.rfft(fast, next_fast_len(2 * fast.size, real=True))) ** 2
    correlation = np.fft.irfft(spectrum)[: limit + 1]
    if correlation[0] <= 0.0:
        return 1
    dead = np.flatnonzero(correlation < NOISE_CORRELATION * correlation[0])
    return int(dead[0]) if dead.size else limit


def _loss(signal: FloatArray, lag: int) -> float:
    """Return 1 minus the autocorrelation of a signal at a lag, after a moving average has reduced its noise."""
    if 4 * lag >= signal.size:
        return 1.0
    from scipy.ndimage import uniform_filter1d  # slow to import

    signal = uniform_filter1d(signal, lag, mode="nearest")
    a, b = signal - signal.mean(), lagged(signal, lag)
    b = b - b.mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return 1.0 - float(a @ b) / scale if scale > 0.0 else 1.0


@dataclass(frozen=True)
class Prior:
    """Prior knowledge of the coefficients: `value` (k) and `precision` (k), which is 1/variance, or 0 without any."""

    value: FloatArray
    precision: FloatArray


def solve(
    regressors: FloatArray,
    instruments: FloatArray,
    target: FloatArray,
    labels: NDArray[np.int64],
    prior: Prior | None = None,
) -> Estimate:
    """Return the estimate by just-identified instrumental variables, with a covariance from blocks of time.

    Args:
        regressors, instruments: (n, k) each.
        target: (n,).
        labels: block numbers, (n,).
        prior: one more observation of each coefficient. Its weight relative to the samples follows from the scatter of
            whole blocks.

    Raises:
        numpy.linalg.LinAlgError: the data do not determine the coefficients.
    """
    order = np.argsort(labels, kind="stable")
    starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
    x, z, y = regressors[order], instruments[order], target[order]
    zx = np.add.reduceat(z[:, :, None] * x[:, None, :], starts, axis=0)
    zy = np.add.reduceat(z * y[:, None], starts, axis=0)
    whole, right, of_prior = zx.sum(axis=0), zy.sum(axis=0), np.zeros_like(zx[0])
    if prior is not None:
        white = np.linalg.lstsq(whole, right, rcond=None)[0]
        scores = zy - zx @ white
        size = np.sum(np.square(z), axis=0)
        variance = float(np.median(np.sum(np.square(scores), axis=0)[size > 0.0] / size[size > 0.0]))
        weight_of_prior = variance * prior.precision
        whole, right = whole + np.diag(weight_of_prior), right + weight_of_prior * prior.value
        of_prior = np.diag(variance * weight_of_prior)
    inverse = np.linalg.inv(whole)
    value = inverse @ right
    leverage = zx @ inverse
    influence = inverse @ _inverse_root(np.eye(value.size) - leverage)
    errors = np.einsum("bij,bj->bi", influence, zy - zx @ value)
    weight = np.add.reduceat(z[:, :, None] * z[:, None, :], starts, axis=0)
    of_prior = inverse @ of_prior @ inverse.T
    return Estimate(value, errors.T @ errors + of_prior, influence, leverage, weight, of_prior)


def _inverse_root(matrices: FloatArray) -> FloatArray:
    """Return the inverse square roots (B, k, k) of matrices; an eigenvalue of 0 is replaced by 0.

    A direction with an eigenvalue of 0 is determined by one block alone and has no residual.
    """
    values, vectors = np.linalg.eig(matrices)
    alone = values.real < ALONE
    roots = np.where(alone, 0.0, 1.0 / np.sqrt(np.where(alone, 1.0, values.astype(np.complex128))))
    product = (vectors * roots[:, None, :]) @ np.linalg.inv(vectors)
    return np.ascontiguousarray(product.real)
