"""Smooth an angle or a velocity and its derivatives; all commands use this smoother.

The low-pass with the least expected error follows from the spectral densities of motion and noise (`bandwidth`).
Rounding to counts is not white noise if the motion is slower than one count per sample. Its density is therefore
measured: a smoothed copy of the recorded motion is rounded again at other positions between the counts. This is
repeated until it yields a low-pass that was already used. The remaining power at the highest frequencies is white
noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tsa_ctrl.identify.smoothing.averaged import SHORTEST, band_densities, bands, plateau
from tsa_ctrl.identify.smoothing.bandwidth import Choice, LowPass, Noise, choose, filtered, motion_density
from tsa_ctrl.model.functions import Array

DRAWS = 4  # random positions between the counts over which the noise density is averaged; more for a short log
DRAWN = 65_536  # least number of samples in all trials together: a minute at 1 kHz
HELD = 2_000_000  # most samples of all trials in memory at once: for an hour they would require 120 MB
ROUNDS = 8  # most repetitions of the rounding; two or three suffice unless the encoder moves by only a few counts
MORE = 4.0  # first estimate in units of the rounding noise: with a smaller one, the counts' steps would pass as motion
TOP = 0.3  # share of the sampling rate: motion has lower frequencies
WORTHWHILE = 0.5  # largest error of a low-pass over the noise of a measured velocity: more may distort than it improves
WORTH = 0.1  # share of the rounding noise density: a smaller excess does not count as white noise
GRID = 1e-3  # largest relative deviation of a step from a whole number of counts: text files have few digits
ORDERS = {"angle": ((0, 1), (2,)), "velocity": ((0,), (1,))}  # orders of the derivatives that share a low-pass


@dataclass(frozen=True)
class Smoothed:
    """A signal (n,) sampled every `period` s, with the low-passes that separate its motion from noise.

    `smooth` is the low-pass of an angle and its velocity, or of a velocity. `steep` is that of the acceleration.
    `errors` are the expected RMS errors of the value, the first and (for an angle) the second derivative, and `noises`
    are the parts of the noise in them. `count` is the step between possible values, or 0 if they form no grid. If a
    low-pass is None, the signal is not filtered, and its derivatives are central differences.
    """

    raw: Array
    period: float
    kind: str
    count: float
    smooth: LowPass | None
    steep: LowPass | None
    errors: tuple[float, ...]
    noises: tuple[float, ...]

    @cached_property
    def value(self) -> Array:
        """Return the smoothed signal."""
        return self.raw if self.smooth is None else self._both[0]

    @cached_property
    def rate(self) -> Array:
        """Return the first derivative: the velocity for an angle, the acceleration for a velocity."""
        if self.kind == "angle":
            return np.gradient(self.raw, self.period) if self.smooth is None else self._both[1]
        return self._steep(1)

    @cached_property
    def second(self) -> Array:
        """Return the second derivative: the acceleration for an angle."""
        return self._steep(2)

    @cached_property
    def _both(self) -> list[Array]:
        assert self.smooth is not None
        return filtered(self.raw, self.period, self.smooth, (0, 1) if self.kind == "angle" else (0,))

    def within(self, cutoff: float) -> Smoothed:
        """Return the angle with value and rate limited to `cutoff` (Hz); the acceleration is not changed.

        For a derivative of order r, the RMS of white noise after a low-pass is proportional to cutoff^(r + 1/2). The
        removed motion is not included in `errors`, because the limit is intended.
        """
        if self.smooth is None or self.smooth.cutoff <= cutoff:
            return self
        lower = cutoff / self.smooth.cutoff
        noises = tuple(n * lower ** (r + 0.5) if r < 2 else n for r, n in enumerate(self.noises))
        errors = tuple(
            float(np.sqrt(max(0.0, e**2 - old**2) + new**2))
            for e, old, new in zip(self.errors, self.noises, noises, strict=True)
        )
        return replace(self, smooth=LowPass(self.smooth.order, cutoff), errors=errors, noises=noises)

    def _steep(self, order: int) -> Array:
        if self.steep is not None:
            return filtered(self.raw, self.period, self.steep, (order,))[0]
        out = self.raw
        for _ in range(order):
            out = np.gradient(out, self.period)
        return out


def smoothed(y: Array, period: float, kind: str = "angle", cutoff: float | None = None) -> Smoothed:
    """Return `y` (n,), an "angle" or a "velocity" sampled every `period` s, with its low-passes.

    A signal that never changes or has fewer than SHORTEST samples is not filtered. A measured velocity is not filtered
    either if a low-pass would remove too little noise, but its acceleration is.

    Args:
        cutoff: Hz; replaces the cut-off that follows from the data.
    """
    step = grid(y)
    shared, apart = ORDERS[kind]
    whole = len(shared) + len(apart)
    if len(y) < SHORTEST or not float(np.ptp(y)) > 0.0:
        return Smoothed(y, period, kind, step, None, None, (0.0,) * whole, (0.0,) * whole)
    measured, values = band_densities(y, period)
    noise = _noise(y, period, kind, step, measured, values, shared, cutoff)
    motion = motion_density(measured, values, noise)
    chosen = [choose(len(y), period, motion, noise.density, orders, cutoff) for orders in (shared, apart)]
    if cutoff is not None:
        chosen = [tuple(Choice(LowPass(4, cutoff), c.error, c.noise) for c in choices) for choices in chosen]
    every = [choice for choices in chosen for choice in choices]
    errors, noises = tuple(c.error for c in every), tuple(c.noise for c in every)
    smooth: LowPass | None = chosen[0][0].low_pass
    unfiltered = float(np.sqrt(noise.density @ np.diff(bands(len(y), period))))
    if kind == "velocity" and cutoff is None and errors[0] > WORTHWHILE * unfiltered:
        smooth, errors, noises = None, (unfiltered, *errors[1:]), (unfiltered, *noises[1:])
    return Smoothed(y, period, kind, step, smooth, chosen[1][0].low_pass, errors, noises)


def _noise(
    y: Array,
    period: float,
    kind: str,
    step: float,
    measured: Array,
    values: Array,
    orders: tuple[int, ...],
    cutoff: float | None,
) -> Noise:
    """Return the noise: the error of rounding a similar motion plus white noise, which a drive may have averaged."""
    edges = bands(len(y), period)
    top = np.sqrt(edges[1:] * edges[:-1]) > TOP / period
    if not top.any():
        top[-1] = True
    rounding = step**2 / 6.0 * period  # white: variance step^2 / 12 over half the rate
    level, shape = float(np.median(measured[top])), np.ones(len(measured))
    if kind == "velocity":
        level, shape = plateau(measured, len(y), period, TOP)
    white = max(0.0, level - rounding)
    held = len(y) / max(1, int(np.count_nonzero(np.diff(y))))  # samples per count: the noise is slower by it
    first = rounding if step == 0.0 else MORE * held * rounding
    noise = Noise(first + white * shape, np.zeros(len(measured)))
    if step == 0.0:
        return noise
    tried: set[LowPass] = set()
    count = max(DRAWS, -(-DRAWN // len(y)))
    together = count if count * len(y) < HELD else 1
    for _ in range(ROUNDS):
        rng = np.random.default_rng(0)  # the same random trials in each round, so that the search ends
        motion = motion_density(measured, values, noise)
        low_pass = choose(len(y), period, motion, noise.density, orders, cutoff)[0].low_pass
        if low_pass in tried:
            break
        tried.add(low_pass)
        path = filtered(y, period, low_pass)[0]
        deviation = float(np.sqrt(white * 0.5 / period))
        found: list[Array] = []
        for _ in range(0, count, together):
            errors = [_rounded_again(path, step, deviation, rng) for _ in range(together)]
            found += [band_densities(error, period)[0] for error in errors]
        draws = np.array(found)
        density = draws.mean(axis=0)
        more = float(np.median(measured[top]) - np.median(density[top]))
        if more > WORTH * float(np.median(density[top])):
            white += more
            density = density + more
        noise = Noise(density, draws.std(axis=0))
    return noise


def _rounded_again(path: Array, step: float, deviation: float, rng: np.random.Generator) -> Array:
    """Return the error (n,) of rounding `path` with noise to `step`, at a random position between the counts."""
    shifted = path + rng.uniform(-0.5 * step, 0.5 * step)
    noisy = shifted + deviation * rng.standard_normal(len(path)) if deviation > 0.0 else shifted
    return np.asarray(np.round(noisy / step) * step - shifted)


def grid(y: Array) -> float:
    """Return the step of the grid on which all values of `y` lie; 0 without a grid."""
    steps = np.abs(np.diff(y))
    steps = steps[steps > 0.0]
    if steps.size == 0:
        return 0.0
    count = float(steps.min())
    whole = steps / count
    if float(whole.max()) > 1e12 or float(np.max(np.abs(whole - np.round(whole)) / whole)) > GRID:
        return 0.0
    return count
