"""Exactly known motion at 20 kHz, its recording by an encoder at a lower rate, and the best fixed filter.

No code is shared with the package. The motions are tones or noise shaped in the frequency domain, with exact
derivatives. The filters are zero-phase Butterworth filters in the frequency domain, so their derivatives are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Array = NDArray[np.float64]

FINE = 20_000.0  # Hz
RATE = 1_000.0  # Hz, of the log
SIZE = 0.3  # rad, RMS of a motion


@dataclass(frozen=True)
class Recorded:
    """A recorded motion: stamps (s), rounded angle (rad) and encoder step (rad).

    `truth` holds position (rad), velocity (rad/s) and acceleration (rad/s^2) at the stamps.
    """

    t: Array
    q: Array
    step: float
    truth: tuple[Array, Array, Array]


def motion(kind: str, bandwidth: float, seconds: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration at 20 kHz.

    `kind` is "tones" of equal size up to `bandwidth` Hz, or "noise" whose spectrum falls off.
    """
    count = int(seconds * FINE)
    size = 1 << int(np.ceil(np.log2(1.3 * count)))
    frequency = np.fft.rfftfreq(size, 1.0 / FINE)
    if kind == "tones":
        shape = ((frequency > 0.05 * bandwidth) & (frequency <= bandwidth)).astype(np.float64)
    else:
        shape = 1.0 / np.sqrt(1.0 + (3.0 * frequency / bandwidth) ** 8)
        shape[(frequency < 0.1) | (frequency > 2.0 * bandwidth)] = 0.0
    drawn = shape * (rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency)))
    turn = 2j * np.pi * frequency
    position, velocity, acceleration = (np.fft.irfft(drawn * turn**order, size)[:count] for order in range(3))
    scale = SIZE / float(np.std(position))
    return scale * position, scale * velocity, scale * acceleration


def record(
    path: tuple[Array, Array, Array],
    bits: int,
    rng: np.random.Generator,
    late: float = 0.0,
    rate: float = RATE,
) -> Recorded:
    """Return the recording of an encoder with 2^bits counts per turn.

    A share `late` of the rows is 0.2 to 0.8 periods late.
    """
    step, every = 2.0 * np.pi / 2**bits, round(FINE / rate)
    count = len(path[0]) // every - 2
    index = np.arange(count) * every
    delayed = rng.uniform(size=count) < late
    index[delayed] += (rng.uniform(0.2, 0.8, int(delayed.sum())) * every).astype(np.int64)
    offset = rng.uniform(-0.5, 0.5) * step
    counted = np.round((path[0][index] + offset) / step) * step - offset
    return Recorded(index / FINE, counted, step, (path[0][index], path[1][index], path[2][index]))


def filters(rate: float = RATE) -> list[tuple[int, float]]:
    """Return the order of each filter per direction and its cut-off frequency (Hz)."""
    return [(order, float(cutoff)) for order in (2, 4) for cutoff in np.geomspace(1.0, 0.4 * rate, 28)]


def fixed_errors(recorded: Recorded, edge: int, rate: float = RATE) -> Array:
    """Return the mean squared errors of each filter, (filters, 3).

    The signal is extended at both ends by its odd reflection.
    """
    q, more = recorded.q, len(recorded.q) // 4
    longer = np.concatenate([2.0 * q[0] - q[more:0:-1], q, 2.0 * q[-1] - q[-2 : -more - 2 : -1]])
    size = scipy.fft.next_fast_len(len(longer), real=True)
    slope = (longer[-1] - longer[0]) / (len(longer) - 1)
    line = longer[0] + slope * np.arange(len(longer))
    inside = slice(more, more + len(q))
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    spectrum = np.fft.rfft(longer - line, size)
    rows = []
    for order, cutoff in filters(rate):
        passed = spectrum / (1.0 + (frequency / cutoff) ** (2 * order))
        found = [np.fft.irfft(passed * (2j * np.pi * frequency) ** k, size)[inside] for k in range(3)]
        found[0], found[1] = found[0] + line[inside], found[1] + slope * rate
        rows.append(squared_errors(recorded, found, edge))
    return np.array(rows)


def squared_errors(recorded: Recorded, found: list[Array], edge: int) -> Array:
    """Return the mean squared errors of position, velocity and acceleration, (3,).

    The mean error of the position is removed, because the offset of the counts is arbitrary.
    """
    inside = slice(edge, -edge)
    off = [values[inside] - true[inside] for values, true in zip(found, recorded.truth, strict=True)]
    off[0] = off[0] - np.mean(off[0])
    return np.array([float(np.mean(values**2)) for values in off])
