"""Determine x and T_p0 from their product alone: the proportion of the nominal file is kept within [uncertainty]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.calibrate.prepared import PreparedLog
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict

FloatArray = NDArray[np.float64]


def bounds(model: TendonSheath) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ranges (low, high) of x (1) and T_p0 (N) that [uncertainty] permits around the nominal values."""
    fx, ft = 1.0 + model.friction_angle_uncertainty, 1.0 + model.pretension_uncertainty
    x, tension = model.friction_angle, model.pretension
    return (x / fx, x * fx), (tension / ft, tension * ft)


def narrower(found: tuple[Quantity, Quantity], model: TendonSheath, share: float = 1.0) -> bool:
    """Return True if both intervals from the data are narrower than `share` of the uncertainty of the nominal file."""
    for quantity, (low, high) in zip(found, bounds(model), strict=True):
        if not (quantity.low > 0.0 and math.isfinite(quantity.high)):
            return False
        if quantity.high / quantity.low >= (high / low) ** share:
            return False
    return True


def keep_split(model: TendonSheath, half_loop: Quantity, notes: list[str]) -> tuple[Quantity, Quantity]:
    """Return x (1) and T_p0 (N), changed in proportion to their uncertainties, with 2 T_p r_J sinh x = `half_loop`.

    The intervals are the ranges of both that remain for the known product within [uncertainty]. If the friction torque
    cannot be reached within [uncertainty], the nearest corner is returned, and a note is added to `notes`.
    """
    from scipy.optimize import brentq  # slow to import

    (low_x, high_x), (low_t, high_t) = bounds(model)
    wx, wt = math.log(high_x / low_x) / 2.0, math.log(high_t / low_t) / 2.0
    x0, t0, diameter = model.friction_angle, model.pretension, 2.0 * model.joint_pulley_radius

    def excess(s: float) -> float:
        return diameter * t0 * math.exp(s * wt) * math.sinh(x0 * math.exp(s * wx)) - half_loop.value

    if excess(-1.0) < 0.0 < excess(1.0):
        s = float(brentq(excess, -1.0, 1.0))
    else:
        s = -1.0 if excess(-1.0) >= 0.0 else 1.0
        notes.append(f"the half loop {half_loop} cannot be reached within [uncertainty]; the nearest corner is used")
    x, tension = x0 * math.exp(s * wx), t0 * math.exp(s * wt)
    open_x = [
        math.asinh(max(loop, 0.0) / (diameter * t)) for loop, t in ((half_loop.low, high_t), (half_loop.high, low_t))
    ]
    open_t = [loop / (diameter * math.sinh(a)) for loop, a in ((half_loop.low, high_x), (half_loop.high, low_x))]
    return (
        Quantity(x, min(x, max(low_x, open_x[0])), max(x, min(high_x, open_x[1])), "1"),
        Quantity(tension, min(tension, max(low_t, open_t[0])), max(tension, min(high_t, open_t[1])), "N"),
    )


def least_error(logs: list[PreparedLog], model: TendonSheath) -> tuple[Quantity, Quantity]:
    """Return x (1) and T_p0 (N) within [uncertainty] with the least simulation error; the bounds are their intervals.

    Only the admitted samples count. At rest the friction can have any value up to the friction torque, and the sign of
    the velocity is noise. These samples would bias the result towards low friction: for a weight that rests between
    strokes, it was 0.38 instead of 0.61 N*m.
    """
    from scipy.optimize import least_squares  # slow to import

    (low_x, high_x), (low_t, high_t) = bounds(model)

    def residual(p: FloatArray) -> FloatArray:
        parts = []
        for log in logs:
            variant = model.recalibrated(math.exp(p[0]), math.exp(p[1]) + log.tensioner)
            parts.append((predict(variant, log.signals) - log.tau_j)[log.mask])
        return np.concatenate(parts)

    box = (np.log([low_x, low_t]), np.log([high_x, high_t]))
    start = 0.5 * (box[0] + box[1])
    fit = least_squares(residual, start, bounds=(box[0] - 1e-9, box[1] + 1e-9))
    x, tension = (float(v) for v in np.exp(np.clip(fit.x, *box)))
    return Quantity(x, low_x, high_x, "1"), Quantity(tension, low_t, high_t, "N")
