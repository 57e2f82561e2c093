"""Compute the tendon elongation from the angles of both pulleys, and the compliances that the model file implies.

The elongation is

    s = r_M q_M - r_J q_J = zero + drift + e q_J + c_M (T3 - T1) + c_J (T4 - T2)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import stretching
from tsa_ctrl.model.stretch import compliances

SHAPE = "elongation_coupling"
ALL_AT_JOINT = "joint_end"
# Ratio of the sums of squares with and without an effect, or of two hypotheses: encoder errors and effects outside the
# catalogue cause smaller ratios
VISIBLY = 1.25
ENOUGH = 30.0  # least difference in cost: a few encoder counts cause less
INEXACT = 0.02  # relative error of the stiffness: the error of a first-order model of the friction
LIKELY = 1.96  # standard deviations in half a 95 % interval, which is what [uncertainty] states
MOST_ALIKE = 0.98  # largest correlation of neighbouring residuals: at 1 the deviation would be infinite


@dataclass(frozen=True)
class Seen:
    """Measured tendon elongation at the m samples that count."""

    stretch: Array  # (m,) in m
    slow: Array  # (m, k), columns of the zero and the drift of each log, and q_J for an error of the pulley radius
    blocks: NDArray[np.int64]  # (m,), block number of each sample


def seen_of(problem: Problem) -> Seen | None:
    """Return the measured elongation, or None if a log lacks an angle or the drive has no tendons."""
    frame = problem.frame
    if not (isinstance(problem.base.given, TendonSheath) and frame.has("q_m") and frame.has("q_j")):
        return None
    model, mask = problem.base.given, problem.mask
    stretch = model.motor_pulley_radius * frame.column("q_m") - model.joint_pulley_radius * frame.column("q_j")
    slow = np.zeros((len(frame), 2 * len(frame.runs) + 1))
    slow[:, -1] = frame.column("q_j")
    for number, part in enumerate(frame.slices):
        slow[part, 2 * number] = 1.0
        slow[part, 2 * number + 1] = np.linspace(-1.0, 1.0, part.stop - part.start)
    slow = slow[mask]
    return Seen(stretch[mask], slow[:, np.any(slow != 0.0, axis=0)], problem.blocks)


def ends_of(problem: Problem, fitted: Fit, point: Array) -> tuple[Array, TendonSheath]:
    """Return T3 - T1 and T4 - T2 under a hypothesis at the samples that count, (m, 2) in N, and its model."""
    model = fitted.hypothesis.model(point)
    assert isinstance(model, TendonSheath)
    pairs = [stretching(model, run.signals) for run in problem.frame.runs]
    both = np.column_stack([problem.frame.stack([pair[end] for pair in pairs]) for end in range(2)])
    return both[problem.mask], model


def of_the_file(model: TendonSheath, shaped: bool) -> tuple[Array, Array]:
    """Return the prior knowledge of the compliances: right side (rows,) and matrix (rows, 2) of linear equations.

    The equations are matrix @ (c_M, c_J) = right side, with each row scaled to a standard deviation of 1. The first row
    is the sum of the compliances, which follows from the axial stiffness. The second row is their ratio. It is present
    if the model states the curvature profile, or if `shaped` is True.

    shaped: True if the compared hypotheses differ in the curvature profile. A model without the effect
    `elongation_coupling` then has all its curvature at the joint.
    """
    says = SHAPE in model.effects or model.bending_centre is not None
    if shaped and SHAPE not in model.effects:
        model = model.with_effects({SHAPE: {"curvature_profile": ALL_AT_JOINT}})
    motor, joint = compliances(model)
    whole = motor + joint
    sum_known = np.hypot(model.axial_stiffness_uncertainty / LIKELY, INEXACT) * whole
    rows, wanted = [np.array([1.0, 1.0]) / sum_known], [whole / sum_known]
    if says or shaped:
        centre = motor / whole
        known = max(model.bending_centre_uncertainty / LIKELY, INEXACT) * whole
        rows.append(np.array([1.0 - centre, -centre]) / known)
        wanted.append(0.0)
    return np.array(wanted), np.array(rows)


def softness(ends: Array, seen: Seen, noise: float, gram: Array, right: Array) -> Array:
    """Return the non-negative compliances c_M and c_J, (2,) in m/N, that fit the elongation and the prior best.

    Args:
        ends: T3 - T1 and T4 - T2, (m, 2) in N.
        seen: the measured elongation.
        noise: standard deviation of the elongation, m.
        gram, right: normal equations of the prior, (2, 2) and (2,).
    """
    columns = np.hstack([ends, seen.slow]) / noise
    matrix, vector = columns.T @ columns, columns.T @ seen.stretch / noise
    matrix[:2, :2] += gram
    vector[:2] += right
    found, gained = np.zeros(2), -np.inf
    for kept in ([0, 1], [0], [1]):
        used = [*kept, *range(2, len(vector))]
        solution = pinv(matrix[np.ix_(used, used)], vector[used])
        soft, gain = solution[: len(kept)], float(vector[used] @ solution)
        if np.all(soft >= 0.0) and gain > gained:
            found, gained = np.zeros(2), gain
            found[kept] = soft
    return found


def deviation(rest: Array) -> float:
    """Return the standard deviation of the noise, m, enlarged for the correlation of neighbouring samples."""
    alike = float(rest[1:] @ rest[:-1]) / max(float(rest @ rest), 1e-300)
    alike = min(max(alike, 0.0), MOST_ALIKE)
    return float(np.sqrt(np.mean(np.square(rest)) * (1.0 + alike) / (1.0 - alike)))


def solved(columns: Array, y: Array) -> Array:
    """Return the least-squares coefficients (k,) of `columns` (m, k) for y (m,)."""
    return pinv(columns.T @ columns, columns.T @ y)


def pinv(gram: Array, right: Array) -> Array:
    """Return the minimum-norm solution of normal equations, with each column scaled to unit size."""
    sizes = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / sizes[:, None] / sizes
    return np.asarray(np.linalg.lstsq(scaled, right / sizes, rcond=1e-12)[0] / sizes)
