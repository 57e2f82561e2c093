"""Tuning without a joint torque sensor: two encoders and the motor's torque tell the joint torque.

Stiffness and friction come from the tendons' stretch, where the sheath bends from the file: without the sensor the two
are not parted. The verifying runs are judged by the stretch, too.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from tsa_ctrl.identify.calibrate.keep_split import bounds
from tsa_ctrl.identify.calibrate.stretch import fit_stretch, told
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.sliding import sliding
from tsa_ctrl.model.stretch import why_not
from tsa_ctrl.tune.estimate import Estimate, estimate

ROUNDS = 4  # of two parameters of which only the product shows: 1e-6 after three


def why_not_told(model: TendonSheath, has_encoder: bool) -> str:
    """What stands against a joint torque by stretch, with the cure; empty where nothing does."""
    if not has_encoder:
        return "no [axis.encoder], so that the tendons' stretch is not known either; give one"
    if model.bending_centre is None and "elongation_coupling" not in model.effects:
        return "the model file does not say where the sheath bends; give [sheath] bending_centre"
    return why_not(model)


def moved_by_hand(torque: float) -> str:
    """What to do where a joint that only its own torque moves shows too little; `torque`: N*m, the most of it."""
    return (
        "without a joint torque sensor the joint must slide steadily both ways: take it by hand, move it slowly to and "
        f"fro all the while, against up to {torque:.2g} N*m, and start again, or give logs of such motion by --from-log"
    )


def estimate_by_stretch(logs: Sequence[Dataset], model: TendonSheath) -> Estimate:
    """Stiffness, friction angle and pretension; the form of the transmission stays. Raises UsageError."""
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
    if inside:  # a limb that creeps between its strokes has not slid all along where it moves: 0.56 instead of 0.61 N*m
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
    note = "without a joint torque sensor: the joint torque is that of the tendons' stretch, in the verification, too"
    return dataclasses.replace(
        found,
        calibration=calibration,
        notes=(note, *fit.notes, *found.notes),
        parameters={**found.parameters, "axial_stiffness": fit.axial_stiffness},
    )


def _with_half_loop(model: TendonSheath, value: float) -> TendonSheath:
    """x and T_p0 in the proportion of `model`, so that its half loop at the joint is `value` N*m."""
    for _ in range(ROUNDS):
        change = math.sqrt(value / sliding(model).half_loop)
        model = model.recalibrated(change * model.friction_angle, change * model.pretension)
    return model


def without_torque(log: Dataset) -> Dataset:
    """A log as it is without the sensor."""
    columns = {name: values for name, values in log.columns.items() if name != "tau_j"}
    return dataclasses.replace(Dataset.from_arrays(columns, log.name), sha256=log.sha256)
