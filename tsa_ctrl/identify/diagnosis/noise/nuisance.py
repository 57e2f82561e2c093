"""Compute nuisance columns, which are always projected out: torque errors from an unknown direction of motion.

Near standstill the sign of a noisy velocity is wrong. This is not an effect, but it imitates Stribeck friction and
lags. Two kinds of columns remove it. The first kind is E[sigma(v + eta)] - sigma(v), in closed form for Gaussian eta,
at 1 and 2.5 times the velocity noise. The second kind is one column for the moment of each reversal, which a sampled
velocity determines only to one sample. These columns are many but short, and are stored in short form.

The noise of the measured motor torque is a nuisance too. The coefficient of a noisy regressor is underestimated, and
any effect that can replace it would be identified as a cause. The fast part of the motor torque is mostly noise, so it
is projected out as well. If a drive compensates friction, the motor torque has steps, near which its noise is unknown.
The torque of the model has none then, so its fastest part, which contains no effect, is also projected out.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csc_matrix, csr_matrix
from scipy.special import erf

from tsa_ctrl.identify.diagnosis.criteria import REVERSAL, ROUNDING
from tsa_ctrl.identify.diagnosis.data.denoise import steps_of
from tsa_ctrl.identify.diagnosis.data.direction import intervals
from tsa_ctrl.identify.diagnosis.data.frame import Frame, Run
from tsa_ctrl.identify.diagnosis.hypotheses.base import Base
from tsa_ctrl.identify.diagnosis.noise.autoregressive import Noise
from tsa_ctrl.identify.motion import SURE
from tsa_ctrl.identify.three_errors import UNKNOWN
from tsa_ctrl.model.composition import Stack
from tsa_ctrl.model.effects.memory import TorqueSensorLag, TransportDelay
from tsa_ctrl.model.effects.motor import VelocityLag
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import hold_direction, low_pass

# Factors of the velocity noise: as estimated, and for an estimate that is too low. Without them, 31 of 40 null logs had
# a false Stribeck effect.
NOISE_FACTORS = (1.0, UNKNOWN)
FAST = (0.5, 1.5, 6.0)  # Hz, edges above which the content of the motor torque may be noise
# Hz, edge above which the model's torque is only noise. With the edges of FAST, a viscous coefficient was 18 % low
OF_MODEL = 12.0
FASTEST = (3.0, 12.0, 25.0)  # Hz, additional edges for tests that search only for structure
MOST_COLUMNS = 800  # the cost of a projection grows with its square; further moments share a column
TAIL = 0.05  # share of the maximum of a moment after a slow sensor: smaller values are ignored


@dataclass(frozen=True)
class Moment:
    """One short column: `values` (N*m) from score sample `start` of the stack on, 0 elsewhere."""

    start: int
    values: Array


@dataclass(frozen=True)
class Nuisance:
    """Hold the nuisance columns: `smooth` (n, k) in N*m over all score samples, and the short `moments`."""

    smooth: Array
    moments: tuple[Moment, ...] = ()

    def told(self, count: int) -> NDArray[np.bool_]:
        """Return a mask (count,) of the score samples outside the short columns, where the direction is known."""
        out = np.ones(count, dtype=np.bool_)
        for moment in self.moments:
            out[moment.start : moment.start + len(moment.values)] = False
        return out

    def projection(self, noise: Noise, mask: NDArray[np.bool_], slices: Sequence[slice]) -> Projection:
        """Return the projector that removes all columns from whitened and masked vectors."""
        where = np.cumsum(mask) - 1
        rows, places, data = [], [], []
        used = 0
        for moment in self.moments:
            part = next(part for part in slices if part.start <= moment.start < part.stop)
            start, white = noise.whiten_short(moment.start, moment.values, part)
            inside = mask[start : start + len(white)]
            size = float(np.linalg.norm(white[inside]))
            if size <= 0.0:
                continue
            rows.append(where[start : start + len(white)][inside])
            data.append(white[inside] / size)
            places.append(np.full(int(inside.sum()), used))
            used += 1
        count = int(mask.sum())
        if used:
            short = csc_matrix(
                (np.concatenate(data), (np.concatenate(rows), np.concatenate(places))), shape=(count, used)
            )
            gram = (short.T @ short).toarray() + ROUNDING * np.eye(used)
            bare = Projection(short, cho_factor(gram), np.zeros((count, 0)))
        else:
            bare = Projection(None, None, np.zeros((count, 0)))
        dense = bare.apply(noise.whiten(self.smooth, slices)[mask])
        norms = np.linalg.norm(dense, axis=0)
        columns = dense[:, norms > 1e-6 * max(float(norms.max(initial=0.0)), 1e-12)]
        return Projection(bare.short, bare.factor, np.linalg.qr(columns)[0] if columns.shape[1] else columns)


@dataclass(frozen=True)
class Projection:
    """Remove the nuisance from white vectors (m,) or (m, k) by projection."""

    short: csc_matrix | None
    factor: tuple[Array, bool] | None
    dense: Array  # (m, j) orthonormal, and orthogonal to the short columns

    @cached_property
    def _across(self) -> csr_matrix:
        """Return the short columns as rows; at least one must exist."""
        assert self.short is not None
        return self.short.T

    def apply(self, white: Array) -> Array:
        if self.short is not None and self.factor is not None:
            white = white - self.short @ cho_solve(self.factor, self._across @ white)
        if self.dense.shape[1]:
            white = white - self.dense @ (self.dense.T @ white)
        return np.asarray(white)


def nuisance(frame: Frame, base: Base, model: Model) -> Nuisance:
    """Return nuisance columns in N*m at the score rate; `model` determines the torque that depends on the direction.

    A lag of the velocity and a delay of the torque in `model` shift the times at which the direction is unknown.
    """
    smooth: list[list[Array]] = [[] for _ in NOISE_FACTORS]
    patterns = []
    for run in frame.runs:
        weight = base.direction_weight(model, run.signals)
        omega = _velocity(run, model)
        for column, factor in zip(smooth, NOISE_FACTORS, strict=True):
            column.append(_late(run, _expected(run, omega, weight, factor), model))
        patterns.append(_delayed(run, np.where(uncertain(run, omega), weight, 0.0), model))
    if base.target != "tau_m":
        smooth += [
            [_late(run, part, model) for run, part in zip(frame.runs, fast(frame, e), strict=True)] for e in FAST
        ]
        torques = [fast_part(predict(model, run.signals), run.signals.period, OF_MODEL) for run in frame.runs]
        smooth.append([_late(run, part, model) for run, part in zip(frame.runs, torques, strict=True)])
    columns = np.column_stack([frame.stack(column) for column in smooth])
    moments = _moments(frame, patterns)
    if (lag := model.effects.get("torque_sensor_lag")) is not None:
        moments = _smeared(frame, moments, float(lag["time_constant"]))
    if "backlash" in model.effects:
        moments += _moments(frame, [_engaging(run, model) for run in frame.runs])
    return Nuisance(columns[:, np.linalg.norm(columns, axis=0) > 0.0], moments)


def _engaging(run: Run, model: Model) -> Array:
    """Return the torque (N*m) that backlash withholds, near its changes only, because their time is uncertain."""
    tight = dataclasses.replace(model, effects={k: v for k, v in model.effects.items() if k != "backlash"})
    held = predict(model, run.signals) - predict(tight, run.signals)
    flips = np.flatnonzero(np.diff(held != 0.0))
    out = np.zeros(len(held))
    for flip in flips:
        near = slice(max(0, flip - 1), flip + 3)
        out[near] = held[flip] or held[flip + 1]
    return out


def fast(frame: Frame, edge: float) -> list[Array]:
    """Return the motor torque of each run above `edge` Hz, without its steps, at the compute rate."""
    return [fast_part(run.signals.tau_m, run.signals.period, edge) for run in frame.runs]


def fast_part(y: Array, period: float, edge: float) -> Array:
    """Return a torque (n,) with this period (s) above `edge` Hz, without its steps."""
    level = _without_steps(y, period)
    return np.asarray(level - low_pass(level, period, edge))


def _without_steps(y: Array, period: float) -> Array:
    """Return `y` held constant at its steps, so that only slow changes and noise remain."""
    return np.asarray(y[0] + np.cumsum(np.where(steps_of(y, period), 0.0, np.diff(y, prepend=y[0]))))


def _velocity(run: Run, model: Model) -> Array:
    """Return the joint's true velocity according to the model, rad/s."""
    lag = model.effects.get("velocity_lag")
    if lag is None:
        return run.signals.omega_j
    return VelocityLag(float(lag["time_constant"])).true_velocity(run.signals.omega_j, run.signals.acceleration)


def _late(run: Run, pattern: Array, model: Model) -> Array:
    """Return a pattern of the true torque (n,) as the sensor measures it."""
    for effect in Stack.of(model.effects).sensor:
        pattern = effect.apply(pattern, run.signals.t)
    return pattern


def _delayed(run: Run, pattern: Array, model: Model) -> Array:
    """Return a pattern of the true torque (n,), shifted by the transport delay; a lag would lengthen it."""
    late = model.effects.get("transport_delay")
    return pattern if late is None else TransportDelay(float(late["delay"])).apply(pattern, run.signals.t)


def _smeared(frame: Frame, moments: Sequence[Moment], lag: float) -> tuple[Moment, ...]:
    """Return the short columns as measured by a sensor of time constant `lag` (s), truncated at TAIL of their peak."""
    longest = math.ceil(-math.log(TAIL) * lag / frame.period)
    out = []
    for moment in moments:
        part = next(part for part in frame.slices if part.start <= moment.start < part.stop)
        room = min(longest, part.stop - moment.start - len(moment.values))
        padded = np.concatenate([[0.0], moment.values, np.zeros(max(0, room))])
        values = TorqueSensorLag(lag).apply(padded, np.arange(len(padded), dtype=np.float64) * frame.period)[1:]
        out.append(Moment(moment.start, values))
    return tuple(out)


def _expected(run: Run, omega: Array, weight: Array, factor: float) -> Array:
    """Return weight * (E[sigma(v + eta)] - sigma(v))."""
    width = np.sqrt(2.0) * factor * run.velocity_error
    known = width <= 0.0
    expected = erf(omega / np.where(known, 1.0, width))
    return np.where(known, 0.0, weight * (expected - hold_direction(omega)))


def uncertain(run: Run, omega: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) at the compute rate where the direction is unknown: below the noise and at each reversal."""
    out = np.abs(omega) < UNKNOWN * run.velocity_error
    out |= _by_chance(out, np.abs(omega) > SURE * run.velocity_error, run.signals.period)
    still = np.append(omega == 0.0, False)
    late = np.zeros(len(omega), dtype=np.bool_)
    margin = max(1, round(REVERSAL / run.signals.period))  # an encoder has not counted yet
    for stop in np.flatnonzero(still[:-1] & ~still[1:]):
        late[max(0, stop - margin) : stop + 1] = True
    out &= ~still[:-1] | late  # a standstill is certain, except for its end
    flips = np.flatnonzero(np.diff(hold_direction(omega)) != 0.0)
    out[flips] = True
    out[np.minimum(flips + 1, len(omega) - 1)] = True
    return np.asarray(out)


def _by_chance(unknown: NDArray[np.bool_], sure: NDArray[np.bool_], period: float) -> NDArray[np.bool_]:
    """Return a mask (n,) where only noise interrupts a part of unknown direction.

    The interruption is too short for a motion between two reversals, and none of its samples has a certain direction.
    """
    out = np.zeros(len(unknown), dtype=np.bool_)
    for start, stop in intervals(~unknown):
        out[start:stop] = (stop - start) * period < REVERSAL and not sure[start:stop].any()
    return out


def _moments(frame: Frame, patterns: list[Array]) -> tuple[Moment, ...]:
    """Return one column for each interval in which a pattern is not 0, or several if it is long.

    The number of columns is at most MOST_COLUMNS.
    """
    stretches: list[tuple[int, int, Array]] = []
    for part, run, pattern in zip(frame.slices, frame.runs, patterns, strict=True):
        level = run.average(pattern)
        inside = np.concatenate([[False], level != 0.0, [False]]).astype(np.int8)
        edges = np.flatnonzero(np.diff(inside))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            stretches.append((part.start + int(start), int(stop - start), level[start:stop]))
    pieces = max((length for _, length, _ in stretches), default=1)  # one column for each sample, if they are few
    while pieces > 1 and sum(min(pieces, length) for _, length, _ in stretches) > MOST_COLUMNS:
        pieces -= 1
    stretches = sorted(stretches, key=lambda stretch: -stretch[1])[:MOST_COLUMNS]
    moments = []
    for start, length, level in stretches:
        cuts = np.linspace(0, length, min(pieces, length) + 1).round().astype(int)
        moments += [Moment(start + int(a), level[a:b]) for a, b in pairwise(cuts)]
    return tuple(moments)
