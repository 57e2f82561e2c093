"""Select the estimator of an axis without a configured kind: "sensor" or "stretch", both in use, otherwise "fixed".

A joint torque sensor measures the friction while the joint moves. The tendon elongation shows it only as well as the
model describes everything else that moves the motor against the joint. Random rigs with backlash, ripple, gear friction
and an eccentric pulley were tested. With the estimate by the elongation, the error of a locked joint was up to ten
times as large.

The friction torque by the elongation is proportional to 1/(1 - s_c). The file must therefore contain the centre s_c of
the bends with a small uncertainty. Stiffness, friction angle and pretension are learned. An effect that changes the
motor's torque or the tendons' friction would appear in the elongation as friction, and then be compensated twice.
"""

from __future__ import annotations

import msgspec

from tsa_ctrl.control.kalman import unsupported_reason as unsupported_by_sensor
from tsa_ctrl.control.settings import EstimatorSettings
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.specification import Stage
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import compliance_centre, unsupported_reason

LOOSEST = 0.25  # 1, bound of a stiffness that is learned within seconds; an error of 1/5 was, on simulated rigs
# 1, largest share of the friction torque that the place of the bends may leave uncertain. An even bend with its bound
# of 0.05 leaves 0.1.
SHAPE = 0.11
# Stages of effects that change neither the motor torque nor the tendons.
_APART = frozenset({Stage.VELOCITY, Stage.DIRECTION, Stage.JOINT, Stage.DELAY})
_KNOWN = frozenset({"elongation_coupling"})  # the observer's tendons include it


def chosen(
    settings: EstimatorSettings,
    model: TendonSheath,
    has_encoder: bool,
    has_torque_sensor: bool,
    follows_bending: bool,
    has_temperature: bool = False,
) -> tuple[EstimatorSettings, str]:
    """Return the settings with a kind and a use, and the reason in one line if the default is "fixed".

    `follows_bending`: True if the bending angle is measured or commanded, which only kind "map" uses.
    `has_temperature`: True if the axis measures the temperature.
    """
    if settings.kind is not None:
        return (settings if settings.use is not None else msgspec.structs.replace(settings, use=False)), ""
    if (
        has_torque_sensor
        and not follows_bending
        and _has_friction(model)
        and not unsupported_by_sensor(model, has_temperature)
    ):
        return msgspec.structs.replace(settings, kind="sensor", use=settings.use is not False), ""
    reason = reason_for_fixed(model, has_encoder)
    if reason or follows_bending:
        note = f"friction and pretension are the model file's (estimator fixed): {reason}" if reason else ""
        return msgspec.structs.replace(settings, kind="fixed", use=False), note
    return msgspec.structs.replace(settings, kind="stretch", use=settings.use is not False), ""


def reason_for_fixed(model: TendonSheath, has_encoder: bool) -> str:
    """Return the obstacle to an estimate from the tendon elongation; empty if there is none."""
    if not has_encoder:
        return "the elongation is the difference of motor and joint angle, which needs an [axis.encoder]"
    if not _has_friction(model):
        return "the model has no friction or no pretension that could be estimated"
    reason = unsupported_reason(model)
    if reason:
        return reason
    if model.bending_centre is None and "elongation_coupling" not in model.effects:
        return "the model file does not state where the sheath bends; give [sheath] bending_centre, or run tsa tune"
    if shape_share(model) > SHAPE:
        return (
            f"[uncertainty] bending_centre {model.bending_centre_uncertainty:g} leaves "
            f"{100.0 * shape_share(model):.0f} % of the half loop open, allowed are {100.0 * SHAPE:.0f}; tsa calibrate "
            "--stretch measures it"
        )
    if model.axial_stiffness_uncertainty > LOOSEST:
        return (
            f"[uncertainty] axial_stiffness {model.axial_stiffness_uncertainty:g} is above {LOOSEST:g}; "
            "tsa calibrate --stretch measures the stiffness"
        )
    for name, parameters in model.effects.items():
        apart = CATALOGUE[name].stage in _APART and parameters.get("stage") != "motor"
        if name not in _KNOWN and not apart:
            return f"[effects.{name}] would be taken for friction of the tendons by their stretch"
    return ""


def _has_friction(model: TendonSheath) -> bool:
    return model.friction_angle > 0.0 and model.pretension > 0.0 and model.bending_angle > 0.0


def shape_share(model: TendonSheath) -> float:
    """Return the share of the friction torque that the place of the bends leaves uncertain, 1 (95 %)."""
    return model.bending_centre_uncertainty / (1.0 - compliance_centre(model))
