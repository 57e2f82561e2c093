"""Compute three errors of a simulation: while sliding, in reversals, and the sensor noise, which no model removes.

A model may be correct during sliding and wrong for 20 ms after each reversal. One RMS value does not show this. Every
command uses the three errors of this module.

The sensor noise is estimated from the log alone. A linear regression on motor torque and motion, with separate
coefficients for each direction, is subtracted from the measured torque. Above the frequencies of the motion, the
spectrum of the residual is noise. At lower frequencies the noise is the smaller of the measured spectrum and the
extrapolated spectrum. Noise is the same at all times, so no frequency counts with more than its median over short
segments. Therefore an unknown effect does not count as noise, even if it is as short as a backlash.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.smoothing.averaged import SHORTEST
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import Signals, hold_direction

Mask = NDArray[np.bool_]
Band = tuple[float, float, int]  # mean frequency in Hz, mean density in (N*m)^2, number of spectral lines

AFTER_REVERSAL = 0.020  # s on either side of a reversal: a delay below this value is visible only there
UNKNOWN = 2.5  # times the velocity noise: the direction of a slower motion is not known
ABOVE = 12.0  # times the frequency that bounds the share MOTION of the power: friction has harmonics of the motion
MOTION = 0.99  # share of the velocity's power; the harmonics of reversals contain the rest
HIGHEST = 0.5  # largest share of the band up to half the rate that counts as motion: half of it remains for the noise
CONTINUED = 1.2  # largest exponent of 1/f noise in the extrapolation to low frequencies; electronics have 1
LOWEST = 0.2  # Hz, below which noise counts as flat, because a log of some seconds contains less than one period
BANDS = 6  # number of bands per octave of the smoothed spectrum
SEGMENT = 0.25  # s: at most one reversal of a motion up to 4 Hz, and several periods above its frequencies
FEWEST_SEGMENTS = 8  # a median of fewer is not typical of a log
WHOLE = 0.9  # share of a segment whose direction must be known
# Median over mean of a spectral line, chi^2 with two degrees of freedom (Wilson and Hilferty)
MEDIAN = (1.0 - 1.0 / 9.0) ** 3
LONGEST = 300_000  # most samples for the noise estimate: five minutes at 1 kHz
# Times the sensor noise, RMS; a smaller error while sliding counts as noise. The estimated noise is 0.7 to 1.1 times
# the true one on 38 blind logs, so this is at least 1.4 times the true noise.
MORE_THAN_NOISE = 2.0


@dataclass(frozen=True)
class ThreeErrors:
    """RMS errors in N*m; None if a log has no such samples."""

    sliding: float | None = None
    reversals: float | None = None  # within AFTER_REVERSAL of a reversal, or where the direction is uncertain
    sensor_noise: float | None = None

    def to_dict(self) -> dict[str, float | str | None]:
        """Return the `errors` object of the JSON outputs."""
        return {
            "sliding": self.sliding,
            "reversals": self.reversals,
            "sensor_noise": self.sensor_noise,
            "unit": "N*m",
        }


def three_errors(logs: Sequence[Dataset], residuals: Sequence[Array], target: str) -> ThreeErrors:
    """Return the three errors over all logs, from residuals (n,) in N*m; `target` is the predicted column."""
    known = [known_direction(log) for log in logs]
    noise = [sensor_noise(log, log[target], slides) for log, slides in zip(logs, known, strict=True)]
    return ThreeErrors(
        sliding=_rms([each[slides] for each, slides in zip(residuals, known, strict=True)]),
        reversals=_rms([each[~slides] for each, slides in zip(residuals, known, strict=True)]),
        sensor_noise=pooled(noise, [len(log) for log in logs]),
    )


def pooled(values: Sequence[float | None], counts: Sequence[int]) -> float | None:
    """Return the RMS over several groups from their RMS values and numbers of samples; groups with None are skipped."""
    told = [(value, count) for value, count in zip(values, counts, strict=True) if value is not None]
    total = sum(count for _, count in told)
    return math.sqrt(sum(value**2 * count for value, count in told) / total) if total else None


def known_direction(log: Dataset) -> Mask:
    """Return a mask (n,): True where the direction of motion is certain and no reversal is within AFTER_REVERSAL."""
    omega = log.signals().omega_j
    velocity = "omega_j" if "omega_j" in log else "omega_m"
    if velocity in log.derived:
        noise = log.motion.smoothed(velocity.replace("omega", "q")).errors[1]
    else:
        noise = white_deviation(omega)
    sure = np.abs(omega) > UNKNOWN * noise
    turns = np.flatnonzero(np.diff(hold_direction(omega)) != 0.0)
    changed = np.zeros(len(omega) + 1, dtype=np.int64)  # +1 where a reversal's surroundings begin, -1 after their end
    width = max(1, round(AFTER_REVERSAL / log.period))
    np.add.at(changed, np.maximum(turns + 1 - width, 0), 1)
    np.add.at(changed, np.minimum(turns + 1 + width, len(omega)), -1)
    return np.asarray(sure & (np.cumsum(changed[:-1]) == 0))


def white_deviation(y: Array) -> float:
    """Return the standard deviation of the white noise on a smooth signal, estimated from third differences."""
    third = np.abs(np.diff(y, 3))
    return float(np.median(third)) / 0.6745 / math.sqrt(20.0) if len(third) else 0.0


def sensor_noise(log: Dataset, target: Array, known: Mask) -> float | None:
    """Return the RMS noise of the measured torque `target` (n,), N*m, from the spectrum outside the motion.

    The result is None if too few samples have a known direction (`known`, (n,)).
    """
    count = min(len(log), LONGEST)
    start = (len(log) - count) // 2
    part = slice(start, start + count)
    used = known[part]
    if int(used.sum()) < SHORTEST:
        return None
    signals = log.signals()
    rest = _freed(signals, part, target[part], used)
    frequency = np.asarray(np.fft.rfftfreq(count, log.period), dtype=np.float64)
    window = np.hanning(count)  # keeps slow errors at low frequencies
    # scaled so that the sum over all lines, of both signs, is the mean square
    density = np.square(np.abs(np.fft.rfft(rest * window))) / (used.mean() * count * float(window @ window))
    edge = min(ABOVE * _motion_band(signals.omega_j[part], log.period), HIGHEST * frequency[-1])
    bands = _at_most_typical(_bands(frequency, density), rest, used, log.period)
    return math.sqrt(_below_continued(bands, edge) * 2.0)


def _at_most_typical(bands: Sequence[Band], rest: Array, used: Mask, period: float) -> Sequence[Band]:
    """Limit the density of each band to the median over the segments of `rest` (n,) whose direction is known."""
    length = min(round(SEGMENT / period), len(rest) // FEWEST_SEGMENTS)
    known = np.lib.stride_tricks.sliding_window_view(used, length)[:: length // 2].mean(axis=1) > WHOLE
    if int(known.sum()) < FEWEST_SEGMENTS:
        return bands
    segments = np.lib.stride_tricks.sliding_window_view(rest, length)[:: length // 2][known]
    window = np.hanning(length)
    power = np.square(np.abs(np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window, axis=1)))
    typical = np.median(power, axis=0)[1:] / (MEDIAN * float(window @ window) * len(rest))
    lines = np.fft.rfftfreq(length, period)[1:]
    return [
        (centre, min(density, float(np.interp(centre, lines, typical))) if centre >= lines[0] else density, count)
        for centre, density, count in bands
    ]


def _freed(signals: Signals, part: slice, target: Array, used: Mask) -> Array:
    """Return the torque (n,), N*m, minus its linear part in motor torque and motion, by direction.

    Samples without a known direction (`used` False) are interpolated.
    """
    omega, tau = signals.omega_j[part], signals.tau_m[part]
    angle = np.cumsum(omega) * signals.period if signals.q_j is None else signals.q_j[part]
    angle = (angle - angle.mean()) / max(float(np.std(angle)), np.finfo(np.float64).tiny)
    sigma = hold_direction(omega)
    shapes = [
        np.ones(len(omega)),
        omega,
        signals.acceleration[part],
        angle,
        angle**2,
        np.linspace(-1.0, 1.0, len(omega)),
    ]
    if target is not tau and not np.array_equal(target, tau):
        shapes += [tau, np.abs(tau)]
    for more in (signals.theta, *signals.joints.values(), signals.temperature):
        if more is not None and np.ptp(more[part]) > 0.0:
            own = (more[part] - more[part].mean()) / np.std(more[part])
            shapes += [own] if more is signals.temperature else [own, own**2, own * tau]
    columns = np.column_stack([*shapes, *(sigma * shape for shape in shapes)])
    columns /= np.maximum(np.sqrt(np.mean(columns[used] ** 2, axis=0)), np.finfo(np.float64).tiny)
    factors: Array = np.linalg.lstsq(columns[used], target[used], rcond=None)[0]
    rest = target - columns @ factors
    index = np.arange(len(rest))
    bridged = np.interp(index, index[used], rest[used])  # a step to 0 would add power at all frequencies
    return np.where(used, rest, bridged)


def _motion_band(omega: Array, period: float) -> float:
    """Return the frequency (Hz) below which the share MOTION of the velocity's power lies."""
    power = np.abs(np.fft.rfft(omega - omega.mean())) ** 2
    total = np.cumsum(power)
    if total[-1] <= 0.0:
        return 0.0
    return float(np.fft.rfftfreq(len(omega), period)[int(np.searchsorted(total, MOTION * total[-1]))])


def _bands(frequency: Array, density: Array) -> list[Band]:
    """Return mean frequency, mean density and number of lines of logarithmic bands, without the line at 0 Hz."""
    number = np.floor(BANDS * np.log2(frequency[1:] / frequency[1])).astype(np.int64)
    lines = np.bincount(number)
    centre = np.bincount(number, frequency[1:])
    level = np.bincount(number, density[1:])
    return [(float(c / n), float(d / n), int(n)) for c, d, n in zip(centre, level, lines, strict=True) if n]


def _below_continued(bands: Sequence[Band], edge: float) -> float:
    """Return the sum of the density over all bands, limited below `edge` by the extrapolated slope of higher bands."""
    above = [band for band in bands if band[0] > edge]
    total = sum(density * lines for _, density, lines in above)
    if not above:
        return total
    first = above[0][0]
    near = [band for band in above if band[0] <= 4.0 * first and band[1] > 0.0] or above[:1]
    slope = 0.0
    if len(near) > 2:
        f, d, n = (np.array(each) for each in zip(*near, strict=True))
        slope = float(np.polyfit(np.log(f), np.log(d), 1, w=np.sqrt(n))[0])
    slope = min(0.0, max(slope, -CONTINUED))
    level = float(np.mean([density for _, density, _ in near[:3]]))
    for frequency, density, lines in bands:
        if frequency <= edge:
            continued = level * (max(frequency, LOWEST) / first) ** slope
            total += min(density, continued) * lines
    return total


def _rms(parts: Sequence[Array]) -> float | None:
    count = sum(len(part) for part in parts)
    return math.sqrt(sum(float(part @ part) for part in parts) / count) if count else None
