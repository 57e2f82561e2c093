"""The catalogue's effects as candidates on these logs: what can be tested, and why the rest cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.hypotheses.scales import Scales
from tsa_ctrl.identify.diagnosis.hypotheses.variants import BUILDERS, Catalogue, Variant
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.parameters import Model, RigidDrive, TendonSheath
from tsa_ctrl.model.predict import missing_for


@dataclass(frozen=True)
class Candidates:
    """Variants by effect, and the effects that these logs cannot test, with the reason: together the catalogue."""

    catalogue: Catalogue
    not_testable: Mapping[str, str]


def candidates(frame: Frame, model: Model, scales: Scales) -> Candidates:
    """What the catalogue says of these logs."""
    rigid = isinstance(model, RigidDrive)
    found: dict[str, tuple[Variant, ...]] = {}
    refused: dict[str, str] = {}
    for name, spec in CATALOGUE.items():
        if spec.named:
            continue  # the user's own formula is no hypothesis
        reason = _untestable(name, frame, model, scales, rigid)
        if reason:
            refused[name] = reason
            continue
        variants = tuple(v for v in BUILDERS[name](scales, frame) if v.starts)
        if variants:
            found[name] = variants
        else:
            refused[name] = _UNRESOLVED.get(name, "the log does not reach the scale on which it acts")
    return Candidates(found, refused)


_UNRESOLVED = {
    "torque_ripple": "the motor turns too little to show a line of its angle",
    "stribeck_friction": "the velocity is too noisy to resolve slow motion",
    "presliding_hysteresis": "the motion is too small to show a build-up after reversals",
}


def _untestable(name: str, frame: Frame, model: Model, scales: Scales, rigid: bool) -> str:
    """Why this log cannot test an effect; empty when it can."""
    if name in model.effects:
        return "already in the model file"
    clash = [other for other in CATALOGUE[name].excludes if other in model.effects]
    if clash:
        return f"the model file has {clash[0]}, which excludes it"
    if rigid:
        assert isinstance(model, RigidDrive)
        if not CATALOGUE[name].rigid_drive:
            return "has no meaning for a plain drive"
        if name in ("inertia", "viscous_friction", "torque_offset") and getattr(model, name) is not None:
            return "part of the base model, which is recalibrated"
    for run in frame.runs:
        missing = missing_for(name, run.signals, rigid=rigid)
        if missing:
            return f"no {' or '.join(missing)} column"
    if name == "velocity_lag":
        derived = "omega_m" if rigid else "omega_j"
        if any(derived in run.raw.derived for run in frame.runs):
            return f"{derived} was derived from the angle by a zero-phase filter"
    if name == "thermal_friction_drift" and scales.heating < 0.5:
        return f"the temperature varies by {scales.heating:.2g} K only"
    if name == "stiffness_nonlinearity" and not _pretension_varies(frame, model):
        return "the path length is not varied (no column theta that changes)"
    return ""


def _pretension_varies(frame: Frame, model: Model) -> bool:
    assert isinstance(model, TendonSheath)
    angles = [run.signals.theta for run in frame.runs if run.signals.theta is not None]
    return bool(angles) and float(np.ptp(np.concatenate(angles))) > 0.01 * max(model.bending_angle, 1e-9)
