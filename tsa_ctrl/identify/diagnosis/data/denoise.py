"""Noise of an angle or a velocity, and a zero-phase low-pass that takes most of it away."""

from __future__ import annotations

import numpy as np

from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import low_pass

LOWEST = 8.0  # Hz, cut-off; joints move below 5 Hz and reverse within tens of milliseconds
MARGIN = 8.0  # spectral density above the noise floor that still counts as motion
SEGMENT = 4.0  # s, of one periodogram


def denoised(y: Array, period: float, highest: float) -> tuple[Array, float]:
    """`y` low-passed where its spectrum sinks into its noise, and the standard deviation of what is left of the noise.

    `highest`: Hz, cut-off at most. A cut-off near half the rate leaves `y` as it is.
    """
    if len(y) < 128 or not np.ptp(y) > 0.0:
        return y, 0.0
    frequency, density, edge, floor = _spectrum(y, period)
    cutoff = min(highest, max(LOWEST, 1.5 * edge))
    if cutoff > 0.2 / period:
        return y, float(np.sqrt(floor * 0.5 / period))
    passed = density[(frequency > 0.5 * cutoff) & (frequency < cutoff)]  # noise that was averaged sinks beyond
    floor = max(floor, float(np.median(passed))) if passed.size else floor
    return low_pass(y, period, cutoff), float(np.sqrt(floor * cutoff))


def distortion(smooth: Array, period: float, cutoff: float) -> Array:
    """What a low-pass at `cutoff` Hz has taken from a signal, (n): about what it takes once more, as a local RMS."""
    taken = (smooth - low_pass(smooth, period, cutoff)) ** 2
    return np.sqrt(np.maximum(low_pass(taken, period, 0.5 * cutoff), 0.0))


def _spectrum(y: Array, period: float) -> tuple[Array, Array, float, float]:
    """Frequencies in Hz, density per Hz, the frequency above which noise covers the signal, and the noise's density."""
    length = min(len(y), round(SEGMENT / period))
    window = np.hanning(length)
    slope = np.linspace(0.0, 1.0, length)
    parts = []
    for start in range(0, len(y) - length + 1, max(1, length // 2)):
        piece = y[start : start + length]
        piece = piece - (piece[0] + (piece[-1] - piece[0]) * slope)
        parts.append(np.abs(np.fft.rfft(window * piece)) ** 2)
    density = 2.0 * period * np.mean(parts, axis=0) / float(window @ window)
    frequency = np.asarray(np.fft.rfftfreq(length, period), dtype=np.float64)
    top = float(np.median(density[frequency > 0.3 / period]))
    middle = density[(frequency > 0.06 / period) & (frequency < 0.2 / period)]  # averaged noise has sunk at the top
    floor = max(top, float(np.quantile(middle, 0.25))) if middle.size else top
    above = np.flatnonzero(density > MARGIN * max(floor, 1e-30))
    return frequency, density, float(frequency[above[-1]]) if above.size else 0.0, floor
