"""Estimate two delays of the drive: the delay of its torque after the command, and the lag of its reported velocity.

The command is computed from a measurement, starts to act D periods after it, and is held for one period. The drive's
torque loop follows with a lag. The total time from a measurement to the middle of the resulting torque is

    delay = D T + T/2 + lag

Lead and damping of the control law compensate this delay. D is not always an integer, because a drive may apply a
command when it arrives. D and the lag are fitted to the samples of the reported torque and the command.

The velocity of an encoder is filtered. A loop that uses it therefore reverses its friction term late. If the friction
reverses immediately (in a sheath that bends at the joint), the logs show this lag: it has the least prediction error
over all samples. Source: `velocity_lag` in the catalogue.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import BLOCKS, Quantity, jackknife_half_width
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict

FloatArray = NDArray[np.float64]

MOST = 12  # periods; a drive with a longer delay is unsuitable for a torque loop
LAGS = (*(0.05 * n for n in range(1, 14)), 0.75, 0.85, 1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0)  # periods, tried lags
TRANSPORT_STEP = 0.02  # periods between two tried values of D
AROUND = 2.5  # periods of the search on each side of the delay with the largest correlation
AS_GOOD = 9.0  # times the variance: the 99 % quantile of chi^2 with two degrees of freedom
RESOLUTION = 0.05  # of a period, added on each side of an interval, because the instant of the drive's cycle is unknown
EXPLAINED = 0.8  # least explained share of the reported torque's variance, below which it does not follow the command
EFFECT = "velocity_lag"
LAG_STEP = 0.25e-3  # s between two tried lags
MOST_LAG = 0.02  # s; an encoder with a longer lag is unsuitable for a torque loop
CLEARLY_BETTER = 0.8  # of the error without a lag: the error with a lag must be smaller


@dataclass(frozen=True)
class Delay:
    """The delay of the torque.

    Attributes:
        transport: transport delay D, periods.
        lag: lag of the torque loop, s.
        delay: total delay, s.
    """

    transport: float
    lag: float
    delay: Quantity


def torque_of(command: FloatArray, transport: float, lag: float) -> FloatArray:
    """Return the torque (n,) at the samples for a command (n,) in the same unit.

    `transport` and `lag` are in periods.
    """
    whole = math.floor(transport)
    part = transport - whole  # share of a period in which the previous command still acts
    kept, kept_late = math.exp(-1.0 / lag), math.exp(-(1.0 - part) / lag)
    taps = np.zeros(whole + 3)
    taps[whole + 1], taps[whole + 2] = 1.0 - kept_late, kept_late - kept
    answer: FloatArray = lfilter(taps, [1.0, -kept], command)
    return answer


def command_delay(logs: Sequence[Dataset]) -> Delay | None:
    """Return the delay from logs with tau_m_cmd and tau_m, or None if the torque does not follow the command.

    The command should change quickly. The interval contains every sum of D and lag that explains the torque as well as
    the best one. If the torque loop settles before the torque is measured, the instant within the period is not
    identifiable, and the interval contains all possible instants.
    """
    pairs = [(log["tau_m_cmd"], log["tau_m"]) for log in logs]
    period = logs[0].period
    skip = 4 * MOST  # samples after which the unknown state at the start of a log has no effect

    def left(transport: float, lag: float) -> float:
        return sum(float(np.sum(np.square((torque_of(u, transport, lag) - y)[skip:]))) for u, y in pairs)

    whole = _likely(pairs)
    transports = np.arange(max(0.0, whole - AROUND), whole + AROUND, TRANSPORT_STEP)
    squares = np.array([[left(transport, lag) for lag in LAGS] for transport in transports])
    wanted = np.concatenate([y[skip:] for _, y in pairs])
    least = float(squares.min())
    if least > (1.0 - EXPLAINED) * float(np.sum(np.square(wanted - wanted.mean()))):
        return None
    as_good = squares <= least * (1.0 + AS_GOOD / wanted.size)
    totals = (transports[:, None] + 0.5 + np.array(LAGS))[as_good]
    low, high = float(totals.min()), float(totals.max())
    total = 0.5 * (low + high)
    best = np.unravel_index(int(np.argmin(squares)), squares.shape)
    lag = LAGS[int(best[1])]
    return Delay(
        total - 0.5 - lag,
        period * lag,
        Quantity(period * total, period * (low - RESOLUTION), period * (high + RESOLUTION), "s"),
    )


def _likely(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> int:
    """Return the number of periods with the largest correlation of command and torque."""
    steps = [(np.diff(u), np.diff(y)) for u, y in pairs]
    scores = [sum(float(u[: -1 - whole] @ y[whole + 1 :]) for u, y in steps) for whole in range(MOST + 1)]
    return int(np.argmax(scores))


def with_lag(model: TendonSheath, lag: float) -> TendonSheath:
    """Return the model with a velocity lag of `lag` s."""
    return model.with_effects({**model.effects, EFFECT: {"time_constant": lag}})


def velocity_lag(logs: Sequence[Dataset], model: TendonSheath) -> Quantity | None:
    """Return the velocity lag (s) with the least prediction error, without the mean error of each log.

    The result is None if the model already has a lag, if no lag is clearly better than none, or if the best lag is the
    longest tried one. The interval follows from a jackknife over time blocks. It is at least as wide as the search
    steps.
    """
    if EFFECT in model.effects:
        return None
    lags = np.arange(0.0, MOST_LAG + LAG_STEP / 2.0, LAG_STEP)
    squares = np.array(
        [_squares(logs, with_lag(model, float(lag)) if lag else model) for lag in lags]
    )  # (lags, blocks)
    total = squares.sum(axis=1)
    best = int(np.argmin(total))
    if best in (0, lags.size - 1) or total[best] > CLEARLY_BETTER**2 * total[0]:
        return None
    without = lags[np.argmin(total[:, None] - squares, axis=0)]
    half = max(LAG_STEP, jackknife_half_width(without))
    value = float(lags[best])
    return Quantity(value, max(0.0, value - half), value + half, "s")


def _squares(logs: Sequence[Dataset], model: TendonSheath) -> FloatArray:
    """Return the sums of the squared prediction error over time blocks, (m,)."""
    sums = []
    for log in logs:
        error = predict(model, log.signals()) - log["tau_j"]
        error -= error.mean()
        sums += [float(np.sum(np.square(part))) for part in np.array_split(error, BLOCKS)]
    return np.array(sums)
