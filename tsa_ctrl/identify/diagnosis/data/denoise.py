"""Remove most of the noise of a log's signals by zero-phase low-passes, which cut off where the noise floor begins.

Angles and velocities are low-passed before they enter the model, because the sign of a noisy velocity is wrong near
every standstill. The motor torque is hardly filtered, and not at all near its steps. If a drive compensates friction,
this torque jumps at the reversals, and the response of a filter to these jumps looks like a lag of the sensor.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.criteria import LOWEST_CUTOFF, REVERSAL, VELOCITY_BAND
from tsa_ctrl.identify.motion import SURE, directed, with_sure_signs
from tsa_ctrl.identify.smoothing import Smoothed
from tsa_ctrl.identify.smoothing.averaged import band_densities, bands, plateau
from tsa_ctrl.identify.smoothing.smoother import TOP
from tsa_ctrl.model.effects.memory import resolution
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import Signals, low_pass

MARGIN = 8.0  # ratio of spectral density to noise floor above which a frequency counts as motion
SEGMENT = 4.0  # s, length of one periodogram
SHARP = 100.0  # Hz, cut-off of the motor torque; also the highest cut-off of angles
STEEP = 3.0  # times the rate of change that is exceeded for a fifth of the time
STEP_MARGIN = 0.04  # s, around a step, in which it is neither slow nor noise after the filter
STANDSTILL = 0.05  # s at velocity 0 after which the joint is at standstill
JUMP = 7.0  # standard deviations of the velocity noise: noise alone does not reach this
STEP_NOISE = 0.4  # standard deviation of a velocity near 0, in steps of its resolution
DERIVED = (("q_j", "omega_j"), ("q_m", "omega_m"))  # angles, and the velocities derived from them unless recorded


def denoised(log: Dataset) -> tuple[Signals, float, Array]:
    """Return the denoised signals, the remaining noise of the joint velocity (rad/s), and its error (n,).

    A plain drive has one velocity, which is used instead of the joint velocity. An acceleration keeps its own low-pass.
    """
    signals = log.signals()
    clean: dict[str, Any] = {}
    noise, error = 0.0, np.zeros(len(log))
    if log.period * SHARP < 0.21:
        steps = steps_of(signals.tau_m, log.period)
        clean["tau_m"] = np.where(steps, signals.tau_m, low_pass(signals.tau_m, log.period, SHARP))
    for angle, velocity in DERIVED:
        if velocity in log.derived:  # the same low-pass as for the angle: both reverse at the same time
            found = log.motion.smoothed(angle)
            clean[angle] = found.value
            if _is_the_joint(log, velocity):
                noise, error = _uncertain(found, log.period)
    for name in ("omega_j", "omega_m", "q_j", "q_m"):
        column = getattr(signals, name)
        if column is None or name in clean or name in log.derived or (name not in log and "omega_m" in log.derived):
            continue
        highest = VELOCITY_BAND if name.startswith("omega") else SHARP
        smooth, left, cutoff = _low_passed(column, log.period, highest)
        if name == "omega_j":
            if cutoff is not None:
                left = max(left, _averaged(column, log.period, cutoff))
            at_ends = 0.0 if cutoff is None else _at_ends(column, smooth, log.period, cutoff)
            as_it_is = _about_standstill(column, log.period) | _about_jumps(column - smooth, log.period)
            smooth = np.where(as_it_is, column, smooth)
            noise = max(left, STEP_NOISE * _count(column))
            error = np.hypot(np.hypot(noise, _distortion(smooth, log.period, highest)), at_ends)
            smooth, error = _turned_once(smooth, column, log.period, noise, error)
        clean[name] = smooth
    return dataclasses.replace(signals, **clean), noise, error


def steps_of(y: Array, period: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the samples near a step of a torque `y` (n,), where it changes much faster than usual."""
    rate = np.abs(np.gradient(low_pass(y, period, LOWEST_CUTOFF)))
    steep = rate > STEEP * np.quantile(rate, 0.8)
    return np.asarray(maximum_filter1d(steep, 2 * round(STEP_MARGIN / period) + 1, mode="constant"))


def denoised_within(log: Dataset, band: float) -> tuple[dict[str, Array], tuple[float, Array] | None]:
    """Return the changed angles and velocities by name, (n,) each, if derived motion is limited to `band` Hz.

    The second value is the changed noise and error of the joint velocity as in `denoised`, or None if they are
    unchanged. A signal whose own cut-off is lower is not changed.
    """
    clean: dict[str, Array] = {}
    uncertain = None
    for angle, velocity in DERIVED:
        own = log.motion.smoothed(angle) if velocity in log.derived else None
        if own is None or (found := own.within(band)) is own:
            continue
        clean[angle], clean[velocity] = found.value, directed(found)
        if _is_the_joint(log, velocity):
            uncertain = _uncertain(found, log.period)
    return clean, uncertain


def _is_the_joint(log: Dataset, velocity: str) -> bool:
    return velocity == "omega_j" or "omega_j" not in log


def _uncertain(found: Smoothed, period: float) -> tuple[float, Array]:
    """Return the noise (a number) and the error (n,) of a derived velocity in rad/s."""
    noise = found.errors[1]
    bent = 0.0 if found.smooth is None else _distortion(found.rate, period, found.smooth.cutoff)
    return noise, np.hypot(noise, bent) + np.zeros(len(found.raw))


def _turned_once(smooth: Array, omega: Array, period: float, noise: float, error: Array) -> tuple[Array, Array]:
    """Return a recorded velocity without sign changes due to noise, and its error, which is at least the speed there.

    With these sign changes, friction would reverse repeatedly in slow motion. The angle (the integral of `omega`) shows
    the true reversals.
    """
    if noise <= 0.0 or not bool(np.any(np.abs(smooth) > SURE * noise)):
        return smooth, error
    out = with_sure_signs(smooth, np.cumsum(omega) * period, noise, 0.0, 0.0)
    return out, np.where(np.abs(smooth) > SURE * noise, error, np.maximum(error, np.abs(smooth)))


def _about_standstill(omega: Array, period: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of long standstills and their surroundings, where a filter would ring across velocity 0."""
    still = omega == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    margin = round(REVERSAL / period)
    out = np.zeros(len(omega), dtype=np.bool_)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if (stop - start) * period > STANDSTILL:
            out[max(0, start - margin) : stop + margin] = True
    return out


def _about_jumps(taken: Array, period: float) -> NDArray[np.bool_]:
    """Return a mask (n,) around jumps of a velocity, where the filter removes far more than noise and distorts them."""
    noise = float(np.median(np.abs(taken))) / 0.6745
    jumped = np.abs(taken) > JUMP * noise if noise > 0.0 else np.zeros(len(taken), dtype=np.bool_)
    margin = min(round(0.5 * REVERSAL / period), (len(taken) - 1) // 2)
    return np.asarray(np.convolve(jumped, np.ones(2 * margin + 1), mode="same") > 0.5)


def _count(omega: Array) -> float:
    """Return the resolution of a recorded velocity in rad/s, or 0 if its values lie on no grid."""
    values = np.unique(omega)
    return resolution(omega) if len(values) < 0.2 * len(omega) else 0.0


def _low_passed(y: Array, period: float, highest: float) -> tuple[Array, float, float | None]:
    """Return `y` low-passed where its spectrum reaches the noise, the remaining noise, and the cut-off in Hz.

    The remaining noise is a standard deviation. If the cut-off would be near half the rate, `y` is returned unchanged,
    and the cut-off is None. `highest`: highest permitted cut-off, Hz.
    """
    if len(y) < 128 or not np.ptp(y) > 0.0:
        return y, 0.0, None
    frequency, density, edge, floor = _spectrum(y, period)
    cutoff = min(highest, max(LOWEST_CUTOFF, 1.5 * edge))
    if cutoff > 0.2 / period:
        return y, float(np.sqrt(floor * 0.5 / period)), None
    passed = density[(frequency > 0.5 * cutoff) & (frequency < cutoff)]  # averaged noise is lower above the cut-off
    floor = max(floor, float(np.median(passed))) if passed.size else floor
    return low_pass(y, period, cutoff), float(np.sqrt(floor * cutoff)), cutoff


def _at_ends(y: Array, smooth: Array, period: float, cutoff: float) -> Array:
    """Return the noise remaining at both ends (n,), where the low-pass depends mainly on the first and last sample."""
    first = np.zeros(len(y))
    first[0] = 1.0
    share = low_pass(first, period, cutoff)  # weight of the first sample's noise
    return np.asarray(float(np.std(y - smooth)) * np.hypot(share, share[::-1]))


def _averaged(y: Array, period: float, cutoff: float) -> float:
    """Return the noise after a low-pass at `cutoff` Hz if the drive has averaged the signal, and 0 otherwise.

    An averaged signal has more noise below the cut-off than its higher frequencies indicate.
    """
    measured, _ = band_densities(y, period)
    level, shape = plateau(measured, len(y), period, TOP)
    if float(shape.min()) == 1.0:
        return 0.0
    edges = bands(len(y), period)
    gain = 1.0 / (1.0 + (np.sqrt(edges[1:] * edges[:-1]) / cutoff) ** 4)  # gain of model.signals.low_pass
    return float(np.sqrt(level * np.sum(shape * gain**2 * np.diff(edges))))


def _distortion(smooth: Array, period: float, cutoff: float) -> Array:
    """Return the local RMS (n,) of the motion that a low-pass at `cutoff` Hz removes from a signal.

    It is estimated by the part that a second pass of the filter removes.
    """
    taken = (smooth - low_pass(smooth, period, cutoff)) ** 2
    return np.sqrt(np.maximum(low_pass(taken, period, 0.5 * cutoff), 0.0))


def _spectrum(y: Array, period: float) -> tuple[Array, Array, float, float]:
    """Return frequencies (Hz), density per Hz, the frequency above which noise hides the signal, and its density."""
    length = min(len(y), round(SEGMENT / period))
    window = np.hanning(length)
    slope = np.linspace(0.0, 1.0, length)
    parts = []
    for start in range(0, len(y) - length + 1, max(1, length // 2)):
        piece = y[start : start + length]
        piece = piece - (piece[0] + (piece[-1] - piece[0]) * slope)
        parts.append(np.abs(np.fft.rfft(window * piece)) ** 2)
    density = 2.0 * period * np.mean(parts, axis=0) / float(window @ window)
    frequency = np.asarray(np.fft.rfftfreq(length, period), dtype=np.float64)
    top = float(np.median(density[frequency > 0.3 / period]))
    middle = density[(frequency > 0.06 / period) & (frequency < 0.2 / period)]  # averaged noise is lower at the top
    floor = max(top, float(np.quantile(middle, 0.25))) if middle.size else top
    above = np.flatnonzero(density > MARGIN * max(floor, 1e-30))
    return frequency, density, float(frequency[above[-1]]) if above.size else 0.0, floor
