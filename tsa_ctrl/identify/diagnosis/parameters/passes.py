"""Intervals where structure is left: a model error repeats in every pass over the same state of motion.

Between stretches of time such an error does not scatter, for each holds the same motion: resampled by stretches it
makes no interval wider, however long the log. So there samples at the same velocity and angle are one cluster as well
(clusters in several directions: Cameron, Gelbach, Miller, J. Bus. Econ. Stat. 29, 2011), and the interval has as many
degrees of freedom as clusters that tell the number (Bell, McCaffrey, Surv. Methodol. 28, 2002).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.quantity import NOISE, half_width
from tsa_ctrl.model.functions import Array

# Halves of the velocity and quarters of the angle: an error is smooth over the motion, so that cells cut finer stand
# for each other's. Of 150 drawn errors of a spring, friction and drag (tests/identify/diagnosis/parameters/test_passes)
# intervals over 8 cells hold 92 to 94 %, over 16 87, over 24 80 to 83, and 12 without any; 6 cells hold no more
VELOCITIES, ANGLES = 2, 4
LEAST_FREEDOM = 2.0  # t of one cluster is 12.7 and says nothing; of two it is 4.3
SINGULAR = 1e-12  # of the largest variance, in units of each coordinate's own: what rounding leaves of none


def states_of(problem: Problem) -> NDArray[np.int64]:
    """Number of the state of motion of each sample that counts, (m,)."""
    frame, used = problem.frame, problem.mask
    return states(frame.column("omega_j")[used], frame.stack([run.angle for run in frame.runs])[used])


def states(velocity: Array, angle: Array) -> NDArray[np.int64]:
    """Numbers of the cells of velocity and angle, (m,) each, that samples lie in: about as many samples in each."""
    cells = _quantile(velocity, VELOCITIES) * ANGLES + _quantile(angle, ANGLES)
    return np.asarray(np.unique(cells, return_inverse=True)[1], dtype=np.int64)


def widened(covariance: Array, influence: Array, residual: Array, cells: NDArray[np.int64]) -> Array:
    """A covariance (k, k) of coordinates, wider along what the residual (m,) scatters more by cells than it says.

    influence (m, k): d coordinates / d residual. Along some directions only: a sum that the logs know well while its
    parts trade places stays as sure as the cells have it.
    """
    units = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(units, units))
    values = np.maximum(values, SINGULAR * values[-1])
    own = influence / units @ (vectors / np.sqrt(values))  # of directions in which the covariance is 1
    number = int(cells.max(initial=0)) + 1
    scores = _summed(own * residual[:, None], cells, number)
    spread, turned = np.linalg.eigh(scores.T @ scores * number / max(number - 1, 1))
    told = _summed(np.square(own @ turned), cells, number)
    told /= np.maximum(np.max(told, axis=0, initial=0.0), 1e-300)  # of a direction that is all but singular it is huge
    freedom = np.sum(told, axis=0) ** 2 / np.maximum(np.sum(told**2, axis=0), 1e-300)
    wider = np.array([half_width(max(float(each), LEAST_FREEDOM)) / half_width(NOISE) for each in freedom])
    root = units[:, None] * (vectors * np.sqrt(values)) @ turned
    return np.asarray(root * np.maximum(spread * wider**2, 1.0) @ root.T)


def _summed(columns: Array, cells: NDArray[np.int64], number: int) -> Array:
    """Sums over cells, (number, k) from (m, k)."""
    total = np.zeros((number, columns.shape[1]))
    np.add.at(total, cells, columns)
    return total


def _quantile(y: Array, parts: int) -> NDArray[np.int64]:
    """Number of the part of equal numbers of samples that each lies in, (m,)."""
    return np.asarray(np.searchsorted(np.quantile(y, np.arange(1, parts) / parts), y), dtype=np.int64)
