"""Model the noise of the torque: its spectrum, and the autoregressive filter that whitens it.

Noise of drives and sensors is coloured. A fit removes a part of it from the residual, so the spectrum is corrected by
the share that the fitted columns span at each frequency. Every test and interval of the diagnosis assumes white
residuals. With residuals that are not white, 95 % intervals contain the true value in only 27-59 % of cases.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft
from scipy.linalg import cholesky, solve_toeplitz, toeplitz
from scipy.linalg.lapack import dtrtrs

from tsa_ctrl.identify.three_errors import CONTINUED
from tsa_ctrl.model.functions import Array

# s, length of the longest whitening filter: slower noise is drift, for which there is a separate test
# (residual.changes)
MEMORY = 1.0
MOST_LAGS = 120  # about MEMORY at the usual score rate (prepare.SCORE_RATE)
BAND = 1.22  # ratio of the edges of one band of the smoothed spectrum: three and a half bands to an octave
FLOOR = 0.04  # share of the mean density: lower bound of a band's density, which limits the weight of a quiet band
FEWEST_WAVES = 5.0  # degrees of freedom (pairs) that one band must keep: its level then has an error of 45 %
# Hz, band whose slope is extrapolated downwards: a log has too few periods below it, and joints shake above it
REFERENCE = (0.7, 5.0)
LOWEST = 0.15  # Hz, below which the density is flat: a log of seconds contains only a part of a slower wave
FEW_COLUMNS = 4  # number of columns below which direct sums over a hundred taps are faster than Fourier transforms
TOGETHER = 8  # columns transformed at a time, so that the buffers fit into the cache


@dataclass(frozen=True)
class Noise:
    """Autoregressive noise: e_t = -sum a_k e_(t-k) + deviation * white; `filter` is (1, a_1, ...), shape (p + 1,)."""

    filter: Array
    deviation: float  # N*m, standard deviation of the innovations
    covariance: Array  # (p,), of the noise itself at lags 0 .. p - 1, (N*m)^2

    @property
    def rms(self) -> float:
        """Return the RMS of the noise at the score rate, N*m."""
        return float(np.sqrt(self.covariance[0]))

    def whiten(self, y: Array, slices: Sequence[slice]) -> Array:
        """Return stacked noise `y`, (n,) or (n, k), filtered to white noise of unit variance, each run separately."""
        out = np.empty_like(y)
        lags = len(self.filter) - 1
        for part in slices:
            piece = y[part]
            out[part] = _filtered(self.filter, piece) / self.deviation
            head = min(lags, len(piece))
            if head:
                out[part.start : part.start + head] = _solved(self._factor(head), piece[:head])
        return out

    def _factor(self, size: int) -> Array:
        """Return the Cholesky factor of the covariance of the first `size` samples of a run, (size, size)."""
        known = self._factors.get(size)
        if known is None:
            known = self._factors[size] = cholesky(toeplitz(self.covariance[:size]), lower=True)
        return known

    @cached_property
    def _factors(self) -> dict[int, Array]:
        """Return the cache of Cholesky factors by size; all runs longer than the filter share one size."""
        return {}

    def whiten_short(self, start: int, values: Array, part: slice) -> tuple[int, Array]:
        """Return the start and the values of the whitened column for a short column within one run.

        The column is `values` from stacked sample `start` on, and 0 elsewhere.
        """
        lags = len(self.filter) - 1
        stop = min(start + len(values) + lags, part.stop)
        begin = start if start - part.start >= lags else part.start
        piece = np.zeros(stop - begin)
        piece[start - begin : start - begin + len(values)] = values
        if begin == part.start:
            return begin, self.whiten(piece, [slice(0, len(piece))])
        return begin, _filtered(self.filter, piece) / self.deviation

    def spread(self, columns: Array, slices: Sequence[slice]) -> Array:
        """Return the covariance (k, k) of the products of stacked columns (n, k) with this noise, (N*m)^2."""
        total = np.zeros((columns.shape[1], columns.shape[1]))
        for part in slices:
            length = 1 << int(np.ceil(np.log2(2 * (part.stop - part.start))))
            density = _density(self, np.asarray(np.fft.rfftfreq(length), dtype=np.float64))
            weight = np.where(np.arange(len(density)) % (length // 2) == 0, 1.0, 2.0) * density / length
            lines = rfft(columns[part], length, axis=0)
            total += np.real((lines.conj() * weight[:, None]).T @ lines)
        return total


def _solved(factor: Array, y: Array) -> Array:
    """Return the solution x of factor x = y for a lower triangular factor, by LAPACK without the checks of scipy.

    Raises:
        FloatingPointError: the solution is not finite; the fit is then abandoned.
    """
    if factor.flags.f_contiguous:
        found = np.asarray(dtrtrs(factor, y, lower=1)[0])
    else:
        found = np.asarray(dtrtrs(factor.T, y, lower=0, trans=1)[0])
    if not np.isfinite(found).all():
        raise FloatingPointError("the residual is not finite")
    return found


def _filtered(taps: Array, y: Array) -> Array:
    """Return the causal convolution along the first axis, cut to the length of `y`."""
    if y.size == 0:
        return y
    if y.ndim == 1:
        return np.asarray(np.convolve(taps, y)[: len(y)])
    if y.shape[1] < FEW_COLUMNS:
        return np.column_stack([_filtered(taps, column) for column in y.T])
    length = next_fast_len(len(y) + len(taps) - 1, real=True)
    response = np.fft.rfft(taps, length)
    rows = np.zeros((TOGETHER, length))  # transposed, which takes two thirds of the time of transforming columns
    filtered = np.empty((y.shape[1], len(y)))
    for start in range(0, y.shape[1], TOGETHER):
        columns = y.T[start : start + TOGETHER]
        rows[: len(columns), : len(y)] = columns
        product = np.fft.rfft(rows[: len(columns)])
        product *= response
        filtered[start : start + TOGETHER] = np.fft.irfft(product, length)[:, : len(y)]
    return filtered.T


def white_noise(deviation: float) -> Noise:
    """Return the noise model of ordinary least squares: white noise of this standard deviation, N*m."""
    return Noise(np.ones(1), deviation, np.array([deviation**2]))


def estimate(
    residual: Array,
    basis: Array,
    mask: NDArray[np.bool_],
    slices: Sequence[slice],
    period: float,
    prior: Noise,
    least: float,
) -> Noise:
    """Estimate the noise from the residual of stacked runs.

    The estimated spectrum of the whitened residual is multiplied by the spectrum of `prior`.

    Args:
        residual: residual whitened with `prior`, after `basis` was projected out, (n,).
        basis: projected columns, whitened and orthonormal over the samples of `mask`, (n, k).
        mask: samples that count, (n,).
        slices: place of each run among the samples.
        period: period of the samples, s.
        prior: noise model with which the residual was whitened.
        least: lower bound of the mean square, (N*m)^2: the rounding of the numbers, in exact data.
    """
    length = 1 << int(np.ceil(np.log2(2 * max(part.stop - part.start for part in slices))))
    frequency = np.asarray(np.fft.rfftfreq(length, period), dtype=np.float64)
    power = np.zeros(len(frequency))
    room = np.zeros(len(frequency))
    for part in slices:
        inside = mask[part].astype(float)
        power += np.abs(np.fft.rfft(inside * residual[part], length)) ** 2
        spread = rfft(inside[:, None] * basis[part], length, axis=0)
        room += float(inside.sum()) - np.sum(spread.real**2 + spread.imag**2, axis=1)
    samples = float(mask.sum())
    room = np.maximum(room, 0.02 * samples)
    waves = room / length  # independent pairs per frequency line after the fit
    ratio = _banded(frequency, power, room, waves)
    density: Array = _continued(frequency, ratio * _density(prior, frequency))
    density = np.maximum(density, max(FLOOR * float(np.mean(density)), least))
    covariance = np.fft.irfft(density)
    return _autoregressive(covariance, samples, period)


def _banded(frequency: Array, power: Array, room: Array, waves: Array) -> Array:
    """Return smoothed power/room on every line, interpolated between means over bands that widen with frequency."""
    centres, values = [], []
    start = 0
    while start < len(frequency):
        stop = start + 1
        pairs = float(waves[start])
        edge = max(frequency[start], frequency[1]) * BAND
        while stop < len(frequency) and (frequency[stop] < edge or pairs < FEWEST_WAVES):
            pairs += float(waves[stop])
            stop += 1
        if len(frequency) - stop < 0.1 * (stop - start):
            stop = len(frequency)
        centres.append(float(np.mean(frequency[start:stop])))
        values.append(float(np.sum(power[start:stop]) / np.sum(room[start:stop])))
        start = stop
    return np.exp(np.interp(frequency, centres, np.log(np.maximum(values, 1e-6 * max(values)))))


def _continued(frequency: Array, density: Array) -> Array:
    """Return the density with its lowest lines raised to at least the extrapolation of its slope above them.

    Slow noise and slow effects are similar, and few periods of either fit into a log. From these lines alone, the noise
    would be underestimated and the significance of effects overestimated.
    """
    band = (frequency > REFERENCE[0]) & (frequency < REFERENCE[1])
    if np.count_nonzero(band) < 4:
        return density
    slope = float(np.polyfit(np.log(frequency[band]), np.log(density[band]), 1, w=frequency[band] ** -0.5)[0])
    slope = min(0.0, max(slope, -CONTINUED))
    first = int(np.argmax(band))
    least = density[first] * (np.maximum(frequency[:first], LOWEST) / frequency[first]) ** slope
    return np.concatenate([np.maximum(density[:first], least), density[first:]])


def _density(noise: Noise, frequency: Array) -> Array:
    """Return the spectral density of the noise on the lines of a real FFT, (N*m)^2; it is 1 for unit white noise."""
    response = np.fft.rfft(noise.filter, 2 * (len(frequency) - 1))
    return np.asarray(noise.deviation**2 / np.maximum(np.abs(response) ** 2, 1e-12))


def _autoregressive(covariance: Array, samples: float, period: float) -> Noise:
    lags = int(min(MOST_LAGS, round(MEMORY / period), samples / 12))
    if lags < 1:
        return white_noise(float(np.sqrt(covariance[0])))
    head = covariance[: lags + 1].copy()
    head[0] *= 1.0 + 1e-9  # rounding must not make the matrix indefinite
    weights = solve_toeplitz(head[:lags], head[1 : lags + 1])
    variance = float(head[0] - weights @ head[1 : lags + 1])
    return Noise(np.concatenate([[1.0], -weights]), float(np.sqrt(max(variance, 1e-12 * head[0]))), head[:lags])
