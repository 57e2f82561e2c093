"""A zero-phase Butterworth low-pass over the spectrum, and the derivatives of what it leaves.

At both ends of a log the signal is carried on by its odd reflection, bent by the curvature that it has there: value,
slope, curvature and third derivative go on, so that a log may begin and end in full motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.model.functions import Array

RUN_IN = 4.0  # periods of the cut-off carried on beyond each end: the slowest of the filters has rung off to 1e-3 there
AT_THE_END = 1.0  # period of the cut-off, over which the end's curvature is taken
DEGREE = 4  # of the polynomial that gives it
FADE = 4.0  # periods of the cut-off after which the curvature is not carried on any more


@dataclass(frozen=True)
class LowPass:
    """Gain 1/(1 + (f/cutoff)^(2 order)): a Butterworth filter of this order run both ways. cutoff in Hz."""

    order: int
    cutoff: float

    def gain(self, frequency: Array) -> Array:
        """At frequencies in Hz."""
        return np.asarray(1.0 / (1.0 + (frequency / self.cutoff) ** (2 * self.order)))

    def __str__(self) -> str:
        return f"{self.cutoff:.3g} Hz, order {self.order}"


def filtered(y: Array, period: float, low_pass: LowPass, derivatives: Sequence[int] = (0,)) -> list[Array]:
    """Derivatives of these orders of the low-passed signal, each (n,); y sampled every `period` s."""
    n = len(y)
    run_in = min(n - 1, math.ceil(RUN_IN / (low_pass.cutoff * period)) + 16)
    longer = _carried_on(y, period, low_pass.cutoff, run_in)
    start, slope = float(longer[0]), float(longer[-1] - longer[0]) / (len(longer) - 1)
    longer -= start + slope * np.arange(len(longer))  # without this line the ends would not meet
    size = fast_size(len(longer))
    spectrum = np.fft.rfft(longer, size)
    del longer  # an hour at 1 kHz is 30 MB, and its spectrum 34
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
    """y with `count` samples more at each end."""
    return np.concatenate(
        [_before(y, period, cutoff, count), y, _before(y[::-1], period, cutoff, count)[::-1]],
    )


def _before(y: Array, period: float, cutoff: float, count: int) -> Array:
    """What may have been before y: its odd reflection about the end's smooth value, and twice the curvature's part."""
    length = min(len(y), max(2 * DEGREE, math.ceil(AT_THE_END / (cutoff * period))))
    if length <= DEGREE:
        return np.asarray(2.0 * y[0] - y[count:0:-1])
    position = np.linspace(0.0, 1.0, length)
    value, _, bend = np.linalg.lstsq(np.vander(position, DEGREE + 1, increasing=True), y[:length], rcond=None)[0][:3]
    past = np.arange(1, count + 1) / (length - 1)
    faded = np.exp(-((past * (length - 1) * period * cutoff / FADE) ** 4))
    return np.asarray((2.0 * value - y[1 : count + 1] + 2.0 * bend * past**2 * faded)[::-1])


def fast_size(n: int) -> int:
    """The smallest 2^a, 3*2^a or 5*2^a that is at least n: lengths that the FFT is quick at."""
    return min(factor << max(0, math.ceil(math.log2(n / factor))) for factor in (1, 3, 5))
