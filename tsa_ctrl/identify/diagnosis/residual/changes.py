"""Test the residual for changes in time: steps, periodic parts, slow drift and bursts.

No function of the signals shows these changes. Steps and periodic parts are searched for in the residual itself and in
its parts proportional to the direction and to the load. For example, a pretension that drops or oscillates changes only
the part proportional to the direction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import LEAST_SHARE
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.three_errors import CONTINUED
from tsa_ctrl.model.functions import Array

STEP_TIMES = 60  # possible times of a step in all runs, at least 12 in each: a single run is resolved to 2 %
STEP_MARGIN = 0.06  # share of the run excluded at either end: a step there is an end effect without two levels
CHANCE = 1e-4  # probability of a false finding per test: with three tests, one log in 3,000 has one
LINE_BAND = (0.1, 25.0)  # Hz: at least two cycles in 20 s, and low enough for little aliasing at the score rate
BURST = 0.25  # s, length of a burst: a reversal with its presliding
BURST_SHARE = 0.03  # largest share of the time that bursts may take: more would not be a burst
# Least share of the mean square in the bursts, beyond the share for pure noise: in a picture, a reader notices bursts
# of this size first
BURST_ENERGY = 0.12
DRIFT = "a slow drift"  # its share refers to the mean square of the noise, without whitening
REFERENCE_BAND = (0.4, 5.0)  # Hz: the noise is extrapolated from here downwards; noise.autoregressive begins at 0.7 Hz
DRIFT_SHARE = 0.55  # least drift relative to the noise RMS: a user does not notice less than a third of the noise power
# Least ratio of the slow power to the extrapolated noise: an exponent that is off by 0.3 may cause a factor of 2
DRIFT_RATIO = 4.0


def steps(problem: Problem, residual: Array, jacobian: Array, factors: Mapping[str, Array], noise: Array) -> Finding:
    """Return the most significant step in time: a jump of one of the `factors` at one moment of one run.

    Args:
        problem: the logs with the noise model.
        residual: white residual, (m,).
        jacobian: white columns that do not count as structure, (m, p).
        factors: signals at the score rate by name, (n,): a constant, the direction and the load.
        noise: random normal numbers, (m, DRAWS).
    """
    slices = problem.frame.slices
    times = [run.count * run.period for run in problem.frame.runs]
    columns, labels = [], []
    for number, part in enumerate(slices):
        count = part.stop - part.start
        margin = max(2, round(STEP_MARGIN * count))
        for at in np.unique(
            np.linspace(margin, count - margin, max(12, STEP_TIMES // len(slices))).round().astype(int)
        ):
            for name, factor in factors.items():
                column = np.zeros(len(factor))
                column[part.start + at : part.stop] = factor[part.start + at : part.stop]
                columns.append(column)
                labels.append((number, at / count * times[number], name))
    stacked = np.column_stack(columns)
    del columns  # for a log of one hour, each of these arrays takes 100 MB
    white = problem.whiten(stacked)
    del stacked
    basis = orthonormal(jacobian)
    white -= basis @ (basis.T @ white)
    rest = residual - basis @ (basis.T @ residual)
    norms = np.linalg.norm(white, axis=0)
    used = norms > 0.02 * float(norms.max())
    white = white[:, used] / norms[used]
    found = (white.T @ rest) ** 2
    draws = np.max((white.T @ noise) ** 2, axis=0)
    scale = float(np.std(draws)) * np.sqrt(6.0) / np.pi
    limit = float(np.mean(draws)) - 0.5772 * scale - scale * np.log(CHANCE)
    best = int(np.argmax(found))
    run, moment, name = [label for label, use in zip(labels, used, strict=True) if use][best]
    where = f" of log {run + 1}" if len(slices) > 1 else ""
    share = float(found[best]) / float(rest @ rest)
    return Finding(
        f"a step in {name} at {moment:.1f} s{where}",
        share,
        float(np.sqrt(found[best])),
        bool(found[best] > limit and share > LEAST_SHARE),
    )


def lines(residual: Array, factors: Mapping[str, Array], mask: NDArray[np.bool_], period: float) -> Finding:
    """Return the strongest periodic part: one line in the spectrum of the white residual (m,) times a factor (m,).

    mask: the samples of the residual, (n,). The other samples are filled with 0, which keeps the phase of an
    oscillation across gaps.
    """
    best = Finding("a periodic part", 0.0, 0.0, False)
    frequency = np.fft.rfftfreq(len(mask), period)
    inside = (frequency > LINE_BAND[0]) & (frequency < LINE_BAND[1])
    for name, factor in factors.items():
        signal = residual * factor / max(float(np.sqrt(np.mean(factor**2))), 1e-12)
        whole = np.zeros(len(mask))
        whole[mask] = signal
        power = np.abs(np.fft.rfft(whole)) ** 2 / max(float(signal @ signal), 1e-300)
        power = np.where(inside, power, 0.0)
        local = np.array([np.median(part) for part in np.array_split(power[inside], max(1, inside.sum() // 40))])
        level = np.interp(
            np.arange(int(inside.sum())), (np.arange(len(local)) + 0.5) * (inside.sum() / len(local)), local
        )
        ratio = power[inside] / np.maximum(level / np.log(2.0), 0.3 / len(residual) * 2.0)
        at = int(np.argmax(ratio))
        share = 2.0 * float(np.sum(power[inside][max(0, at - 1) : at + 2])) / len(residual)
        score = float(ratio[at])
        if score > best.score:
            what = f"a part in {name} that oscillates at {frequency[inside][at]:.2g} Hz"
            best = Finding(what, share, score, score > -np.log(CHANCE / max(inside.sum(), 1)) and share > LEAST_SHARE)
    return best


def bursts(residual: Array, period: float) -> Finding:
    """Return the finding of bursts: short periods with far more than their share of the mean square.

    residual: white residual, (m,). period: period of its samples, s.
    """
    length = max(3, round(BURST / period))
    count = len(residual) // length
    energy = np.sort(np.sum(residual[: count * length].reshape(count, length) ** 2, axis=1))[::-1]
    top = max(1, round(BURST_SHARE * count))
    share = float(energy[:top].sum() / max(energy.sum(), 1e-300)) - top / count * 1.6
    typical = float(np.median(energy))
    score = float(energy[0]) / max(typical, 1e-300)
    return Finding("bursts of large errors", share, score, share > BURST_ENERGY and score > 8.0)


def drift(
    residual: Array,
    mask: NDArray[np.bool_],
    slices: Sequence[slice],
    period: float,
    rms: float,
    factors: Sequence[Array] = (),
) -> Finding:
    """Return the finding of slow drift beyond the extrapolated 1/f noise.

    Args:
        residual: residual without whitening, with interpolated gaps, (n,) in N*m.
        mask: samples that count, (n,). Logs without any, and logs of fewer than 64 samples, are ignored.
        slices: place of each log among the samples.
        period: period of the samples, s.
        rms: RMS of the noise, N*m.
        factors: signals whose constant multiples do not count as drift, (n,) each. An error of the gain follows a slow
            load at low frequencies.
    """
    excess, expected, slowly, whole, lines_ = 0.0, 0.0, 0.0, 0.0, 0
    apart = residual
    if factors and mask.any():
        columns = np.column_stack(factors)
        apart = residual - columns @ np.linalg.lstsq(columns[mask], residual[mask], rcond=None)[0]
    for part in slices:
        y = residual[part]
        if not mask[part].any() or len(y) < 64:
            continue
        y = (y - y.mean()) * np.hanning(len(y))
        frequency = np.fft.rfftfreq(len(y), period)
        power = np.abs(np.fft.rfft(y)) ** 2 / (0.375 * len(y) ** 2) * 2.0
        band = (frequency > REFERENCE_BAND[0]) & (frequency < REFERENCE_BAND[1])
        slow = (frequency > 0.0) & (frequency < 0.2)
        if band.sum() < 16 or not slow.any() or not power[band].all():  # no spectrum to fit
            continue
        x = np.log(frequency[band])
        slope, level = np.polyfit(x, np.log(power[band]) + 0.5772, 1)
        slope = min(0.0, max(slope, -CONTINUED))
        level = float(np.mean(np.log(power[band]) + 0.5772 - slope * x))
        expected += float(np.sum(np.exp(level + slope * np.log(np.maximum(frequency[slow], 0.2)))))
        excess += float(np.sum(power[slow]))
        other = np.abs(np.fft.rfft((apart[part] - apart[part].mean()) * np.hanning(len(y)))) ** 2
        slowly, whole = slowly + float(np.sum(other[slow])), whole + float(np.sum(other))
        lines_ += int(slow.sum())
    if lines_ == 0 or expected <= 0.0:
        return Finding(DRIFT, 0.0, 0.0, False)
    ratio = excess / expected
    share = min((excess - expected) / rms**2, 1.0)  # the drift may exceed the noise
    of_residual = slowly / max(whole, 1e-300)
    sure = ratio > DRIFT_RATIO + 6.0 / np.sqrt(lines_)
    found = bool(sure and share > DRIFT_SHARE**2 and of_residual > LEAST_SHARE)
    return Finding(DRIFT, share, ratio, found, of_residual)
