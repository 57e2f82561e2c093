"""Tuning without a joint torque sensor: two encoders and the motor's torque tell the joint torque.

Stiffness and friction come from the tendons' stretch, where the sheath bends from the file: without the sensor the two
are not parted. The verifying runs are judged by the stretch, too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from tsa_ctrl.identify.calibrate.stretch import fit_stretch, told
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import why_not
from tsa_ctrl.tune.estimate import Estimate, estimate


def why_not_told(model: TendonSheath, has_encoder: bool) -> str:
    """What stands against a joint torque by stretch, with the cure; empty where nothing does."""
    if not has_encoder:
        return "no [axis.encoder], so that the tendons' stretch is not known either; give one"
    if model.bending_centre is None and "elongation_coupling" not in model.effects:
        return "the model file does not say where the sheath bends; give [sheath] bending_centre"
    return why_not(model)


def estimate_by_stretch(logs: Sequence[Dataset], model: TendonSheath) -> Estimate:
    """Stiffness, friction angle and pretension; the form of the transmission stays. Raises UsageError."""
    bare = [without_torque(log) for log in logs]
    fit = fit_stretch(bare, model)
    stiff = dataclasses.replace(model, axial_stiffness=fit.axial_stiffness.value)
    stiff = dataclasses.replace(stiff, axial_stiffness_uncertainty=fit.model.axial_stiffness_uncertainty)
    found = estimate(told(bare, fit), stiff, certified_gain=False, forms=False)
    half = fit.half_loop_torque
    calibration = dataclasses.replace(found.calibration, half_loop_torque=half)
    note = "without a joint torque sensor: the joint torque is that of the tendons' stretch, in the verification, too"
    return dataclasses.replace(
        found,
        calibration=calibration,
        notes=(note, *fit.notes, *found.notes),
        parameters={**found.parameters, "axial_stiffness": fit.axial_stiffness},
    )


def without_torque(log: Dataset) -> Dataset:
    """A log as it is without the sensor."""
    columns = {name: values for name, values in log.columns.items() if name != "tau_j"}
    return dataclasses.replace(Dataset.from_arrays(columns, log.name), sha256=log.sha256)
