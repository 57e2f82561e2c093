"""Models of instruments: coloured noise, encoder counts and torque resolution."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

Array = np.ndarray


def coloured_noise(rng: np.random.Generator, count: int, rate: float) -> Array:
    """Return noise of RMS 1, (count,).

    It is a sum of white noise, low-pass noise of 3 to 40 ms, and noise with a 1/f power spectrum above 0.2 Hz.
    """
    white = rng.standard_normal(count)
    pole = np.exp(-1.0 / (rate * rng.uniform(0.003, 0.04)))
    low = lfilter([1.0], [1.0, -pole], rng.standard_normal(count + 2000))[2000:]
    frequency = np.fft.rfftfreq(count, 1.0 / rate)
    spectrum = np.fft.rfft(rng.standard_normal(count)) / np.sqrt(np.maximum(frequency, 0.2))
    spectrum[0] = 0.0
    pink = np.fft.irfft(spectrum, count)
    shares = np.array([rng.uniform(0.2, 1.0), rng.uniform(0.0, 1.0), rng.uniform(0.0, 0.4)])
    shares /= shares.sum()
    out = sum(np.sqrt(share) * part / part.std() for share, part in zip(shares, (white, low, pink), strict=True))
    return np.asarray(out) / np.std(out)


def quantised(value: Array, step: float) -> Array:
    return step * np.round(value / step)


def encoder(rng: np.random.Generator, angle: Array, counts: int, jitter: float = 0.25) -> Array:
    """Return the angle in whole counts. Mechanical jitter, as a share of one count, is added before the rounding."""
    count = 2.0 * np.pi / counts
    return quantised(angle + jitter * count * rng.standard_normal(angle.size), count)


def differenced(angle: Array, step: float, window: float) -> Array:
    """Return the velocity from encoder counts over a window centred on the sample, without lag."""
    half = max(1, round(0.5 * window / step))
    padded = np.concatenate([np.full(half, angle[0]), angle, np.full(half, angle[-1])])
    difference = (padded[2 * half :] - padded[: -2 * half]) / (2 * half * step)
    difference[:half] = difference[half]  # the padding would halve the velocity at the ends
    difference[-half:] = difference[-half - 1]
    return difference


def tachometer(rng: np.random.Generator, omega: Array, noise: float, smooth: int) -> Array:
    """Return the velocity with additive noise that may be averaged over neighbouring samples, without lag."""
    eta = rng.standard_normal(omega.size)
    if smooth > 1:
        eta = uniform_filter1d(eta, smooth, mode="nearest") * np.sqrt(smooth)
    return omega + noise * eta
