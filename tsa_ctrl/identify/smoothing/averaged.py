"""Estimate the noise of a measured velocity: white, or reduced at high frequencies if the drive averages.

Drives and tachometers report means over a few samples, or apply a first-order filter. At the frequencies of the motion,
an estimate from the highest frequencies alone would then be an order of magnitude too small. Noise would be mistaken
for motion. Each kind of averaging is therefore tried, and the kind whose noise is flat down to the lowest frequency is
used. No averaging is assumed unless another kind reaches clearly lower.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from tsa_ctrl.model.functions import Array

LONGEST = 65_536  # samples of the longest segment, a minute at 1 kHz: its window is narrower than the bands above 1 Hz
COVERED = 262_144  # samples used in the segments of one length: they determine the density of a band to a few per cent
SHORTEST = 64  # samples of the shortest segment; a shorter signal has no useful spectrum
CYCLES = 64.0  # cycles of a band's lower edge in a segment: the window blurs by 6.4 cycles, a tenth of the edge
WIDTH = 2.0**0.125  # ratio of the edges of a band: a filter's gain changes little over it
SHAPE = 20.0  # shape parameter of the Kaiser window: its side lobes are 155 dB down, more than 24 bit
FEWEST = 3  # fewest resolved frequencies in a band


@lru_cache(maxsize=16)
def bands(count: int, period: float) -> Array:
    """Return the ascending band edges (Hz) up to half the rate, for `count` samples every `period` s."""
    span = min(count, LONGEST) * period
    highest = 0.5 / period
    edges = [0.5 * FEWEST / span]
    while edges[-1] < highest:
        edges.append(max(edges[-1] * WIDTH, edges[-1] + FEWEST / span))
    edges[-1] = highest
    return np.array(edges)


def band_densities(y: Array, period: float) -> tuple[Array, Array]:
    """Return the mean one-sided density in each band (unit of y squared per Hz), and the number of averaged values.

    The Kaiser window has no side lobes above -155 dB, because the noise of a 24-bit encoder is 150 dB below the motion.
    Segments are long for low bands and short for high bands, so that the ends of a log count in every band. A long log
    is sampled by segments spread over it, which bounds the computing time.
    """
    edges = bands(len(y), period)
    length, computed = min(len(y), LONGEST), 0
    density: Array = np.zeros(0)
    frequency: Array = np.zeros(0)
    out = np.zeros(len(edges) - 1)
    for band, (low, high) in enumerate(pairwise(edges)):
        while length // 2 >= SHORTEST and CYCLES / low <= (length // 2) * period:
            length //= 2
        if length != computed:
            density, computed = _density(y, period, length), length
            frequency = np.asarray(np.fft.rfftfreq(length, period), dtype=np.float64)
        first, end = (int(i) for i in np.searchsorted(frequency, (low, high)))
        first = min(first, end - 1)
        out[band] = float(density[max(first, 0) : max(end, 1)].mean())
    values = np.maximum(np.diff(edges) * min(len(y), COVERED) * period / 2.0, 1.0)  # the window uses half of a segment
    return out, values


def _density(y: Array, period: float, length: int) -> Array:
    """Return the mean density of segments of `length` samples spread over y, each without its mean and slope."""
    wanted = 1 + -(-4 * (len(y) - length) // length)  # an overlap of three quarters, because the window is narrow
    count = max(1, min(wanted, COVERED // length))
    starts = np.unique(np.linspace(0, len(y) - length, count).round().astype(np.int64))
    segments = np.lib.stride_tricks.sliding_window_view(y, length)[starts]
    line, window, sloped = _window(length)
    trend = np.stack([segments.mean(axis=1), segments @ line / float(line @ line)], axis=1)
    segments *= window
    segments -= trend @ np.stack([window, sloped])
    parts = np.fft.rfft(segments, axis=1).view(np.float64)  # real and imaginary parts alternate
    squares = np.einsum("ij,ij->j", parts, parts).reshape(-1, 2)
    return np.asarray(2.0 * period / len(starts) * (squares[:, 0] + squares[:, 1]))


@lru_cache(maxsize=32)
def _window(length: int) -> tuple[Array, Array, Array]:
    """Return a line from -1 to 1, the window of power 1, and their product."""
    line = np.linspace(-1.0, 1.0, length)
    window = np.kaiser(length, SHAPE)
    window /= np.sqrt(float(window @ window))
    return line, window, line * window


MEANS = range(2, 11)  # lengths of a mean in samples: longer ones would affect the frequencies of joint motion at 1 kHz
CORNERS = (0.05, 0.07, 0.1, 0.14, 0.2)  # corners of first-order filters over the rate: the same range of frequencies
POINTS = 16  # points per band over which a shape is averaged: the zeros of a mean are narrower than a band
DEEPEST = 1e-3  # lower limit of a shape: rounding and white noise after the mean fill its zeros
FLAT = 2.0  # largest ratio to the level, or its inverse, of a band that is noise: neighbouring bands differ by less
MISSED = 2  # successive bands beyond this ratio that end the plateau, so that a single line or zero does not end it
SUNK = 0.1  # a shape below this value is near a zero, where all of the measured power is noise, including rounding
FURTHER = 1.4  # factor (half an octave) by which a shape must reach lower than white noise to be used instead


def plateau(measured: Array, count: int, period: float, top: float) -> tuple[float, Array]:
    """Return level and shape (bands,) of the noise in the `measured` density (bands,) of a velocity.

    The shape is 1 without averaging.

    Args:
        measured: density, (bands,).
        count: number of samples.
        period: s.
        top: upper end of the motion as a share of the sampling rate.
    """
    shapes, centre = _shapes(count, period)
    high = centre > top / period
    if np.count_nonzero(high) < 2:
        return float(measured[-1]), np.ones(len(measured))
    best, level, lowest = 0, 0.0, np.inf
    for number, shape in enumerate(shapes):
        flat = measured / shape
        own, end = _reach(flat, float(np.median(flat[high])))
        if centre[end] * (FURTHER if best == 0 and number else 1.0) < lowest:
            best, level, lowest = number, own, float(centre[end])
    shape = shapes[best]
    return level, np.where(shape < SUNK, np.maximum(shape, measured / max(level, np.finfo(float).tiny)), shape)


def _reach(flat: Array, level: float) -> tuple[float, int]:
    """Return the level of the plateau that begins at the highest band, and the number of its lowest band.

    `level`: first estimate of the level.
    """
    end, missed = len(flat) - 1, 0
    for band in range(len(flat) - 1, -1, -1):
        missed = missed + 1 if not level / FLAT < flat[band] < FLAT * level else 0
        if missed == MISSED:
            break
        if missed == 0:
            end = band
            level = float(np.median(flat[band:]))
    return level, end


@lru_cache(maxsize=16)
def _shapes(count: int, period: float) -> tuple[tuple[Array, ...], Array]:
    """Return the power gains in each band (none, means, first-order filters), and the centres of the bands in Hz."""
    edges = bands(count, period)
    inside = edges[:-1, None] + (np.arange(POINTS) + 0.5) / POINTS * np.diff(edges)[:, None]
    x = inside * period
    gains = [np.ones_like(x)]
    gains += [(np.sin(np.pi * width * x) / (width * np.sin(np.pi * x))) ** 2 for width in MEANS]
    gains += [1.0 / (1.0 + (np.tan(np.pi * np.minimum(x, 0.499)) / np.tan(np.pi * corner)) ** 2) for corner in CORNERS]
    return tuple(np.maximum(gain.mean(axis=1), DEEPEST) for gain in gains), np.sqrt(edges[1:] * edges[:-1])
