"""Gain margin of the predictive damping: by what factor its gain may grow before the motor's swing does.

The loop is linear while the tendons slide: the motor (J_M on K), the drive's torque loop (a lag), the hold over a
period, whole periods of delay, and `damping` with its slow mean. Its matrix over one period is exact (matrix
exponential), and it is stable while no eigenvalue lies outside of the unit circle. Friction is left out: it only damps,
and a joint at rest lets the motor ring less (its swing moves the slip front, which takes it). Used before the loop
starts, never in it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.control.damping import FORGET

LAG = 0.5e-3  # s, torque loop of a drive; those of the known ones are faster
LEAST = 2.0  # margin that is asked for
STIFFNESS = (0.8, 1.0, 1.25)  # of the model's: as far as tendons are known before they are measured
SHARE = 0.32  # of sqrt(K J_M) that a gain needs at most: a sixth of critical, then a swing lasts two periods
WORTH = 0.05  # of sqrt(K J_M); below it damping is not worth its noise
_MOST = 64.0
_OUTSIDE = 1.0 + 1e-9


def gain_margin(gain: float, inertia: float, stiffness: float, delay: float, period: float) -> float:
    """The least margin over `STIFFNESS`; 0 when the loop is unstable as it is.

    `gain` in N*m*s/rad, `inertia` J_M in kg*m^2, `stiffness` K in N*m/rad; `delay`: all of it from a measurement to the
    torque that acts, in s, half a period of hold and the torque loop included.
    """
    return min(_margin(gain, inertia, share * stiffness, stiffness, delay, period) for share in STIFFNESS)


def largest_gain(inertia: float, stiffness: float, delay: float, period: float) -> float:
    """The gain (N*m*s/rad) that damps as much as is useful and keeps the margin; 0 where none is worth having."""
    scale = math.sqrt(stiffness * inertia)
    gain = SHARE * scale
    margin = gain_margin(gain, inertia, stiffness, delay, period)
    while margin < LEAST:
        gain *= 0.9 if margin == 0.0 else margin / LEAST * 0.999
        if gain < WORTH * scale:
            return 0.0
        margin = gain_margin(gain, inertia, stiffness, delay, period)
    return gain


def _margin(gain: float, inertia: float, stiffness: float, believed: float, delay: float, period: float) -> float:
    def stable(factor: float) -> bool:
        step = loop_matrix(factor * gain, inertia, stiffness, believed, delay, period)
        return float(np.abs(np.linalg.eigvals(step)).max()) <= _OUTSIDE

    if not stable(1.0):
        return 0.0
    low = high = 1.0
    while stable(high):
        if high > _MOST:
            return _MOST
        low, high = high, 1.3 * high
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def loop_matrix(
    gain: float, inertia: float, stiffness: float, believed: float, delay: float, period: float
) -> NDArray[np.float64]:
    """The closed loop over one period: angle, speed, torque of the motor; commands on their way; the slow mean.

    `believed`: the stiffness that the prediction works with.
    """
    ringing = math.sqrt(believed / inertia)
    cosine, sine = math.cos(ringing * delay), ringing * math.sin(ringing * delay)
    late = max(0.0, (delay - LAG - 0.5 * period) / period)  # periods between measurement and the hold's begin
    whole = math.ceil(late - 1e-9)
    part = whole - late  # of a period that the newest of two commands acts
    motor = np.array([[0.0, 1.0, 0.0], [-stiffness / inertia, 0.0, 1.0 / inertia], [0.0, 0.0, -1.0 / LAG]])
    push = np.array([[0.0], [0.0], [1.0 / LAG]])
    first, first_push = _held(motor, push, period * (1.0 - part))
    second, second_push = _held(motor, push, period * part)
    size = 3 + whole + 1
    step = np.zeros((size, size))
    step[:3, :3] = second @ first
    command = np.zeros(size)
    forget = period / (FORGET + period)
    command[0] = gain * sine * (1.0 - forget)
    command[1] = -gain * cosine
    command[-1] = -gain * sine * (1.0 - forget)
    sent = [command, *(np.eye(size)[3 + i] for i in range(whole))]  # newest first
    step[:3, :] += second @ first_push * sent[whole] + second_push * sent[max(0, whole - 1)]
    for i in range(whole):
        step[3 + i] = sent[i]
    step[-1, 0], step[-1, -1] = forget, 1.0 - forget
    return step


def _held(
    motor: NDArray[np.float64], push: NDArray[np.float64], time: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition of the motor's state over `time` s under a constant command, and what the command adds."""
    from scipy.linalg import expm  # slow to import

    block = np.zeros((4, 4))
    block[:3, :3], block[:3, 3:] = motor, push
    whole = expm(block * time)
    return whole[:3, :3], whole[:3, 3:]
