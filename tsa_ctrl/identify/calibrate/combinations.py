"""The two numbers that one configuration identifies, and x from measured motor-side tensions; both linear fits."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import TooStillError
from tsa_ctrl.identify.calibrate.prepared import PreparedLog, offsets, stack
from tsa_ctrl.identify.calibrate.regression import Estimate, lagged, solve
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.sliding import pretension_level

FloatArray = NDArray[np.float64]

MIN_BLOCKS = 8  # t of 7 degrees of freedom is 2.4; of half as many it would be 3.2, and intervals useless


def _base_target(log: PreparedLog, model: TendonSheath) -> FloatArray:
    """Measured joint torque without what the model's effects add to (3.55), at the model's present parameters."""
    if not model.effects:
        return log.tau_j
    bare = dataclasses.replace(model, effects={})
    return log.tau_j - predict(model, log.signals) + predict(bare, log.signals)


def _linear(logs: list[PreparedLog], model: TendonSheath, lag: int, weight: list[FloatArray]) -> Estimate:
    """Fit tau_J = a tau_M - b weight sigma + c; returns the estimate of (a, b, and c of each log)."""
    x, z, y = [], [], []
    for log, w, offset in zip(logs, weight, offsets(logs), strict=True):
        rest = (-w * log.admission.direction, offset)
        x.append(np.column_stack([log.signals.tau_m, *rest]))
        z.append(np.column_stack([lagged(log.signals.tau_m, lag), *rest]))
        y.append(_base_target(log, model))
    labels = np.concatenate([log.labels[log.mask] for log in logs])
    if np.unique(labels).size < MIN_BLOCKS:
        raise TooStillError("calibrate: too few stretches of steady motion for an honest interval; record longer logs")
    try:
        return solve(stack(x, logs), stack(z, logs), stack(y, logs), labels)
    except np.linalg.LinAlgError:
        raise TooStillError(
            "calibrate: load and direction do not vary independently; vary the load in both directions"
        ) from None


def combinations(logs: list[PreparedLog], model: TendonSheath, lag: int) -> tuple[Quantity, Quantity]:
    """Slope (1) and half loop torque (N*m): what one configuration identifies; instruments are `lag` samples away."""
    estimate = _linear(logs, model, lag, [np.ones(log.tau_j.size) for log in logs])
    slope = Quantity(float(estimate.value[0]), *estimate.interval(0), "1")
    return slope, Quantity(float(estimate.value[1]), *estimate.interval(1), "N*m")


def from_tensions(
    logs: list[PreparedLog], model: TendonSheath, lag: int
) -> tuple[tuple[Quantity, Quantity], float] | None:
    """With motor-side tensions T1, T3: T_p is measured (3.40), so the half loop gives sinh x alone.

    (3.37) holds for the measured tensions wherever the sheath bends, so `elongation_coupling` is not taken out; it only
    says how far the tension while sliding lies from T_p0 (3.54).
    """
    if any(log.tensions is None for log in logs):
        return None
    weight = [2.0 * model.joint_pulley_radius * log.tensions for log in logs if log.tensions is not None]
    measured = dataclasses.replace(
        model, effects={k: v for k, v in model.effects.items() if k != "elongation_coupling"}
    )
    estimate = _linear(logs, measured, lag, weight)
    low, high = estimate.interval(1)
    x = Quantity(math.asinh(float(estimate.value[1])), math.asinh(low), math.asinh(high), "1")
    ones = [np.column_stack([np.ones(log.tau_j.size), log.admission.direction * log.signals.tau_m]) for log in logs]
    pretension = [log.tensions - log.tensioner for log in logs if log.tensions is not None]
    labels = np.concatenate([log.labels[log.mask] for log in logs])
    rows = np.concatenate([o[log.mask] for o, log in zip(ones, logs, strict=True)])
    tension = solve(rows, rows, stack(pretension, logs), labels)
    level = pretension_level(model, x.value)
    condition = float(np.sqrt(estimate.covariance[1, 1])) / max(abs(float(estimate.value[1])), 1e-12)
    value, (low, high) = float(tension.value[0]), tension.interval(0)
    return (x, Quantity(value / level, low / level, high / level, "N")), 1.0 + condition
