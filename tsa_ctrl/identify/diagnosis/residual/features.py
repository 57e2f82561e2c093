"""Compute families of columns from the signals of the log for the test of the residual.

Each family stands for one statement that a reader can act on ("depends on the joint angle"). Random features cover the
remaining dependences, which are interactions of two or three signals.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import hold_direction, low_pass

RANDOM = 90  # random features: a dozen for each of the signals that they combine
# s, time constants of a memory in the torque, a factor of 2.5 apart: two neighbours reproduce the values between them
HISTORY = (0.02, 0.05, 0.12, 0.3, 0.8, 2.0)
ECHO = 0.4  # s, longest delay of the torque in single steps: it covers delays of a bus and waves in a tendon
DRIVER_CUTOFF = 5.0  # Hz, low-pass filter of the load: it removes the fast noise of the torque
AFTER = (0.01, 0.03, 0.08, 0.2)  # decays after a reversal in s, or in shares of the reach, spaced as closely as HISTORY


def families(frame: Frame, predicted: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Return the columns (n, k) of each family at the score rate, by name.

    predicted: torque of the model, (n,) in N*m.
    """
    drivers = _drivers(frame, predicted)
    sigma = drivers["direction"]
    load = drivers["load"]
    out = {
        "the joint angle": _times(_bumps(drivers["angle"], 12), sigma, load),
        "the speed": _times(_bumps(drivers["speed"], 10), np.abs(load)),
        "the load": _times(_bumps(load, 10), sigma),
        "time and distance after reversals": _after(frame, sigma, load),
        "the torque's past": _history(frame, predicted, sigma),
        "several signals at once": _random(drivers, rng),
    }
    if "temperature" in drivers:
        out["the temperature"] = _times(_bumps(drivers["temperature"], 6), sigma, load)
    if "bending" in drivers:
        out["the bending angle"] = _times(_bumps(drivers["bending"], 6), sigma, load)
    if "motor_angle" in drivers:
        out["the motor angle"] = _times(_bumps(drivers["motor_angle"], 12), sigma)
    return out


def time_family(frame: Frame, sigma: Array, load: Array) -> Array:
    """Return columns for slow changes with time: the constant and cosines of 1 to 11 half periods over each run.

    The shape is (n, 3 k): the columns alone, times the direction `sigma`, and times the load.
    """
    columns = np.zeros((len(frame), 12 * len(frame.runs)))
    for number, (part, run) in enumerate(zip(frame.slices, frame.runs, strict=True)):
        phase = np.pi * (np.arange(run.count) + 0.5) / run.count
        columns[part, 12 * number : 12 * (number + 1)] = np.cos(np.outer(phase, np.arange(12)))
    return _times(columns, sigma, load)


def direction_and_load(frame: Frame, predicted: Array) -> tuple[Array, Array]:
    """Return the direction of motion and the scaled load of every sample, as in the random features, (n,) each."""
    drivers = _drivers(frame, predicted)
    return drivers["direction"], drivers["load"]


def _drivers(frame: Frame, predicted: Array) -> Mapping[str, Array]:
    """Return the signals at the score rate by name, scaled to about +-1.

    The angles, the temperature and the bending angle are also centred.
    """
    sigma = frame.stack([hold_direction(run.signals.omega_j) for run in frame.runs])
    turned = frame.stack([run.angle for run in frame.runs])
    out = {
        "angle": _scaled(turned),
        "speed": _scaled(frame.column("omega_j"), centre=False),
        "load": _scaled(_slow(frame, predicted), centre=False),
        "acceleration": _scaled(frame.stack([run.signals.acceleration for run in frame.runs]), centre=False),
        "direction": sigma,
    }
    for name, column in (("temperature", "temperature"), ("bending", "theta"), ("motor_angle", "q_m")):
        if frame.has(column) and float(np.ptp(frame.column(column))) > 0.0:
            out[name] = _scaled(frame.column(column))
    return out


def _slow(frame: Frame, y: Array) -> Array:
    """Return `y` (n,) after a low-pass filter, because noise in a signal would predict the same noise in the residual.

    If the sampling rate of the logs is low, `y` is returned unchanged.
    """
    if frame.runs[0].raw.rate * 0.2 < DRIVER_CUTOFF:
        return y
    return np.concatenate([low_pass(y[part], frame.period, DRIVER_CUTOFF) for part in frame.slices])


def _scaled(x: Array, centre: bool = True) -> Array:
    low, high = np.quantile(x, [0.02, 0.98])
    middle = 0.5 * (low + high) if centre else 0.0
    span = max(abs(high - middle), abs(low - middle), 1e-12)
    return np.asarray(np.clip((x - middle) / span, -1.5, 1.5))


def _bumps(x: Array, count: int) -> Array:
    """Return `count` Gaussian functions of `x` (n,), centred at its quantiles, (n, count)."""
    centres = np.quantile(x, (np.arange(count) + 0.5) / count)
    width = 1.2 * max(float(np.median(np.diff(centres))), 0.02)
    widths = np.maximum(np.gradient(centres), 0.3 * width) * 1.2
    return np.asarray(np.exp(-0.5 * ((x[:, None] - centres) / widths) ** 2))


def _times(columns: Array, *factors: Array) -> Array:
    return np.concatenate([columns, *(columns * factor[:, None] for factor in factors)], axis=1)


def _after(frame: Frame, sigma: Array, load: Array) -> Array:
    """Return exponential decays with time and with distance since the last reversal, (n, k)."""
    parts = []
    for run in frame.runs:
        elapsed, distance = run.since_reversal()
        reach = max(0.5 * float(np.ptp(run.angle)), 1e-9)
        decays = [np.exp(-elapsed / time) for time in AFTER] + [np.exp(-distance / (share * reach)) for share in AFTER]
        parts.append(run.average(np.column_stack(decays)))
    columns = np.concatenate(parts)
    return np.concatenate([columns, columns * sigma[:, None], columns * load[:, None]], axis=1)


def _history(frame: Frame, predicted: Array, sigma: Array) -> Array:
    """Return columns for a memory of the torque, (n, k).

    They are the predicted torque and the direction, each minus its first-order lags, and delayed changes of the torque.
    """
    period = frame.period
    steps = max(2, round(ECHO / period))
    stride = max(1, steps // 40)
    columns = []
    for part in frame.slices:
        torque, way = predicted[part], sigma[part]
        own = []
        for time in HISTORY:
            share = np.exp(-period / time)
            own += [torque - _lagged(torque, share), way - _lagged(way, share)]
        change = np.diff(torque, prepend=torque[0])
        own += [np.concatenate([np.zeros(lag), change[: len(change) - lag]]) for lag in range(0, steps, stride)]
        columns.append(np.column_stack(own))
    return np.concatenate(columns)


def _lagged(y: Array, share: float) -> Array:
    """Return `y` (n,) after a first-order lag that keeps `share` of its state from sample to sample.

    The state starts at the first value.
    """
    state, out, new = share * float(y[0]), np.empty(len(y)), 1.0 - share
    for at, value in enumerate(y.tolist()):
        out[at] = level = state + new * value
        state = share * level
    return out


def _random(drivers: Mapping[str, Array], rng: np.random.Generator) -> Array:
    """Return RANDOM cosines of random combinations of one to three signals, every second one times the direction."""
    names = [name for name in drivers if name != "direction"]
    columns = []
    for number in range(RANDOM):
        chosen = rng.choice(names, size=min(int(rng.integers(1, 4)), len(names)), replace=False)
        mixture = sum(rng.normal(0.0, 2.5) * drivers[name] for name in chosen)
        column = np.cos(mixture + rng.uniform(0.0, 2.0 * np.pi))
        columns.append(column * drivers["direction"] if number % 2 else column)
    return np.column_stack(columns)
