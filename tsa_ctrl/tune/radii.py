"""Ratio of the pulley radii r_J/r_M, from the angles of motor and joint over the travel.

While the tendons slide one way, (3.37)-(3.41) give the motor's angle as a line,

    q_M = (r_J/r_M) q_J + tau_M / K - sigma g + omega_J late + zero

with the elongation by torque and friction, and the time by which one encoder is later than the other. A regression over
both directions removes all of it from the ratio. The zero is each log's own. A torque that follows the angle, as of a
spring, hides a wrong ratio behind a wrong stiffness: the elongation is then the file's, with its uncertainty. The radii
of a file are measured on metal; what counts is where the tendons lie, half a diameter and the windings further out.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity, rounded
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.sliding import sliding_stiffness, wound_by_friction

FloatArray = NDArray[np.float64]

NEEDED = frozenset({"q_m", "q_j", "omega_j", "tau_m"})
BLOCKS = 10  # of time, for the interval
LEAST_ROWS = 200  # samples that slide, for an interval that means anything
UNWOUND = 2.0  # times the way that the file's friction may hide after a reversal, until the tendons slide surely
NOISE_MEDIAN = 1.652  # 1, median size of a second difference of noise over its standard deviation
OWN = 5.0  # times its noise, least variation of the torque: the noise then flattens the line by 4 %
WANTED = 0.002  # 1, half the interval over the ratio, at which it is calibrated
REPORTED = 0.01  # 1, correction that is reported
WRONG = 0.05  # 1, greatest correction: beyond it another pulley, exchanged radii, or counts of another encoder


def radius_ratio(logs: Sequence[Dataset], model: TendonSheath) -> Quantity | None:
    """Return r_J/r_M with its 95 % interval; None where the logs do not have both angles, or too little slides."""
    if not all(set(log.columns) >= NEEDED for log in logs):
        return None
    gear = model.joint_pulley_radius / model.motor_pulley_radius
    parts = [_rows(log, model, gear) for log in logs]
    count = len(parts)
    columns = np.concatenate([_with_zero(rows, index, count) for index, (rows, _) in enumerate(parts)])
    beyond = np.concatenate([given for _, given in parts])
    if beyond.size < LEAST_ROWS or np.linalg.matrix_rank(columns) < columns.shape[1]:
        return None
    follows = _follows(columns)
    doubt = 0.0
    if follows is not None:  # N*m/rad: torque and angle are one
        compliance = 1.0 / sliding_stiffness(model)
        beyond = beyond - compliance * columns[:, 1]
        columns = np.delete(columns, 1, axis=1)
        doubt = 2.0 * model.axial_stiffness_uncertainty * compliance * abs(follows)
    scale = np.abs(columns).max(axis=0)
    pieces = np.array_split(np.arange(beyond.size), BLOCKS)
    squares = [columns[piece].T @ (columns[piece] / scale) / scale[:, None] for piece in pieces]
    products = [columns[piece].T @ beyond[piece] / scale for piece in pieces]
    whole, right = np.sum(squares, axis=0), np.sum(products, axis=0)
    value = _first(whole, right) / scale[0]
    without = [_first(whole - a, right - b) / scale[0] for a, b in zip(squares, products, strict=True)]
    deviation = math.sqrt((BLOCKS - 1) * float(np.mean(np.square(np.array(without) - np.mean(without)))))
    half = float(stats.t.ppf(0.975, BLOCKS - 1)) * deviation + doubt
    return Quantity(gear + value, gear + value - half, gear + value + half, "1")


def with_ratio(model: TendonSheath, found: Quantity | None) -> tuple[TendonSheath, tuple[str, ...]]:
    """Return the model with the measured ratio, by its joint pulley, and notes for the report.

    Raises:
        UsageError: the angles contradict the file by more than a pulley's tolerance.
    """
    if found is None:
        return model, ()
    file = model.joint_pulley_radius / model.motor_pulley_radius
    correction = found.value / file - 1.0
    if abs(correction) > WRONG and not found.low <= file <= found.high:
        exchanged = abs(found.value * file - 1.0) < WRONG
        hint = (
            "the two radii are exchanged"
            if exchanged
            else "correct motor_pulley_radius or joint_pulley_radius, or gear_ratio and counts_per_revolution of drive "
            "and encoder"
        )
        raise UsageError(
            f"{model.source}: [actuator] joint_pulley_radius over motor_pulley_radius is {file:.4g}, the angles of "
            f"motor and joint make it {found}; allowed is a difference of {100.0 * WRONG:g} %: {hint}"
        )
    if found.share > WANTED:
        return model, (
            f"r_J/r_M is known to {100.0 * found.share:.2g} % alone, and stays as the file has it: more travel of the "
            "joint shows it",
        )
    radius = rounded(found.value * model.motor_pulley_radius, found.share)
    notes = (
        f"r_J/r_M is {found}, {100.0 * correction:+.2g} % of the file's {file:.4g}: joint_pulley_radius follows it",
    )
    return dataclasses.replace(model, joint_pulley_radius=radius), notes if abs(correction) > REPORTED else ()


def _rows(log: Dataset, model: TendonSheath, gear: float) -> tuple[FloatArray, FloatArray]:
    """Return regressors q_J, tau_M, sigma, omega_J (n, 4) and q_M - gear q_J (n), where the tendons slide."""
    angle, speed = log["q_j"], log["omega_j"]
    direction = np.sign(speed)
    turns = np.concatenate([[True], direction[1:] != direction[:-1]])
    since = np.maximum.accumulate(np.where(turns, np.arange(angle.size), 0))  # the last reversal before each sample
    way = UNWOUND * wound_by_friction(model) / gear
    slides = (direction != 0.0) & (np.abs(angle - angle[since]) > way)
    columns = np.column_stack((angle, log["tau_m"], direction, speed))
    return columns[slides], (log["q_m"] - gear * angle)[slides]


def _follows(columns: FloatArray) -> float | None:
    """Return dtau_M/dq_J (N*m/rad) if the torque follows the other columns but for its noise, None if it is its own."""
    torque, others = columns[:, 1], np.delete(columns, 1, axis=1)
    line, *_ = np.linalg.lstsq(others, torque, rcond=None)
    noise = float(np.median(np.abs(np.diff(torque, 2)))) / NOISE_MEDIAN
    own = float(np.sqrt(np.mean(np.square(torque - others @ line))))
    return None if own > OWN * noise else float(line[0])


def _with_zero(rows: FloatArray, index: int, count: int) -> FloatArray:
    """The rows with a column for the zero of each log."""
    zeros = np.zeros((rows.shape[0], count))
    zeros[:, index] = 1.0
    return np.hstack((rows, zeros))


def _first(squares: FloatArray, products: FloatArray) -> float:
    """The first coefficient of a regression."""
    return float(np.linalg.lstsq(squares, products, rcond=None)[0][0])
