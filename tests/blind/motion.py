"""Create random joint motions and torque programmes that are smooth enough to be differentiated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

Array = np.ndarray

# The kinds of a random choice. "walk" and "plateaus" are chosen only by name.
KINDS = ("sine", "multisine", "trapezoid", "chirp", "gait", "triangle")


@dataclass
class Motion:
    """Joint angle with its derivatives on the fine grid, and the kinds of its pieces."""

    t: Array
    q: Array
    omega: Array
    acceleration: Array
    kinds: tuple[str, ...]
    speed: float  # peak speed, rad/s


def grid(seconds: float, rate: float, before: float = 0.0) -> Array:
    """Return sample times (s) from -before to seconds. The log's first sample, t = 0, is one of them."""
    return np.arange(-round(before * rate), round(seconds * rate)) / rate


def rich_motion(
    rng: np.random.Generator, t: Array, amplitude: float | None = None, dwell: bool = False, rounding: float = 0.0
) -> Motion:
    """Return a motion of several pieces of different kind, speed and amplitude, with reversals at many speeds.

    `rounding` has the same meaning as in `plain_motion`.
    """
    seconds = t[-1] - min(t[0], 0.0)
    count = int(np.clip(round(seconds / rng.uniform(5.0, 9.0)), 3, 8))
    largest = amplitude or rng.uniform(0.6, 1.5)
    fastest = largest * rng.uniform(1.5, 4.5)
    shares = np.exp(np.linspace(np.log(0.08), 0.0, count)) * rng.uniform(0.8, 1.2, count)
    rng.shuffle(shares)
    pieces = []
    for share in np.minimum(shares, 1.0):
        reach = largest * (rng.uniform(0.35, 1.0) if amplitude is None else rng.uniform(0.8, 1.0))
        reach = min(reach, 1.3 * share * fastest * seconds / count / 4.0)  # so that a slow piece also reverses
        pieces.append((str(rng.choice(KINDS)), reach, share * fastest))
    return _assemble(rng, t, pieces, dwell, rounding)


def plain_motion(
    rng: np.random.Generator, t: Array, kind: str, amplitude: float, speed: float, rounding: float = 0.0
) -> Motion:
    """Return a motion of one kind. `rounding` (s) smooths its corners; 0 means a random value."""
    return _assemble(rng, t, [(kind, amplitude, speed)], False, rounding)


def one_way(rng: np.random.Generator, t: Array, speeds: tuple[float, float]) -> Motion:
    """Return a rotation in one direction whose speed varies between two values."""
    low, high = speeds
    wander = 0.5 * (1.0 + np.sin(2.0 * np.pi * rng.uniform(0.05, 0.2) * t + rng.uniform(0.0, 6.28)))
    omega = (low + (high - low) * wander) * rng.choice([-1.0, 1.0])
    step = t[1] - t[0]
    q = np.cumsum(omega) * step
    return Motion(t, q - q.mean(), omega, np.gradient(omega, step), ("one_way",), float(np.max(np.abs(omega))))


def _assemble(
    rng: np.random.Generator, t: Array, pieces: list[tuple[str, float, float]], dwell: bool, rounding: float = 0.0
) -> Motion:
    step = t[1] - t[0]
    edges = np.linspace(t[0], t[-1] + step, len(pieces) + 1)
    fade = min(0.8, 0.25 * (edges[1] - edges[0]))
    q = np.zeros_like(t)
    for (kind, amplitude, speed), begin, end in zip(pieces, edges[:-1], edges[1:], strict=True):
        window = _ramp(t, begin, fade, begin > t[0]) * (1.0 - _ramp(t, end, fade, end < edges[-1]))
        inside = window > 0.0
        q[inside] += window[inside] * _shape(rng, kind, t[inside] - begin, amplitude, speed, dwell)
    q = smoothed(q, (rounding or rng.uniform(0.02, 0.05)) / step)
    omega = np.gradient(q, step)
    omega[np.abs(omega) < 1e-6 * np.max(np.abs(omega))] = 0.0
    acceleration = np.gradient(omega, step)
    return Motion(t, q, omega, acceleration, tuple(kind for kind, _, _ in pieces), float(np.max(np.abs(omega))))


def _ramp(t: Array, edge: float, fade: float, active: bool) -> Array:
    """Return a smooth step (n,) from 0 before the edge to 1 after it.

    For an inactive edge, return 1 everywhere if it is at the first sample, and 0 otherwise.
    """
    if not active:
        return np.ones_like(t) if edge <= t[0] else np.zeros_like(t)
    u = np.clip((t - edge) / fade + 0.5, 0.0, 1.0)
    return u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)


def _shape(rng: np.random.Generator, kind: str, t: Array, amplitude: float, speed: float, dwell: bool) -> Array:
    """Return one piece (n,) with |q| of about `amplitude` and a peak speed of about `speed`."""
    rate = speed / amplitude  # angular frequency of a sine with this reach and speed, rad/s
    phase = rng.uniform(0.0, 2.0 * np.pi)
    match kind:
        case "sine":
            return amplitude * np.sin(rate * t + phase)
        case "multisine":
            ratios = np.array([1.0, 1.618, 2.414, 0.414, 0.732])
            parts = [np.sin(rate * r * t + rng.uniform(0.0, 6.28)) / max(r, 1.0) for r in ratios]
            return 0.45 * amplitude * np.sum(parts, axis=0)
        case "chirp":
            duration = max(t[-1] - t[0], 1e-3)
            low, high = 0.35 * rate, rate
            angle = low * t + 0.5 * (high - low) * t * t / duration
            return amplitude * np.sin(angle + phase)
        case "gait":
            stride = 0.55 * rate * t + phase
            shape = np.sin(stride) + 0.45 * np.sin(2.0 * stride + 0.9) + 0.15 * np.sin(3.0 * stride - 0.4)
            return 0.75 * amplitude * shape
        case "triangle":
            return amplitude * 2.0 / np.pi * np.arcsin(np.clip(np.sin(0.5 * np.pi * rate * t + phase), -1.0, 1.0))
        case "trapezoid":
            hold = rng.uniform(0.15, 0.5) if dwell else 0.0
            travel = 2.0 * amplitude / speed
            cycle = (t % (2.0 * (travel + hold))) / (travel + hold)
            forward = np.clip(cycle * (travel + hold) / travel, 0.0, 1.0)
            back = np.clip((cycle - 1.0) * (travel + hold) / travel, 0.0, 1.0)
            return amplitude * (2.0 * _soft(forward, 0.2) - 2.0 * _soft(back, 0.2) - 1.0)
        case "walk":  # like a person: back and forth without a period, with varying speed
            return amplitude * wander(rng, t, 2.0 * np.pi * amplitude / speed)
        case "plateaus":  # from one angle to another, with a rest at each
            travel = 2.0 * amplitude / speed
            return amplitude * smoothed(_levels(rng, t, 1.5 * travel), 0.15 * travel / (t[1] - t[0]))
    raise ValueError(f"unknown kind of motion: {kind}")


def _soft(u: Array, share: float) -> Array:
    """Return the motion from 0 to 1 at constant speed, with parabolic ends that take `share` of the time each."""
    top = 1.0 / (1.0 - share)
    first = 0.5 * top * u * u / share
    last = 1.0 - 0.5 * top * (1.0 - u) ** 2 / share
    return np.where(u < share, first, np.where(u > 1.0 - share, last, top * (u - 0.5 * share)))


def torque_programme(rng: np.random.Generator, t: Array, sign: int = 0, slow: bool = False) -> Array:
    """Return a torque (n,) of peak 1 that is independent of the motion: sines, steps and held levels.

    If `sign` is +1 or -1, the torque has this sign and a magnitude of 0.1 to 1.
    """
    step = t[1] - t[0]
    fastest = 0.4 if slow else rng.uniform(0.5, 2.5)
    frequencies = np.exp(rng.uniform(np.log(0.04), np.log(fastest), 6))
    sines = sum(np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.28)) * f**-0.3 for f in frequencies)
    sines = sines / np.max(np.abs(sines))
    levels = _levels(rng, t, rng.uniform(1.0, 4.0))
    levels = smoothed(levels, rng.uniform(0.02, 0.08) / step)
    share = rng.uniform(0.2, 0.8)
    out = share * sines + (1.0 - share) * levels
    out = out / np.max(np.abs(out))
    if sign:
        low, high = out.min(), out.max()
        out = sign * (0.1 + 0.9 * (out - low) / (high - low))
    return out


def held_levels(rng: np.random.Generator, t: Array, hold: float, sign: int = 0) -> Array:
    """Return steps between levels that are held for about `hold` seconds, with values in -1..1."""
    levels = smoothed(_levels(rng, t, hold), 0.03 / (t[1] - t[0]))
    return sign * np.abs(levels) if sign else levels


def _levels(rng: np.random.Generator, t: Array, hold: float) -> Array:
    count = max(2, int(np.ceil((t[-1] - t[0]) / hold)) + 1)
    values = rng.permutation(np.linspace(-1.0, 1.0, count))
    return values[np.minimum(((t - t[0]) / hold).astype(int), count - 1)]


def smoothed(values: Array, samples: float) -> Array:
    """Return the values after three moving averages.

    This is nearly a zero-phase Gaussian filter with a standard deviation of `samples`.
    """
    width = 2 * round(samples) + 1
    for _ in range(3):
        values = uniform_filter1d(values, width, mode="nearest")
    return values


def wander(rng: np.random.Generator, t: Array, slowest: float) -> Array:
    """Return a slow smooth path within -1..1 in both directions, with periods from `slowest` down to a fifth of it."""
    out = sum(
        np.sin(2.0 * np.pi * t / period + rng.uniform(0.0, 6.28)) * period
        for period in slowest * np.array([1.0, rng.uniform(0.4, 0.7), rng.uniform(0.2, 0.35)])
    )
    return np.asarray(out) / np.max(np.abs(out))
