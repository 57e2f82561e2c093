"""Linear estimation with noise on both axes and coloured errors: lagged instruments and a block jackknife.

Ordinary least squares of tau_J on tau_M is biased when tau_M is noisy (the slope shrinks), and its textbook intervals
are wrong when the errors are coloured. Here the instrument of tau_M is the mean of tau_M a lag earlier and a lag later,
beyond the correlation time of the noise: the noise drops out, the (slow) signal stays. Intervals come from the scatter
of whole blocks of time, each block's residuals scaled by (1 - leverage)^(-1/2), with Student's t at as many degrees of
freedom as that variance has (CR2: Bell and McCaffrey 2002; Imbens and Kolesar 2016). Leaving blocks out (CR3) scales by
(1 - leverage)^(-1), too much where few blocks decide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from tsa_ctrl.identify.quantity import LEVEL, half_width

FloatArray = NDArray[np.float64]

# t of 17 degrees of freedom is within 8 % of the normal one, and a block of a short log is still longer than its noise
BLOCKS = 18
MAX_LAG_LOSS = 0.10  # the instrument may lose so much of the correlation with its signal
ALONE = 1e-6  # 1 - leverage, below which a block alone determines a combination: rounding of a sum of thousands
MOST_FREEDOM = 1e6  # Student's t is then the normal distribution
NOISE_CORRELATION = 0.05  # the lag at which the noise's autocorrelation has died out


@dataclass(frozen=True)
class Estimate:
    """Coefficients (k), their covariance (k, k) from B blocks of time, and the basis of its own uncertainty.

    With k-vectors of scores, `influence` (B, k, k) takes the residuals' score of a block to its share of the error of
    `value`, `leverage` (B, k, k) is the part of a block's score that the fit took up, `weight` (B, k, k) what white
    errors of variance 1 would make the covariance of each block's true score. `of_prior` (k, k) is the part of the
    covariance that a prior contributes; its variance is known.
    """

    value: FloatArray
    covariance: FloatArray
    influence: FloatArray
    leverage: FloatArray
    weight: FloatArray
    of_prior: FloatArray | None = None

    def interval(self, index: int, level: float = LEVEL) -> tuple[float, float]:
        """Two-sided interval of one coefficient."""
        return self.interval_of(np.eye(self.value.size)[index], level)

    def interval_of(self, gradient: FloatArray, level: float = LEVEL) -> tuple[float, float]:
        """Interval of `gradient @ value` (delta method for a function with that gradient)."""
        centre = float(gradient @ self.value)
        deviation = float(np.sqrt(gradient @ self.covariance @ gradient))
        half = half_width(self.degrees_of_freedom(gradient), level) * deviation
        return centre - half, centre + half

    def degrees_of_freedom(self, gradient: FloatArray) -> float:
        """Return the degrees of freedom of the variance of `gradient @ value` (Satterthwaite): few where it rests on
        few blocks.
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


def block_labels(lengths: list[int], blocks: int = BLOCKS) -> list[NDArray[np.int64]]:
    """Labels of contiguous blocks of about equal length over several logs; a log is never joined with another."""
    total = sum(lengths)
    labels, first = [], 0
    for n in lengths:
        count = max(1, round(blocks * n / total)) if len(lengths) < blocks else 1
        labels.append(first + (np.arange(n, dtype=np.int64) * count) // max(1, n))
        first += count
    return labels


def lagged(signal: FloatArray, lag: int) -> FloatArray:
    """Mean of a signal `lag` samples earlier and later (edges use the one that exists)."""
    if lag == 0:
        return signal
    n = signal.size
    before = signal[np.maximum(np.arange(n) - lag, 0)]
    after = signal[np.minimum(np.arange(n) + lag, n - 1)]
    before[:lag] = after[:lag]
    after[n - lag :] = before[n - lag :]
    return 0.5 * (before + after)


def choose_lag(signals: list[FloatArray], residuals: list[FloatArray], limit: int) -> int:
    """The shortest lag at which the residual's fast part (against a mean over 4 `limit`) is uncorrelated.

    `limit` in samples bounds it; a signal that would lose too much of itself at that lag shortens it.
    """
    lag = 0
    for signal, residual in zip(signals, residuals, strict=True):
        own = _correlation_lag(residual, limit)
        while own > 1 and _loss(signal, own) > MAX_LAG_LOSS:
            own = own * 3 // 4
        lag = max(lag, own)
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
    """Share of the correlation with itself that a signal loses at a lag; noise, which is to be lost, is averaged."""
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
    """Knowledge of the coefficients before the data: `value` (k) and `precision` (k), 1/variance, 0 without any."""

    value: FloatArray
    precision: FloatArray


def solve(
    regressors: FloatArray,
    instruments: FloatArray,
    target: FloatArray,
    labels: NDArray[np.int64],
    prior: Prior | None = None,
) -> Estimate:
    """Just-identified instrumental variables with a covariance from blocks of time.

    `regressors`, `instruments` (n, k), `target` (n), `labels` (n) block numbers. A prior counts as one more observation
    of each coefficient; its weight against the samples follows from the scatter of whole blocks. Raises
    numpy.linalg.LinAlgError when the data do not determine the coefficients.
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
    """Inverse square roots (B, k, k); a direction that a block alone determines (a root of 0) has no residual."""
    values, vectors = np.linalg.eig(matrices)
    alone = values.real < ALONE
    roots = np.where(alone, 0.0, 1.0 / np.sqrt(np.where(alone, 1.0, values.astype(np.complex128))))
    product = (vectors * roots[:, None, :]) @ np.linalg.inv(vectors)
    return np.ascontiguousarray(product.real)
