"""Choose the low-pass with the smallest expected error: lost motion plus remaining noise.

Let S and N be the spectral densities of motion and noise. In the derivative of order r, a zero-phase filter of gain H
has the mean square error

    integral of (2 pi f)^(2r) ((1 - H)^2 S + H^2 N) df

S is the excess of the measured density over N. Above its peak, S ends where the excess is not significant for half an
octave. Beyond that, only lines far above the noise and pairs of highly significant neighbouring bands count as motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.smoothing.averaged import bands
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import fast_size

RUN_IN = 4.0  # periods of the cut-off by which each end is extended: the slowest filter decays to 1e-3 within them
AT_THE_END = 1.0  # periods of the cut-off over which the curvature at an end is fitted
DEGREE = 4  # degree of the polynomial in that fit
FADE = 4.0  # periods of the cut-off after which the extension has no curvature


@dataclass(frozen=True)
class LowPass:
    """Represent a Butterworth low-pass run in both directions: gain 1/(1 + (f/cutoff)^(2 order)), cutoff in Hz."""

    order: int
    cutoff: float

    def gain(self, frequency: Array) -> Array:
        """Return the gain (1) at frequencies in Hz."""
        return np.asarray(1.0 / (1.0 + (frequency / self.cutoff) ** (2 * self.order)))

    def __str__(self) -> str:
        return f"{self.cutoff:.3g} Hz, order {self.order}"


def filtered(y: Array, period: float, low_pass: LowPass, derivatives: Sequence[int] = (0,)) -> list[Array]:
    """Return the derivatives of the given orders of the filtered signal y (n,), each (n,); `period` is in s.

    Both ends are extended with continuous value, slope, curvature and third derivative, because a log may start and end
    in full motion.
    """
    n = len(y)
    run_in = min(n - 1, math.ceil(RUN_IN / (low_pass.cutoff * period)) + 16)
    longer = _carried_on(y, period, low_pass.cutoff, run_in)
    start, slope = float(longer[0]), float(longer[-1] - longer[0]) / (len(longer) - 1)
    longer -= start + slope * np.arange(len(longer))  # after this, both ends meet
    size = fast_size(len(longer))
    spectrum = np.fft.rfft(longer, size)
    del longer  # an hour at 1 kHz takes 30 MB, and its spectrum takes 34 MB
    frequency = np.asarray(np.fft.rfftfreq(size, period), dtype=np.float64)
    spectrum *= low_pass.gain(frequency)
    inside = slice(run_in, run_in + n)
    out = []
    for order in derivatives:
        turned = spectrum if order == 0 else spectrum * (2j * np.pi * frequency) ** order
        left = np.fft.irfft(turned, size)[inside].copy()
        if order == 0:
            left += start + slope * np.arange(run_in, run_in + n)
        elif order == 1:
            left += slope / period
        out.append(left)
    return out


def _carried_on(y: Array, period: float, cutoff: float, count: int) -> Array:
    """Return y extended by `count` samples at each end."""
    return np.concatenate(
        [_before(y, period, cutoff, count), y, _before(y[::-1], period, cutoff, count)[::-1]],
    )


def _before(y: Array, period: float, cutoff: float, count: int) -> Array:
    """Return the extension before y: the odd reflection about the smoothed end value, plus twice the curvature term."""
    length = min(len(y), max(2 * DEGREE, math.ceil(AT_THE_END / (cutoff * period))))
    if length <= DEGREE:
        return np.asarray(2.0 * y[0] - y[count:0:-1])
    position = np.linspace(0.0, 1.0, length)
    value, _, bend = np.linalg.lstsq(np.vander(position, DEGREE + 1, increasing=True), y[:length], rcond=None)[0][:3]
    past = np.arange(1, count + 1) / (length - 1)
    faded = np.exp(-((past * (length - 1) * period * cutoff / FADE) ** 4))
    return np.asarray((2.0 * value - y[1 : count + 1] + 2.0 * bend * past**2 * faded)[::-1])


ORDERS = (2, 3, 4, 6)  # orders of the Butterworth filters: from hardly any ringing to a steep cut-off above the motion
PER_DECADE = 40  # number of cut-offs tried per decade: they are 6 % apart, which increases the error by less than 1 %
HIGHEST = 0.35  # highest cut-off over the rate: if the gain at half the rate is not 0, a derivative rings endlessly
CERTAIN = 3.0  # standard errors above the noise at which a band is significant; by chance, one band in 700 is
STANDS_OUT = 0.3  # least density relative to that of the noise: a weaker motion is not worth the noise that passes too
GAP = 4  # bands, half an octave: a gap of this width ends the motion (a zero in its spectrum is narrower)
LINE = 10.0  # times the noise: an isolated line of this size does not occur by chance
RESUMED = 4.0  # standard errors of two neighbouring bands that show motion beyond a gap; chance: one pair in 1e7


@dataclass(frozen=True)
class Noise:
    """Hold the density of the noise in each band (unit squared per Hz) and its standard error."""

    density: Array
    spread: Array


@dataclass(frozen=True)
class Choice:
    """Hold a low-pass and the expected RMS error of its derivative: the total, and the part of the noise."""

    low_pass: LowPass
    error: float
    noise: float


def motion_density(measured: Array, values: Array, noise: Noise) -> Array:
    """Return S in each band; each measured density is the mean of `values` independent values."""
    level = noise.density
    above = measured - level
    error = np.hypot(level / np.sqrt(values), noise.spread)
    sure = (above > CERTAIN * error) & (above > STANDS_OUT * level)
    end = _end(sure, int(np.argmax(above)))
    surer = np.concatenate([[False], sure & (above > RESUMED * error), [False]])
    line = above > LINE * np.maximum(level, CERTAIN * noise.spread)
    resumed = surer[1:-1] & (surer[:-2] | surer[2:])
    kept = (np.arange(len(above)) < end) | line | resumed
    return np.where(kept, np.maximum(above, 0.0), 0.0)


def _end(sure: NDArray[np.bool_], start: int) -> int:
    """Return the index of the first of GAP consecutive bands that are not significant."""
    missing = 0
    for band in range(start, len(sure)):
        missing = 0 if sure[band] else missing + 1
        if missing == GAP:
            return band - GAP + 1
    return len(sure) - missing


def choose(
    count: int, period: float, motion: Array, noise: Array, derivatives: tuple[int, ...], highest: float | None = None
) -> tuple[Choice, ...]:
    """Return the best low-pass for all `derivatives` of a log, with the expected error for each of them.

    The best filter minimises, over the derivatives, the largest ratio of its error to the least error of any filter.
    `highest`: largest cut-off, Hz.
    """
    edges = bands(count, period)
    filters, lost, passed = _tried(count, period)
    centre, width = np.sqrt(edges[1:] * edges[:-1]), np.diff(edges)
    scale = [(2.0 * np.pi * centre) ** (2 * order) * width for order in derivatives]
    noises = np.stack([passed @ (weight * noise) for weight in scale], axis=1)
    squares = np.stack([lost @ (weight * motion) for weight in scale], axis=1) + noises
    least = np.maximum(squares.min(axis=0), np.finfo(np.float64).tiny)
    allowed = np.array([highest is None or f.cutoff <= highest for f in filters])
    if not allowed.any():
        allowed[np.argmin([f.cutoff for f in filters])] = True
    best = int(np.argmin(np.where(allowed, (squares / least).max(axis=1), np.inf)))
    return tuple(
        Choice(filters[best], float(np.sqrt(squares[best, i])), float(np.sqrt(noises[best, i])))
        for i in range(len(derivatives))
    )


@lru_cache(maxsize=16)
def _tried(count: int, period: float) -> tuple[tuple[LowPass, ...], Array, Array]:
    """Return all filters, the share of motion power that each removes, and the share of noise power that each passes.

    Both shares have the shape (k, bands). The motion counts at the upper edge of its band, where the gain is smallest.
    """
    edges = bands(count, period)
    lowest, highest = 2.0 * edges[0], HIGHEST / period
    number = max(2, round(PER_DECADE * np.log10(max(highest / lowest, 1.0))) + 1)
    cutoffs = np.geomspace(min(lowest, highest), highest, number)
    filters = tuple(LowPass(order, float(cutoff)) for order in ORDERS for cutoff in cutoffs)
    centre = np.sqrt(edges[1:] * edges[:-1])
    lost = np.array([(1.0 - low_pass.gain(edges[1:])) ** 2 for low_pass in filters])
    passed = np.array([low_pass.gain(centre) ** 2 for low_pass in filters])
    return filters, lost, passed
