"""Where a sheath bends, from the angles: by how much the motor winds up the tendons before the joint follows.

While both tendons slide, (3.37)-(3.41) give the motor's angle beyond the joint's as a line,

    e = tau_M / K_s - sigma g / K_s,     g = T_p r_M (A(x) - A(-x)) / (A(x) A(-x)),     A(rho) = mean of exp(rho b)

K_s the stiffness while sliding. g is (1 - s_c) h to first order in x, h the half loop at the motor and s_c the centre
of the bending: all of h with the bends at the motor, none of it with them at the joint. Both terms have the
same scale, so neither the stiffness of the tendons nor the gain of the joint torque enters. The answer is one course of
that centre: evenly bent from the motor up to a point, or from a point to the joint. Two bends of the same centre (an S)
transmit the same to second order in x, and turn so nearly alike that 1 % of the friction is not gained by knowing them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq

from tsa_ctrl.identify.calibrate.prepared import PreparedLog, prepare
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.curvature import NAMED, Points, Profile
from tsa_ctrl.model.functions import SCALARS
from tsa_ctrl.model.parameters import TendonSheath

FloatArray = NDArray[np.float64]

BLOCKS = 10  # of time, for the interval
DIGITS = 3  # of a point's share of the length
FLOOR = 0.01  # of s_c: narrower is no interval, for pulleys and encoders are not known better
NAMES = {0.0: "motor_end", 0.5: "uniform", 1.0: "joint_end"}  # centres that have a name


@dataclass(frozen=True)
class Bends:
    """`centre` s_c of the bending, 0 at the motor and 1 at the joint; `profile` as a model file has it."""

    centre: Quantity
    profile: str | Points


def course(centre: float) -> Points:
    """An even bend from one end of the sheath whose centre this is."""
    if centre <= 0.5:
        end = round(2.0 * centre, DIGITS)
        return NAMED["motor_end"] if end == 0.0 else ((0.0, 0.0), (end, 1.0), (1.0, 1.0))
    start = round(2.0 * centre - 1.0, DIGITS)
    return NAMED["joint_end"] if start >= 1.0 else ((0.0, 0.0), (start, 0.0), (1.0, 1.0))


def wound(profile: Profile, x: float) -> float:
    """g / (2 T_p r_M)."""
    alpha, beta = profile.mean_exponential(SCALARS, x), profile.mean_exponential(SCALARS, -x)
    return 0.5 * (alpha - beta) / (alpha * beta)


def lost(profile: Profile, x: float) -> float:
    """f(x) = h / (2 T_p r_M), h the half loop at the motor: tanh x, x or sinh x."""
    alpha, beta = profile.mean_exponential(SCALARS, x), profile.mean_exponential(SCALARS, -x)
    return 2.0 * math.sinh(x) / (alpha * math.exp(-x) + beta * math.exp(x))


def bends(logs: Sequence[Dataset], model: TendonSheath) -> Bends | None:
    """From logs with q_m and q_j beside the torques; `model` gives x and the radii. None without those angles.

    A series spring is of the length, not of the sheath: with one in the model nothing is said. Raises UsageError when
    the joint slides too little.
    """
    if model.series_stiffness is not None or not all({"q_m", "q_j"} <= set(log.columns) for log in logs):
        return None
    prepared = {log.name: log for log in prepare(logs, model, {})}
    rows = [_rows(log, prepared[log.name], model) for log in logs if log.name in prepared]
    squares = [(a.T @ a, a.T @ b) for a, b in (part for pair in rows for part in _blocks(*pair))]
    whole = np.sum([a for a, _ in squares], axis=0), np.sum([b for _, b in squares], axis=0)
    ratio = _ratio(*whole)
    without = np.array([_ratio(whole[0] - a, whole[1] - b) for a, b in squares])
    count = without.size
    deviation = math.sqrt((count - 1) / count * float(np.sum(np.square(without - without.mean()))))
    half = float(stats.t.ppf(0.975, count - 1)) * deviation
    x = model.friction_angle
    centres = [_centre(share, x) for share in (ratio, ratio + half, ratio - half)]
    centre = Quantity(centres[0], max(0.0, min(centres) - FLOOR), min(1.0, max(centres) + FLOOR), "1")
    for named, profile in NAMES.items():
        if centre.low <= named <= centre.high:
            return Bends(centre, profile)
    return Bends(centre, course(centre.value))


def _rows(log: Dataset, prepared: PreparedLog, model: TendonSheath) -> tuple[FloatArray, FloatArray]:
    """What both lines are made of while sliding, (n, 4): 1, tau_M, sigma, q_J; and what they give, (n, 2): e, tau_J.

    The joint's angle takes what a ratio of the radii that is not quite true, and the motor's inertia, leave.
    """
    mask = prepared.mask
    angle = log["q_j"][mask]
    gear = model.joint_pulley_radius / model.motor_pulley_radius
    columns = (np.ones(angle.size), log["tau_m"][mask], prepared.admission.direction[mask], angle)
    return np.column_stack(columns), np.column_stack((log["q_m"][mask] - gear * angle, log["tau_j"][mask]))


def _blocks(columns: FloatArray, given: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    return list(zip(np.array_split(columns, BLOCKS), np.array_split(given, BLOCKS), strict=True))


def _ratio(squares: FloatArray, products: FloatArray) -> float:
    """g / h."""
    angle, torque = np.linalg.solve(squares, products).T
    return float((angle[2] / angle[1]) / (torque[2] / torque[1]))


def _centre(ratio: float, x: float) -> float:
    """s_c for g / h."""

    def beyond(centre: float) -> float:
        profile = Profile.of(course(centre))
        return wound(profile, x) / lost(profile, x) - ratio

    if beyond(0.0) <= 0.0:
        return 0.0
    return 1.0 if beyond(1.0) >= 0.0 else float(brentq(beyond, 0.0, 1.0, xtol=1e-3))
