"""x and T_p0 from several known configurations: Gauss-Newton on the instrumented normal equations."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.calibrate.prepared import PreparedLog, offsets, stack
from tsa_ctrl.identify.calibrate.regression import Estimate, lagged, solve
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict

FloatArray = NDArray[np.float64]

ITERATIONS = 8  # Gauss-Newton steps; it ends earlier when a step is below TOLERANCE
TOLERANCE = 1e-7  # of ln x and ln T_p: digits that no file is written with; a step there is rounding
STEP = 1e-4  # relative step of numerical derivatives: rounding and curvature are both far below what an interval tells


@dataclass(frozen=True)
class JointFit:
    """Joint fit of (ln x, ln T_p0, [ln gain], offset of each log) over all configurations."""

    estimate: Estimate
    condition: float
    gain_free: bool


def joint_fit(logs: list[PreparedLog], model: TendonSheath, lag: int, certified_gain: bool) -> JointFit | None:
    """Gauss-Newton on the instrumented normal equations; None when the data do not determine it."""
    gain_free = not certified_gain
    p = np.array([math.log(model.friction_angle), math.log(model.pretension), 0.0, *np.zeros(len(logs))])
    free = [0, 1, *([2] if gain_free else []), *range(3, p.size)]
    zero = offsets(logs)
    estimate = None
    labels = np.concatenate([log.labels[log.mask] for log in logs])
    for _ in range(ITERATIONS):
        x = [_jacobian(log, model, p, log.signals.tau_m, own)[:, free] for log, own in zip(logs, zero, strict=True)]
        z = [
            _jacobian(log, model, p, lagged(log.signals.tau_m, lag), own)[:, free]
            for log, own in zip(logs, zero, strict=True)
        ]
        y = [
            log.tau_j - _response(log, model, p, log.signals.tau_m) - offset
            for log, offset in zip(logs, p[3:], strict=True)
        ]
        rows = np.concatenate([a[log.mask] for a, log in zip(x, logs, strict=True)])
        instruments = np.concatenate([a[log.mask] for a, log in zip(z, logs, strict=True)])
        try:
            estimate = solve(rows, instruments, stack(y, logs), labels)
        except np.linalg.LinAlgError:
            return None
        step = np.clip(estimate.value, -0.5, 0.5)
        p[free] += step
        if not np.all(np.isfinite(p)) or np.any(np.abs(p[:2]) > 20.0):
            return None
        if float(np.max(np.abs(step))) < TOLERANCE:
            break
    assert estimate is not None
    scale = rows / np.linalg.norm(rows, axis=0)
    final = dataclasses.replace(estimate, value=p[free])
    return JointFit(final, float(np.linalg.cond(scale)), gain_free)


def _response(log: PreparedLog, model: TendonSheath, p: FloatArray, tau_m: FloatArray) -> FloatArray:
    variant = model.recalibrated(math.exp(p[0]), math.exp(p[1]) + log.tensioner)
    held = np.where(
        log.mask, log.admission.direction * np.maximum(np.abs(log.signals.omega_j), 1e-9), log.signals.omega_j
    )
    tau_j: FloatArray = predict(variant, dataclasses.replace(log.signals, tau_m=tau_m * math.exp(p[2]), omega_j=held))
    return tau_j


def _jacobian(
    log: PreparedLog, model: TendonSheath, p: FloatArray, tau_m: FloatArray, offset: FloatArray
) -> FloatArray:
    columns = []
    for i in range(3):
        up, down = p.copy(), p.copy()
        up[i] += STEP
        down[i] -= STEP
        columns.append((_response(log, model, up, tau_m) - _response(log, model, down, tau_m)) / (2.0 * STEP))
    return np.column_stack([*columns, offset])


def quantities(joint: JointFit) -> tuple[Quantity, Quantity]:
    """Friction angle (1) and pretension (N) with their intervals."""
    made = []
    for index, unit in ((0, "1"), (1, "N")):
        low, high = joint.estimate.interval(index)
        made.append(Quantity(math.exp(float(joint.estimate.value[index])), math.exp(low), math.exp(high), unit))
    return made[0], made[1]


def combinations_of(joint: JointFit, model: TendonSheath) -> tuple[Quantity, Quantity]:
    """Slope and half loop at the model's own configuration from the joint fit (delta method)."""
    value = joint.estimate.value
    x, tension = math.exp(value[0]), math.exp(value[1])
    gain = math.exp(value[2]) if joint.gain_free else 1.0
    slope = model.joint_pulley_radius / model.motor_pulley_radius * math.cosh(x) * gain
    loop = 2.0 * tension * model.joint_pulley_radius * math.sinh(x)
    by_slope = np.zeros(value.size)
    by_slope[0] = slope * x * math.tanh(x)
    if joint.gain_free:
        by_slope[2] = slope
    by_loop = np.zeros(value.size)
    by_loop[0], by_loop[1] = loop * x / math.tanh(x), loop
    made = []
    for centre, gradient, unit in ((slope, by_slope, "1"), (loop, by_loop, "N*m")):
        low, high = joint.estimate.interval_of(gradient)
        shift = centre - 0.5 * (low + high)
        made.append(Quantity(centre, low + shift, high + shift, unit))
    return made[0], made[1]
