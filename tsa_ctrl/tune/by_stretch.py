"""Estimate parameters from the tendon elongation, which two encoders and the motor torque determine.

Without a joint torque sensor, stiffness and friction are estimated from the elongation. The curvature profile then
comes from the file, because it cannot be separated from the friction. The verification runs also use the elongation.
With a sensor, the elongation shows when the tendons slide along their whole length, which the joint's motion alone does
not show.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate.keep_split import bounds, keep_split
from tsa_ctrl.identify.calibrate.routing import fit_routing, of_elongation
from tsa_ctrl.identify.calibrate.stretch import fit_stretch, told
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.model.stretch import MOST_CENTRE, profile_of, unsupported_reason
from tsa_ctrl.signals import JOINT_ANGLE
from tsa_ctrl.tune.estimate import COUPLING, Estimate, estimate

_OF_THE_SENSOR = ("tau_j", "theta", "theta_difference")
ROUNDS = 4  # iterations: the error of the friction torque is 1e-6 after three


def unsupported_by(model: TendonSheath, has_encoder: bool) -> str:
    """Return why the elongation cannot determine the joint torque, with the remedy, or an empty string if it can."""
    if not has_encoder:
        return "no [axis.encoder] that would show the tendon elongation instead; give one"
    if model.bending_centre is None and "elongation_coupling" not in model.effects:
        return "the model file does not state where the sheath bends; give [sheath] bending_centre"
    return unsupported_reason(model)


def moved_by_hand(torque: float) -> str:
    """Return the advice for a joint that its own torque, up to `torque` (N*m), moves too little."""
    return (
        "without a joint torque sensor, the tendons must slide steadily in both directions: move the joint by hand, "
        f"slowly back and forth, against up to {torque:.2g} N*m"
    )


def estimate_by_stretch(logs: Sequence[Dataset], model: TendonSheath) -> Estimate:
    """Return the estimate of stiffness, friction angle and pretension. The form of the transmission stays the same.

    The joint torque from the elongation contains the model's friction, so it cannot show how friction changes with the
    wrap angle. If other joints bend the sheaths, the elongation itself shows by how much. The estimate is then made at
    the mean wrap angle and converted to bending_angle.

    Raises:
        UsageError: The logs do not determine a parameter.
    """
    routed = fit_routing(of_elongation(logs, model), model, certified_gain=False, by_elongation=True)
    if routed is not None:
        model = routed.model
    angles = [log.completed_for(model).signals().theta for log in logs]
    bent = [angle for angle in angles if angle is not None]
    if len(bent) < len(logs):
        return _at_one_wrap_angle(logs, model)
    mean = float(np.mean(np.concatenate(bent)))
    found = _at_one_wrap_angle(logs, _bent_to(dataclasses.replace(model, routing=None), mean))
    calibration = found.calibration
    back = dataclasses.replace(_bent_to(found.model, model.bending_angle), routing=model.routing)
    of_angle = back.friction_angle / found.model.friction_angle
    of_tension = back.pretension / found.model.pretension
    of_loop = sliding(back).half_loop / sliding(found.model).half_loop
    calibration = dataclasses.replace(
        calibration,
        friction_angle=_scaled(calibration.friction_angle, of_angle),
        pretension=_scaled(calibration.pretension, of_tension),
        half_loop_torque=_scaled(calibration.half_loop_torque, of_loop),
        model=back,
    )
    if routed is not None:
        calibration = dataclasses.replace(
            calibration, routing=routed.quantities, notes=(*calibration.notes, routed.sentence)
        )
    note = f"friction was measured at the mean wrap angle of {mean:.3g} rad and converted to bending_angle"
    return dataclasses.replace(found, model=back, calibration=calibration, notes=(*found.notes, note))


def _bent_to(model: TendonSheath, angle: float) -> TendonSheath:
    """Return the model with another bending_angle (rad) and the pretension at that angle by (3.56)."""
    pretension = model.pretension + model.pretension_slope * (angle - model.bending_angle)
    return dataclasses.replace(model, bending_angle=angle, pretension=pretension)


def _scaled(found: Quantity, factor: float) -> Quantity:
    return dataclasses.replace(found, value=factor * found.value, low=factor * found.low, high=factor * found.high)


def _at_one_wrap_angle(logs: Sequence[Dataset], model: TendonSheath) -> Estimate:
    """Return the estimate for a sheath that no other joint bends."""
    bare = [without_torque(log) for log in logs]
    fit = fit_stretch(bare, model)
    stiff = dataclasses.replace(model, axial_stiffness=fit.axial_stiffness.value)
    stiff = dataclasses.replace(stiff, axial_stiffness_uncertainty=fit.model.axial_stiffness_uncertainty)
    found = estimate(told(bare, fit), stiff, certified_gain=False, forms=False)
    half = fit.half_loop_torque
    model = _with_half_loop(found.model, half.value)
    inside = all(
        low <= value <= high
        for value, (low, high) in zip((model.friction_angle, model.pretension), bounds(stiff), strict=True)
    )
    if inside:  # if a limb creeps between strokes, parts of the tendons stick: a regression returns 0.56 for 0.61 N*m
        x, tension = (
            dataclasses.replace(was, value=value, low=min(was.low, value), high=max(was.high, value))
            for was, value in (
                (found.calibration.friction_angle, model.friction_angle),
                (found.calibration.pretension, model.pretension),
            )
        )
        found = dataclasses.replace(
            found,
            model=model,
            calibration=dataclasses.replace(found.calibration, friction_angle=x, pretension=tension, model=model),
        )
    calibration = dataclasses.replace(found.calibration, half_loop_torque=half)
    note = "without a joint torque sensor: the joint torque comes from the tendon elongation, also in the verification"
    return dataclasses.replace(
        found,
        calibration=calibration,
        notes=(note, *fit.notes, *found.notes),
        parameters={**found.parameters, "axial_stiffness": fit.axial_stiffness},
    )


def beside_stretch(found: Estimate, logs: Sequence[Dataset], model: TendonSheath) -> Estimate:
    """Return the estimate from a joint torque sensor, with the friction torque from the elongation if they disagree.

    If a limb creeps between its strokes, the joint moves while only part of the tendons slides, and a regression of
    these samples underestimates the friction. A simulation of the tendons along the log does not have this error.
    `found` is returned unchanged in these cases:

    * The elongation does not determine the friction.
    * Several configurations separated x and T_p0.
    * The model has other effects than the curvature profile, because the elongation does not show their torque.

    If the two models describe the bends differently, x has different values for the same torques. Therefore the
    friction torques at the joint are compared, each computed with its own form of the transmission.
    """
    if (found.calibration.split and not found.calibration.by_slope) or set(model.effects) - {COUPLING}:
        return found
    bare = model.with_effects({})
    try:
        fit = fit_stretch(logs, bare)
    except UsageError:
        return found
    if fit.centre is None or fit.centre.value > MOST_CENTRE:
        return found
    x = fit.friction_angle
    points = [list(point) for point in profile_of(fit.model).points]
    bent = fit.model.with_effects({COUPLING: {"curvature_profile": points}})
    value, low, high = (sliding(bent, 1.0, angle).half_loop for angle in (x.value, x.low, x.high))
    at_joint = Quantity(value, low, high, "N*m")
    regressed = found.calibration.half_loop_torque
    before = regressed.value / _of_bends_at_the_joint(found.model)
    if at_joint.low <= before <= at_joint.high:
        return found
    note = (
        f"the friction torque from the tendon elongation is {at_joint}, from the torques during motion "
        f"{before:.4g} N*m: the tendons slide only partly there; the value from the elongation is used"
    )
    better = found.model
    for _ in range(ROUNDS):
        half = _scaled(at_joint, _of_bends_at_the_joint(better))
        notes: list[str] = []
        angle, tension = keep_split(model, half, notes)
        better = better.recalibrated(angle.value, tension.value)
    return dataclasses.replace(
        found,
        model=better,
        calibration=dataclasses.replace(
            found.calibration, friction_angle=angle, pretension=tension, half_loop_torque=half, model=better
        ),
        notes=(*found.notes, note, *notes),
    )


def _of_bends_at_the_joint(model: TendonSheath) -> float:
    """Return the ratio of the friction torques by (3.55), 2 T_p r_J sinh x, and by the model's own form (1)."""
    plain = model.with_effects({name: value for name, value in model.effects.items() if name != COUPLING})
    return sliding(plain).half_loop / sliding(model).half_loop


def _with_half_loop(model: TendonSheath, value: float) -> TendonSheath:
    """Return the model with x and T_p0 scaled by one factor, so that its friction torque at the joint is `value` (N*m).

    The factor is approximated in `ROUNDS` iterations.
    """
    for _ in range(ROUNDS):
        change = math.sqrt(value / sliding(model).half_loop)
        model = model.recalibrated(change * model.friction_angle, change * model.pretension)
    return model


def without_torque(log: Dataset) -> Dataset:
    """Return the log without the columns of the joint torque sensor and without the angles of other joints."""
    columns = {
        name: values
        for name, values in log.columns.items()
        if name not in _OF_THE_SENSOR and not name.startswith(JOINT_ANGLE)
    }
    return dataclasses.replace(Dataset.from_arrays(columns, log.name), sha256=log.sha256)
