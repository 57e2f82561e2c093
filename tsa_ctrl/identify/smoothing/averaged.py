"""The noise of a measured velocity: white, and sunk towards high frequencies where the drive averaged it.

Drives and tachometers report means over a few samples, or what a filter of first order leaves. Taken from the highest
frequencies alone, the noise where the joint moves would come out too small by an order of magnitude, and what is left
of it would pass for motion. So each kind of averaging is tried, and the one under which the noise is flat down to the
lowest frequency is believed; no averaging, unless it reaches clearly further.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tsa_ctrl.identify.smoothing.spectrum import bands
from tsa_ctrl.model.functions import Array

MEANS = range(2, 11)  # samples that a mean may span: more would reach down to where joints of 1 kHz move
CORNERS = (0.05, 0.07, 0.1, 0.14, 0.2)  # of the rate, of filters of first order: the same reach
POINTS = 16  # in a band, over which a shape's mean is taken: the zeros of a mean are narrower than a band
DEEPEST = 1e-3  # of a shape: rounding and white noise after the mean fill its zeros
FLAT = 2.0  # times the level or a FLATth of it: a band off by less is noise, as neighbours in a shape differ by less
MISSED = 2  # bands in a row off by more that end the plateau: a line or a zero alone does not
SUNK = 0.1  # of a shape: in its zeros the noise is what is measured there, rounding and all
FURTHER = 1.4  # times as far down (half an octave) a shape must reach to be believed instead of white noise


def plateau(measured: Array, count: int, period: float, top: float) -> tuple[float, Array]:
    """Level, and shape per band, of the noise in the `measured` density (bands,) of a velocity of `count` samples.

    The shape is 1 where nothing was averaged.

    `top`: fraction of the rate above which there is no motion.
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
    """The level of the plateau that ends at the top, and its lowest band."""
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
    """Power gains in each band: none, means, filters of first order; and the bands' centres in Hz."""
    edges = bands(count, period)
    inside = edges[:-1, None] + (np.arange(POINTS) + 0.5) / POINTS * np.diff(edges)[:, None]
    x = inside * period
    gains = [np.ones_like(x)]
    gains += [(np.sin(np.pi * width * x) / (width * np.sin(np.pi * x))) ** 2 for width in MEANS]
    gains += [1.0 / (1.0 + (np.tan(np.pi * np.minimum(x, 0.499)) / np.tan(np.pi * corner)) ** 2) for corner in CORNERS]
    return tuple(np.maximum(gain.mean(axis=1), DEEPEST) for gain in gains), np.sqrt(edges[1:] * edges[:-1])
