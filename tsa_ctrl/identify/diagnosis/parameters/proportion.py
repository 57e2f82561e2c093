"""Keep x and T_p together if the logs determine only their product, and report active bounds.

In one configuration friction determines only 2 T_p r_J sinh x. Only the slope cosh x separates x from T_p, and this is
an effect of one per cent, which any model error disturbs. Least squares then moves along the product until
[uncertainty] limits it, so that the pretension lies exactly at its bound. No log supports that value. In that case
`tsa calibrate` moves x and T_p together from the file's values, in proportion to their uncertainties (`keep_split`).
This module does the same.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.calibrate.keep_split import keep_split
from tsa_ctrl.identify.diagnosis.criteria import LEAST_SHARE, NEGLIGIBLE
from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import full_residuals
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit, base_quantities
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.three_errors import known_direction
from tsa_ctrl.model.parameters import TendonSheath

PARTED = 0.5  # share of [uncertainty]: x and T_p are reported separately if their intervals are narrower
# Largest increase of the RMS error: a slope that reduces the error by more contains information. In the demo, where
# shaking distorts the slope, it reduces the error by 3 %.
MOST_COST = LEAST_SHARE
SPLIT = ("friction_angle", "pretension")


def in_proportion(frame: Frame, reported: Refit) -> Refit:
    """Return `reported` with x and T_p moved together from the file's values to the fitted friction torque.

    They move in proportion to their uncertainties in the file, within [uncertainty]. `reported` is returned unchanged
    in three cases:

    - The model is not a tendon-sheath drive with both parameters free.
    - The logs identify one of the parameters separately (`parted`).
    - The move increases the RMS error while sliding by more than MOST_COST. Errors near reversals are large in every
      model without presliding, and would hide an error everywhere else. If the joint never slides, all samples count.
    """
    fitted, base = reported.fitted, reported.fitted.hypothesis.base
    model = base.given
    if not isinstance(model, TendonSheath) or len(base.coordinates()) < len(SPLIT) or parted(frame, reported):
        return reported
    loop = base.quantities(fitted.point[: len(SPLIT)])["half_loop_torque"][1]
    x, tension = keep_split(model, Quantity(loop, loop, loop, "N*m"), [])
    point = fitted.point.copy()
    point[: len(SPLIT)] = math.log(x.value / model.friction_angle), math.log(tension.value / model.pretension)
    slides = [known_direction(run.raw) for run in frame.runs]
    if not any(mask.any() for mask in slides):
        slides = [np.ones_like(mask) for mask in slides]
    moved, learned = (_error(frame, fitted, each, slides) for each in (point, fitted.point))
    if moved > (1.0 + MOST_COST) * learned:
        return reported
    return dataclasses.replace(reported, fitted=dataclasses.replace(fitted, point=point), learned=fitted.point)


def parted(frame: Frame, reported: Refit) -> tuple[str, ...]:
    """Return the names of the parameters among x and T_p that the logs identify separately.

    The wrap angle must vary in the logs, and the half width of the parameter's interval must be at most PARTED times
    the uncertainty in the file.
    """
    model = reported.fitted.hypothesis.base.given
    if not isinstance(model, TendonSheath):
        return ()
    angles = [run.signals.theta for run in frame.runs if run.signals.theta is not None]
    if not angles or float(np.ptp(np.concatenate(angles))) <= LEAST_SHARE * model.bending_angle:
        return ()
    widths = (model.friction_angle_uncertainty, model.pretension_uncertainty)
    quantities = base_quantities(reported)
    return tuple(
        name
        for name, width in zip(SPLIT, widths, strict=True)
        if 0.0 < _half_width(quantities[name][1]) <= PARTED * width
    )


def at_bounds(reported: Refit) -> Mapping[str, tuple[float, float, float, str]]:
    """Return (value, low, high, unit) of x and T_p by name, if a bound of [uncertainty] holds them; SI units."""
    fitted = reported.fitted
    model = fitted.hypothesis.base.given
    if not isinstance(model, TendonSheath):
        return {}
    out = {}
    nominal = {"friction_angle": (model.friction_angle, "1"), "pretension": (model.pretension, "N")}
    for coordinate, value in zip(fitted.hypothesis.base.coordinates(), fitted.point, strict=False):
        size, unit = nominal[coordinate.name]
        low, high = (size * math.exp(edge) for edge in (coordinate.low, coordinate.high))
        if min(value - coordinate.low, coordinate.high - value) <= NEGLIGIBLE:
            out[coordinate.name] = (size * math.exp(float(value)), low, high, unit)
    return out


def _half_width(quantity: Quantity) -> float:
    """Return half the width of the interval as a share of the value."""
    return 0.5 * (quantity.high - quantity.low) / max(quantity.value, 1e-12)


def _error(frame: Frame, fitted: Fit, point: np.ndarray, used: Sequence[NDArray[np.bool_]]) -> float:
    """Return the RMS simulation error over the `used` samples of each run, (n,) at the log's own rate, N*m."""
    residuals = full_residuals(frame, fitted.hypothesis.model(point))
    total = sum(float(np.sum(np.square(residual[mask]))) for residual, mask in zip(residuals, used, strict=True))
    return float(np.sqrt(total / sum(int(mask.sum()) for mask in used)))
