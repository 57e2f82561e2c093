"""One smoother for every verb: an angle or a velocity and its derivatives, as sharp as its noise allows.

The low-pass follows from the data: from the densities of motion and noise, by least expected error
(`bandwidth`). Rounding to counts is not white noise where the motion is slower than a count per sample; so its density
is measured: a smooth motion near the one recorded is rounded again, at other positions between the counts, until the
low-pass that follows is the one that it began with. The remaining power of the highest frequencies is white noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tsa_ctrl.identify.smoothing.averaged import SHORTEST, band_densities, bands, plateau
from tsa_ctrl.identify.smoothing.bandwidth import Choice, LowPass, Noise, choose, filtered, motion_density
from tsa_ctrl.model.functions import Array

DRAWS = 4  # of positions between the counts: samples in the mean of the noise density; of short logs more
DRAWN = 65_536  # samples in all draws at least: a minute at 1 kHz
HELD = 2_000_000  # samples in all draws at most that are held at once: of an hour they would take 120 MB
ROUNDS = 8  # of rounding again at most; two or three are enough but for encoders of a few counts
MORE = 4.0  # times the noise that rounding can be, to begin with: from below, no stair is taken for motion
TOP = 0.3  # of the rate: motion ends below it
WORTHWHILE = 0.5  # of a measured velocity's noise: a low-pass that leaves more may distort more than it improves
WORTH = 0.1  # of the rounding's density: a smaller excess is not another kind of noise
GRID = 1e-3  # of a count, by which steps may miss a whole number of counts (digits of a text file)
ORDERS = {"angle": ((0, 1), (2,)), "velocity": ((0,), (1,))}  # derivatives that share a low-pass


@dataclass(frozen=True)
class Smoothed:
    """A signal (n,) sampled every `period` s, and what of it is motion.

    `smooth` is the low-pass of an angle and its velocity, or of a velocity; `steep` of the acceleration. `errors`
    are the RMS errors expected of value, first and (of an angle) second derivative, `noises` the noise's part of them.
    `count` is the step of the grid that the values lie on, 0 without one. Without low-passes (None) the signal is taken
    as exact and its derivatives are central differences.
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
        """The signal itself."""
        return self.raw if self.smooth is None else self._both[0]

    @cached_property
    def rate(self) -> Array:
        """Its first derivative: of an angle the velocity, of a velocity the acceleration."""
        if self.kind == "angle":
            return np.gradient(self.raw, self.period) if self.smooth is None else self._both[1]
        return self._steep(1)

    @cached_property
    def second(self) -> Array:
        """The acceleration of an angle."""
        return self._steep(2)

    @cached_property
    def _both(self) -> list[Array]:
        assert self.smooth is not None
        return filtered(self.raw, self.period, self.smooth, (0, 1) if self.kind == "angle" else (0,))

    def within(self, cutoff: float) -> Smoothed:
        """The same angle with no motion above `cutoff` Hz in value and rate; the acceleration stays.

        White noise passes a low-pass as its cut-off to the order of the derivative and a half. The motion that the
        lower cut-off removes is not in `errors`: it was excluded on purpose.
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
    """`y` (n,), an "angle" or a "velocity" sampled every `period` s, smoothed; `cutoff` in Hz overrides the data's.

    Raises nothing: a signal that never changes or is shorter than SHORTEST samples is unchanged, and so is a measured
    velocity whose motion reaches so far up that little noise could be taken away.
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
    """Rounding, as it is when a motion like this one is rounded, and white noise, of a velocity perhaps averaged."""
    edges = bands(len(y), period)
    top = np.sqrt(edges[1:] * edges[:-1]) > TOP / period
    if not top.any():
        top[-1] = True
    rounding = step**2 / 6.0 * period  # white: variance step^2 / 12 over half the rate
    level, shape = float(np.median(measured[top])), np.ones(len(measured))
    if kind == "velocity":
        level, shape = plateau(measured, len(y), period, TOP)
    white = max(0.0, level - rounding)
    held = len(y) / max(1, int(np.count_nonzero(np.diff(y))))  # samples on one count: its rounding is so much slower
    first = rounding if step == 0.0 else MORE * held * rounding
    noise = Noise(first + white * shape, np.zeros(len(measured)))
    if step == 0.0:
        return noise
    tried: set[LowPass] = set()
    count = max(DRAWS, -(-DRAWN // len(y)))
    together = count if count * len(y) < HELD else 1
    for _ in range(ROUNDS):
        rng = np.random.default_rng(0)  # the same draws in each round, so that they end
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
    """The error of rounding `path` and noise to `step`, somewhere else between the counts."""
    shifted = path + rng.uniform(-0.5 * step, 0.5 * step)
    noisy = shifted + deviation * rng.standard_normal(len(path)) if deviation > 0.0 else shifted
    return np.asarray(np.round(noisy / step) * step - shifted)


def grid(y: Array) -> float:
    """The step of the grid that all values lie on; 0 without one."""
    steps = np.abs(np.diff(y))
    steps = steps[steps > 0.0]
    if steps.size == 0:
        return 0.0
    count = float(steps.min())
    whole = steps / count
    if float(whole.max()) > 1e12 or float(np.max(np.abs(whole - np.round(whole)) / whole)) > GRID:
        return 0.0
    return count
