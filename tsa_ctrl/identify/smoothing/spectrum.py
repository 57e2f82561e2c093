"""The spectral density of a signal in bands of about an eighth of an octave, over fifteen decades.

A window without side lobes (Kaiser), because what an encoder of 24 bit adds lies 150 dB below the motion; segments that
are long for low bands and short for high ones, so that a band sees the motion at the ends of a log, too, and is about
as sharp as it is wide. The work is bounded: of a long log, segments spread over it are looked at.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from tsa_ctrl.model.functions import Array

LONGEST = 65_536  # samples of a segment: a minute at 1 kHz, for bands from 1 Hz on as sharp as they are wide
COVERED = 262_144  # samples looked at in the segments of one length: the density of a band is then known to a few %
SHORTEST = 64  # samples of a segment
CYCLES = 64.0  # of a band's lower edge in a segment: the window blurs by 6.4 of them either way, a tenth of the band
WIDTH = 2.0**0.125  # of a band, upper over lower edge: a filter's gain changes little over it
SHAPE = 20.0  # of the Kaiser window: side lobes 155 dB down, more than 24 bit
FEWEST = 3  # resolved frequencies in a band


@lru_cache(maxsize=16)
def bands(count: int, period: float) -> Array:
    """Edges in Hz, ascending, of the bands of a log of `count` samples every `period` s, up to half the rate."""
    span = min(count, LONGEST) * period
    highest = 0.5 / period
    edges = [0.5 * FEWEST / span]
    while edges[-1] < highest:
        edges.append(max(edges[-1] * WIDTH, edges[-1] + FEWEST / span))
    edges[-1] = highest
    return np.array(edges)


def band_densities(y: Array, period: float) -> tuple[Array, Array]:
    """Mean one-sided density in each band (unit of y squared per Hz), and about how many values it is the mean of."""
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
    """Mean density of segments of `length` samples spread over y, each without its mean and slope."""
    wanted = 1 + -(-4 * (len(y) - length) // length)  # three quarters overlap: the window is that narrow
    count = max(1, min(wanted, COVERED // length))
    starts = np.unique(np.linspace(0, len(y) - length, count).round().astype(np.int64))
    segments = np.lib.stride_tricks.sliding_window_view(y, length)[starts]
    line, window, sloped = _window(length)
    trend = np.stack([segments.mean(axis=1), segments @ line / float(line @ line)], axis=1)
    segments *= window
    segments -= trend @ np.stack([window, sloped])
    parts = np.fft.rfft(segments, axis=1).view(np.float64)  # real and imaginary in turn
    squares = np.einsum("ij,ij->j", parts, parts).reshape(-1, 2)
    return np.asarray(2.0 * period / len(starts) * (squares[:, 0] + squares[:, 1]))


@lru_cache(maxsize=32)
def _window(length: int) -> tuple[Array, Array, Array]:
    """A line from -1 to 1, the window of power 1, and the line as the window leaves it."""
    line = np.linspace(-1.0, 1.0, length)
    window = np.kaiser(length, SHAPE)
    window /= np.sqrt(float(window @ window))
    return line, window, line * window
