"""Detect torques that are too large for this model, and list the units that would explain the factor.

While the tendons slide, the joint torque has an upper bound by (3.55):

    |tau_J| <= R cosh(x) |tau_M| + F,    R = r_J / r_M,    F = 2 T_p r_J sinh x

Friction angle and pretension are at the upper end of [uncertainty]. The part of the torque that is proportional to the
joint's acceleration is due to inertia and does not count. A model cannot distinguish units whose factors differ by less
than its uncertainty, so all matching units are listed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.redundancy import BAND, NEAR
from tsa_ctrl.identify.units import in_other_units
from tsa_ctrl.model.parameters import RigidDrive, TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import low_pass
from tsa_ctrl.model.steady_sliding import sliding

Array = NDArray[np.float64]

FRICTION_FACTOR = 2.0  # times the range of [uncertainty]: an effect of this drive may double a torque
DEGREES = 180.0 / math.pi  # per radian: factor by which an angle in degrees is too large
# A rough guess of a drive's friction is wrong by less than this factor; the smallest factor of a unit is 8.85
ROUGH = 5.0
GUESS = 30.0  # the same for a file with friction only: one and a half orders of magnitude


def most_friction(model: TendonSheath) -> float:
    """Return the factor by which [uncertainty] may increase the friction torque 2 T_p r_J sinh x of the file."""
    x = model.friction_angle
    friction = math.sinh(x * (1.0 + model.friction_angle_uncertainty)) / math.sinh(x)
    return friction * (1.0 + model.pretension_uncertainty)


def friction_beyond(model: TendonSheath, found: Quantity) -> str:
    """Return the reason why the friction torque of the logs cannot be that of this drive; empty without one.

    It can be if its 95 % interval overlaps the model's range by [uncertainty], widened by FRICTION_FACTOR.
    """
    given = abs(sliding(model).half_loop)
    x = model.friction_angle
    lowest = math.sinh(x / (1.0 + model.friction_angle_uncertainty)) / math.sinh(x)
    low = given * lowest / (1.0 + model.pretension_uncertainty) / FRICTION_FACTOR
    high = given * most_friction(model) * FRICTION_FACTOR
    if found.low > high:
        may = in_other_units(found.value / high, found.value / low)
        cause = f"torques may be {may}: convert them to N·m, or give this drive's model"
    elif found.low <= 0.0 or found.high < low:
        cause = "friction does not follow this motion: is a column of another log or of another drive, or is it noise?"
    else:
        return ""
    return (
        f"the friction torque comes out as {found}, {found.value / given:.3g} times the model's; [uncertainty], and a "
        f"factor of {FRICTION_FACTOR:g} beyond it, allow {low:.3g} to {high:.3g} N·m; {cause}"
    )


def torque_scale(dataset: Dataset, model: TendonSheath) -> str:
    """Return the reason why the model finds tau_j too large for tau_m, or an empty string; requires both columns."""
    omega = dataset["omega_j"]
    moving = np.abs(omega) > 0.1 * float(np.percentile(np.abs(omega), 95.0))
    if not moving.any():
        return ""
    acceleration = np.gradient(low_pass(omega, dataset.period, BAND), dataset.period)
    measured = low_pass(dataset["tau_j"], dataset.period, BAND)
    inertia = acceleration - float(np.mean(acceleration))
    turned = float(inertia @ inertia)
    if turned > 0.0:
        measured = measured - inertia * float(inertia @ measured) / turned
    found = _size(measured[moving])
    x = model.friction_angle * (1.0 + model.friction_angle_uncertainty)
    ratio = model.joint_pulley_radius / model.motor_pulley_radius
    driven = ratio * _size(low_pass(dataset["tau_m"], dataset.period, BAND)[moving])
    friction = abs(sliding(model).half_loop) * most_friction(model)
    simulated = _size(predict(model, dataset.signals())[moving])
    allowed = FRICTION_FACTOR * max(math.cosh(x) * driven + friction, simulated)
    if not found > allowed:
        return ""
    units = in_other_units(found / allowed, math.inf)  # no lower bound: the torque of a small load may have any size
    most = allowed / FRICTION_FACTOR
    return (
        f"column tau_j is {found:.3g} N·m where tau_m gives {simulated:.3g} N·m by the model and at most "
        f"{most:.3g} N·m within [uncertainty], {found / most:.3g} times too large for tau_m: tau_j may be {units}; "
        "convert it to N*m, or give this drive's model"
    )


def drive_scale(given: RigidDrive, found: RigidDrive) -> str:
    """Return the reason why a plain drive's log is in another unit; empty without one.

    A unit is wrong if the parameters of `found` are about those of `given` times the factor of a unit. The inertia is
    known from data sheets, so it decides together with the friction. Without it, the friction may be a first guess.
    """
    inertia = _ratio(found.inertia, given.inertia)
    friction = _ratio(found.coulomb_friction, given.coulomb_friction)
    size = friction if inertia is None else inertia
    if size is None or friction is None or not size > 0.0:
        return ""
    ends = "convert it, or give this drive's model"
    turned = 1.0 / (size * DEGREES)
    if inertia is not None and 1.0 / NEAR < turned < NEAR and 1.0 / ROUGH < friction < ROUGH:
        return (
            f"the inertia comes out {1.0 / size:.3g} times smaller than in the file, and the friction does not: q_m "
            f"and omega_m seem to be in degrees (180/pi = {DEGREES:.3g}), where rad are needed; {ends}"
        )
    if 1.0 / ROUGH < size < ROUGH or (inertia is None and 1.0 / GUESS < size < GUESS):
        return ""
    fitting = in_other_units(size / NEAR, size * NEAR)
    if not fitting.startswith("in ") or not 1.0 / ROUGH < friction / size < ROUGH:
        return ""
    return (
        f"{'inertia and friction come' if inertia is not None else 'the friction comes'} out {size:.3g} times as large "
        f"as in the file: tau_m seems to be {fitting}, where N*m is needed; {ends}"
    )


def _ratio(found: float | None, given: float | None) -> float | None:
    return None if not given or found is None else found / given


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
