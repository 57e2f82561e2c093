"""Logs made ready for scoring: denoised inputs at the compute rate, torques averaged to the score rate, blocks.

Averaging is linear and the same for the measured torque and for every prediction, so comparing averages loses nothing
but resolution: a pulse shorter than one average keeps its area. Angles and velocities are low-passed with zero phase
before the model sees them, because the sign of a noisy velocity is wrong near every standstill. The motor torque is
hardly: it jumps with a reversal, and a drive that compensates friction says little else.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.denoise import denoised, distortion
from tsa_ctrl.identify.diagnosis.data.frame import Run
from tsa_ctrl.model.effects.memory import resolution
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import Signals, low_pass

COMPUTE_RATE = 500.0  # Hz at most: reversals are placed to 2 ms
COMPUTE_SAMPLES = 90_000  # of all logs together at most
SCORE_RATE = 125.0  # Hz about: rate at which torques are compared
SCORE_SAMPLES = 12_000  # of all logs together at most
SHARP = 100.0  # Hz, of the motor torque: no lower, for it follows a reversal at once; and of angles at most
VELOCITY_HIGHEST = 40.0  # Hz
ACCELERATION_HIGHEST = 20.0  # Hz, of a velocity that is to be derived
STANDSTILL = 0.05  # s at velocity 0 from which on the joint is taken to stand
RINGING = 0.1  # s beside a standstill or about a jump in which the velocity is left as it is
JUMP = 7.0  # standard deviations of a velocity's noise, that no noise reaches
STEP_NOISE = 0.4  # standard deviation of a velocity near 0 in its steps
DERIVED_CUTOFF = 10.0  # Hz, of the filter that derives a velocity


def prepare(logs: Sequence[Dataset], target: str) -> list[Run]:
    """Denoise and reduce the logs. `target`: the column that the model predicts, "tau_j" or "tau_m"."""
    slowest = min(log.rate for log in logs)
    total = sum(log.seconds for log in logs)
    rate = min(slowest, COMPUTE_RATE, COMPUTE_SAMPLES / total)
    factor = max(1, round(slowest / rate)) if slowest / rate > 1.3 else 1
    bin_ = max(1, round(slowest / factor / min(SCORE_RATE, SCORE_SAMPLES / total)))
    runs = []
    for log in logs:
        full, noise, error = _clean(log)
        if target == "tau_m":
            full = _accelerated(full, log)
        own = factor * max(1, round(log.rate / slowest))
        measured = log[target]
        small = {f.name: getattr(full, f.name) for f in dataclasses.fields(full)}
        signals = Signals(**{name: _means(y, own) for name, y in small.items() if y is not None})
        averages = _means(measured, own), bin_, noise, _means(error, own)
        runs.append(Run(log.name, signals, *averages, log, full, measured, own * bin_))
    return runs


def _means(y: Array, factor: int) -> Array:
    whole = len(y) // factor * factor
    return np.asarray(y[:whole].reshape(-1, factor).mean(axis=1))


def _clean(log: Dataset) -> tuple[Signals, float, Array]:
    """The log's signals denoised, the noise left in the velocity, and its error (n)."""
    signals = log.signals()
    clean: dict[str, Array] = {}
    noise, error = 0.0, np.zeros(len(log))
    # A displacement must turn when the velocity does that was derived from it.
    derived = bool({"omega_j", "omega_m"} & log.derived)
    if log.period * SHARP < 0.21:
        clean["tau_m"] = low_pass(signals.tau_m, log.period, SHARP)
    for name in ("omega_j", "omega_m", "q_j", "q_m"):
        column = getattr(signals, name)
        if column is None:
            continue
        highest = DERIVED_CUTOFF if derived else VELOCITY_HIGHEST if name.startswith("omega") else SHARP
        smooth, left = denoised(column, log.period, highest)
        if name == "omega_j":
            as_it_is = _about_standstill(column, log.period) | _about_jumps(column - smooth, log.period)
            smooth = np.where(as_it_is, column, smooth)
            noise = max(left, STEP_NOISE * _count(log, column))
            error = np.hypot(noise, distortion(smooth, log.period, highest))
        clean[name] = smooth
    return dataclasses.replace(signals, **clean), noise, error


def _accelerated(clean: Signals, log: Dataset) -> Signals:
    """A plain drive's torque is inertia above all: its motion is derived anew, as sharp as its noise allows."""
    angle = clean.q_m if clean.q_m is not None else clean.q_j
    omega = clean.omega_j
    if {"omega_j", "omega_m"} & log.derived and angle is not None:
        omega = np.where(omega == 0.0, 0.0, np.gradient(angle, log.period))
    slow = denoised(omega, log.period, ACCELERATION_HIGHEST)[0]
    return dataclasses.replace(clean, omega_j=omega, acceleration_j=np.gradient(slow, log.period))


def _about_standstill(omega: Array, period: float) -> NDArray[np.bool_]:
    """Where the velocity is exactly 0 for long, and shortly before and after: a filter would ring across 0 there."""
    still = omega == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    margin = round(RINGING / period)
    out = np.zeros(len(omega), dtype=np.bool_)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if (stop - start) * period > STANDSTILL:
            out[max(0, start - margin) : stop + margin] = True
    return out


def _about_jumps(taken: Array, period: float) -> NDArray[np.bool_]:
    """Where the filter took far more than noise from a velocity (n): it jumped, and would come out bent."""
    noise = float(np.median(np.abs(taken))) / 0.6745
    jumped = np.abs(taken) > JUMP * noise if noise > 0.0 else np.zeros(len(taken), dtype=np.bool_)
    margin = min(round(0.5 * RINGING / period), (len(taken) - 1) // 2)
    return np.asarray(np.convolve(jumped, np.ones(2 * margin + 1), mode="same") > 0.5)


def _count(log: Dataset, omega: Array) -> float:
    """One step of the velocity, rad/s: of its own grid, or of the angle's counts through the derivative's filter."""
    angle = "q_j" if "q_j" in log else "q_m"
    if {"omega_j", "omega_m"} & log.derived and angle in log:
        return resolution(log[angle]) * DERIVED_CUTOFF
    values = np.unique(omega)
    return resolution(omega) if len(values) < 0.2 * len(omega) else 0.0
