"""What is always projected out: torque errors from a direction that the log does not tell.

Near standstill the sign of a noisy velocity is wrong; that is no effect, but it fakes Stribeck friction and lags. Two
kinds of columns take it out: E[sigma(v + eta)] - sigma(v) (closed form for Gaussian eta) at 1 and 2.5 times the velocity
noise, and one column for each reversal's own moment, which no velocity of finite rate places better than a sample.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from tsa_ctrl.identify.diagnosis.base import Base
from tsa_ctrl.identify.diagnosis.prepare import Frame, Run
from tsa_ctrl.model.effects.memory import TransportDelay
from tsa_ctrl.model.effects.motor import VelocityLag
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model
from tsa_ctrl.model.signals import hold_direction

NOISE_FACTORS = (1.0, 2.5)  # of the velocity noise
UNKNOWN = 2.5  # times the velocity noise: a slower motion has no sure direction
MOST_COLUMNS = 300
MOST_PIECES = 4  # columns for one stretch of unknown direction


def nuisance(frame: Frame, base: Base, model: Model) -> Array:
    """Columns (n, k), N*m at the score rate; `model` gives the torque that hangs on the direction.

    A lag of the velocity and a delay of the torque in `model` move the moments at which the direction is unknown.
    """
    weights = [base.direction_weight(model, run.signals) for run in frame.runs]
    velocities = [_velocity(run, model) for run in frame.runs]
    columns = []
    for factor in NOISE_FACTORS:
        parts = [
            _expected(run, omega, weight, factor)
            for run, omega, weight in zip(frame.runs, velocities, weights, strict=True)
        ]
        parts = [_late(run, part, model) for run, part in zip(frame.runs, parts, strict=True)]
        columns.append(frame.stack(parts))
    smooth = np.column_stack(columns)
    smooth = smooth[:, np.linalg.norm(smooth, axis=0) > 0.0]
    patterns = [
        _late(run, np.where(uncertain(run, omega), weight, 0.0), model)
        for run, omega, weight in zip(frame.runs, velocities, weights, strict=True)
    ]
    return np.column_stack([smooth, _moments(frame, patterns)])


def _velocity(run: Run, model: Model) -> Array:
    """The joint's true velocity by the model, rad/s."""
    lag = model.effects.get("velocity_lag")
    if lag is None:
        return run.signals.omega_j
    return VelocityLag(float(lag["time_constant"])).true_velocity(run.signals.omega_j, run.signals.acceleration)


def _late(run: Run, pattern: Array, model: Model) -> Array:
    """A pattern in the true torque as the sensor shows it."""
    late = model.effects.get("transport_delay")
    return pattern if late is None else TransportDelay(float(late["delay"])).apply(pattern, run.signals.t)


def _expected(run: Run, omega: Array, weight: Array, factor: float) -> Array:
    """weight * (E[sigma(v + eta)] - sigma(v))."""
    width = np.sqrt(2.0) * factor * run.velocity_noise
    if width <= 0.0:
        return np.zeros(len(omega))
    return np.asarray(weight * (erf(omega / width) - hold_direction(omega)))


def uncertain(run: Run, omega: Array) -> NDArray[np.bool_]:
    """Where the direction is not known, (n) at the compute rate: slower than the noise, and beside each reversal."""
    out = np.abs(omega) < UNKNOWN * run.velocity_noise
    out &= omega != 0.0  # a standstill is known to be one
    flips = np.flatnonzero(np.diff(hold_direction(omega)) != 0.0)
    out[flips] = True
    out[np.minimum(flips + 1, len(omega) - 1)] = True
    return np.asarray(out)


def _moments(frame: Frame, patterns: list[Array]) -> Array:
    """One column for each stretch in which a pattern is not 0, more for a long one; at most MOST_COLUMNS."""
    stretches: list[tuple[int, int, int]] = []
    levels = []
    for part, run, pattern in zip(frame.slices, frame.runs, patterns, strict=True):
        level = run.average(pattern)
        levels.append(level)
        inside = np.concatenate([[False], level != 0.0, [False]]).astype(np.int8)
        edges = np.flatnonzero(np.diff(inside))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            stretches.append((part.start + int(start), part.start + int(stop), int(stop - start)))
    level = np.concatenate(levels)
    pieces = MOST_PIECES
    while pieces > 1 and sum(min(pieces, length) for _, _, length in stretches) > MOST_COLUMNS:
        pieces -= 1
    stretches = sorted(stretches, key=lambda s: -s[2])[:MOST_COLUMNS]
    columns = []
    for start, stop, length in stretches:
        cuts = np.linspace(start, stop, min(pieces, length) + 1).round().astype(int)
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            column = np.zeros(len(frame))
            column[a:b] = level[a:b]
            columns.append(column)
    return np.column_stack(columns) if columns else np.zeros((len(frame), 0))
