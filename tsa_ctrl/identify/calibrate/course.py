"""Estimate the curvature profile of a sheath from logs with q_m, q_j, tau_m and a joint torque sensor.

Sliding reveals only the centre of the bends. A reversal reveals the rest: its slip front runs from the motor through
one bend after another, and meanwhile its position determines elongation and joint torque. The profile is described by
the positions of `PLACES` equal shares of the bending. The Gauss-Newton method finds these positions, stiffness,
friction and motor inertia with the least error of elongation and joint torque. If the log contains no information, the
positions of the given profile are kept. Modelling two bends with a straight piece between them as one even bend causes
an error of up to 20 mN*m RMS of 300 mN*m on simulated rigs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.calibrate.tendon_log import TendonLog, foretold, varied
from tsa_ctrl.model.curvature import Points, Profile
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import profile_of

FloatArray = NDArray[np.float64]

PLACES = 6  # number of positions; 8 do not improve the result on simulated rigs
SHARES = (np.arange(PLACES) + 0.5) / PLACES  # cumulative shares of the bending, at the middle of equal parts
SPREAD = 0.1  # prior standard deviation of a position, as a share of the length
ALIKE_FOR = 0.1  # s, correlation time of the tendon model's error: samples within it count as one
ROUNDS = 12  # most iterations of the Gauss-Newton method; it usually ends earlier, by `ENOUGH`
ENOUGH = 2e-3  # share of the length: the search ends when all positions move by less
STEPS = (0.01, 0.02, 1e-5, 0.01)  # steps of ln k, ln x, J_M and a position for derivatives: exceed single contacts
MOST = (0.1, 0.1, 1e-4, 0.08)  # largest change of the same parameters in one iteration, so that the search converges
DIGITS = 4  # decimals of a position, more than the logs determine
LEAST, GREATEST = 0.01, 0.97  # permitted range of the centre of the bends in a file


def course_of(places: FloatArray) -> Points:
    """Return the profile through these positions (shares of the length), extended by half a share at each end."""
    low = max(0.0, places[0] - 0.5 * (places[1] - places[0]))
    high = min(1.0, places[-1] + 0.5 * (places[-1] - places[-2]))
    points = [(0.0, 0.0), (low, 0.0), *zip(places, SHARES, strict=True), (high, 1.0), (1.0, 1.0)]
    return tuple(dict.fromkeys((round(float(u), DIGITS), round(float(b), DIGITS)) for u, b in points))


def find_course(logs: Sequence[TendonLog], model: TendonSheath, motor_inertia: float) -> TendonSheath:
    """Return the model with the estimated `bending_course`, stiffness and friction.

    If the centre of the estimated bends is outside the permitted range, the given model is returned.

    Args:
        motor_inertia: kg*m^2, start value of J_M.
    """
    even = np.array(profile_of(model).points)
    begin = np.interp(SHARES, even[:, 1] + 1e-12 * np.arange(len(even)), even[:, 0])
    p = np.concatenate(([0.0, 0.0, motor_inertia], begin))
    step = np.array([*STEPS[:3], *np.full(PLACES, STEPS[3])])
    most = np.array([*MOST[:3], *np.full(PLACES, MOST[3])])
    held = np.eye(PLACES) - 1.0 / PLACES  # no prior on the centre, because the whole log determines it
    for _ in range(ROUNDS):
        rows, rest = _linear(logs, model, p, step)
        seconds = sum(log.stretch.size * log.period for log in logs)
        weight = math.sqrt(ALIKE_FOR * rest.size / seconds) / SPREAD
        prior = np.zeros((PLACES, rows.shape[1]))
        prior[:, 3 : 3 + PLACES] = weight * held
        rest = np.concatenate((rest, prior[:, 3 : 3 + PLACES] @ (begin - p[3:])))
        found = np.linalg.lstsq(np.concatenate((rows, prior)), rest, rcond=None)[0][: p.size]
        change = np.clip(found, -most, most)
        p += change
        p[3:] = np.clip(np.maximum.accumulate(p[3:]), 0.0, 1.0)
        if np.max(np.abs(change[3:])) < ENOUGH:
            break
    return _variant(model, p)


def _variant(model: TendonSheath, p: FloatArray) -> TendonSheath:
    course = Profile(course_of(p[3:]))
    if not LEAST < course.centre < GREATEST:
        return model
    bent = dataclasses.replace(model, bending_course=course.points, bending_centre=course.centre)
    return varied(bent, float(p[0]), course.centre, float(p[1]))


def _linear(
    logs: Sequence[TendonLog], model: TendonSheath, p: FloatArray, step: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return regressors and residuals of one iteration; the last columns are for the zeros of the two channels.

    Regressors and residuals of elongation and joint torque are each divided by the RMS error of the channel.
    """
    parts: tuple[list[tuple[FloatArray, FloatArray]], ...] = ([], [])
    for number, log in enumerate(logs):
        assert log.tau_j is not None
        first = foretold(log, _variant(model, p), float(p[2]))
        columns = np.zeros((2, log.stretch.size, p.size + 2 * len(logs)))
        for place in range(p.size):
            up, down = p.copy(), p.copy()
            up[place] += step[place]
            down[place] -= step[place]
            up[3:], down[3:] = np.clip(up[3:], 0.0, 1.0), np.clip(down[3:], 0.0, 1.0)
            a, b = (foretold(log, _variant(model, side), float(side[2])) for side in (up, down))
            for channel in range(2):
                columns[channel, :, place] = (a[channel] - b[channel]) / (2.0 * step[place])
        for channel, measured in enumerate((log.stretch, log.tau_j)):
            columns[channel, :, p.size + 2 * number + channel] = 1.0
            rest = measured - first[channel]
            kept = first[2] & np.isfinite(rest) & np.isfinite(columns[channel]).all(axis=1)
            parts[channel].append((columns[channel][kept], rest[kept] - np.median(rest[kept])))
    rows, rests = [], []
    for part in parts:
        rest = np.concatenate([each[1] for each in part])
        deviation = float(np.sqrt(np.mean(np.square(rest))))
        rows.append(np.concatenate([each[0] for each in part]) / deviation)
        rests.append(rest / deviation)
    return np.concatenate(rows), np.concatenate(rests)
