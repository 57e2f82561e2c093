"""x and T_p where the logs know only their product: the file's proportion is kept, and an active bound is reported.

In one configuration friction shows 2 T_p r_J sinh x; what parts the two is the slope cosh x, a per cent, which anything
that the model lacks bends. Least squares then runs along the product until [uncertainty] holds it: a pretension of
exactly its bound, which no log has shown. `tsa calibrate` keeps the proportion in that case, and so is it kept here.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from tsa_ctrl.identify.calibrate.keep_split import keep_split
from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import full_residuals
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit, base_quantities
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath

BENDING_VARIED = 0.05  # of the bending angle: less is one configuration
PARTED = 0.5  # of [uncertainty]: x and T_p are named apart when their intervals are narrower
MOST_COST = (
    0.05  # of the RMS error: a slope that is worth more tells something; the demo's, bent by shake, is worth 3 %
)
AT_BOUND = 1e-6  # of ln: a fit that a bound holds stands on it
SPLIT = ("friction_angle", "pretension")


def in_proportion(frame: Frame, reported: Refit) -> Refit:
    """`reported` with its half loop, x and T_p in the file's proportion, unless the logs part the two."""
    fitted, base = reported.fitted, reported.fitted.hypothesis.base
    model = base.given
    if not isinstance(model, TendonSheath) or len(base.coordinates()) < len(SPLIT) or parted(frame, reported):
        return reported
    loop = base.quantities(fitted.point[: len(SPLIT)])["half_loop_torque"][1]
    x, tension = keep_split(model, Quantity(loop, loop, loop, "N*m"), [])
    point = fitted.point.copy()
    point[: len(SPLIT)] = math.log(x.value / model.friction_angle), math.log(tension.value / model.pretension)
    if _error(frame, reported.fitted, point) > (1.0 + MOST_COST) * _error(
        frame, reported.fitted, reported.fitted.point
    ):
        return reported
    kept = dataclasses.replace(reported.fitted, point=point)
    return dataclasses.replace(reported, fitted=kept, learned=reported.fitted.point)


def parted(frame: Frame, reported: Refit) -> tuple[str, ...]:
    """Return which of x and T_p the logs identify separately: the bending angle varies, the interval is narrower than
    the file's.
    """
    model = reported.fitted.hypothesis.base.given
    if not isinstance(model, TendonSheath):
        return ()
    angles = [run.signals.theta for run in frame.runs if run.signals.theta is not None]
    if not angles or float(np.ptp(np.concatenate(angles))) <= BENDING_VARIED * model.bending_angle:
        return ()
    widths = (model.friction_angle_uncertainty, model.pretension_uncertainty)
    quantities = base_quantities(reported)
    return tuple(
        name
        for name, width in zip(SPLIT, widths, strict=True)
        if 0.0 < _half_width(quantities[name][1]) <= PARTED * width
    )


def at_bounds(reported: Refit) -> Mapping[str, tuple[float, float, float, str]]:
    """name: (value, low, high, unit) of x or T_p where [uncertainty] holds it; SI units."""
    fitted = reported.fitted
    model = fitted.hypothesis.base.given
    if not isinstance(model, TendonSheath):
        return {}
    out = {}
    nominal = {"friction_angle": (model.friction_angle, "1"), "pretension": (model.pretension, "N")}
    for coordinate, value in zip(fitted.hypothesis.base.coordinates(), fitted.point, strict=False):
        size, unit = nominal[coordinate.name]
        low, high = (size * math.exp(edge) for edge in (coordinate.low, coordinate.high))
        if min(value - coordinate.low, coordinate.high - value) <= AT_BOUND:
            out[coordinate.name] = (size * math.exp(float(value)), low, high, unit)
    return out


def _half_width(quantity: Quantity) -> float:
    """Return half the width of the interval as a share of the value."""
    return 0.5 * (quantity.high - quantity.low) / max(quantity.value, 1e-12)


def _error(frame: Frame, fitted: Fit, point: np.ndarray) -> float:
    """RMS of the simulation error over all samples, N*m."""
    residuals = full_residuals(frame, fitted.hypothesis.model(point))
    total = sum(float(residual @ residual) for residual in residuals)  # an hour of it is not held twice
    return float(np.sqrt(total / sum(map(len, residuals))))
