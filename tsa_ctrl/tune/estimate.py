"""From logs to a new model: friction angle and pretension, and which form of the transmission predicts best."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import Calibration, calibrate
from tsa_ctrl.identify.calibrate.prepared import prepare
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict

CLEARLY_BETTER = 0.9  # of the error of what is there; another form, or an extension, must be below
EXCLUDES_COUPLING = frozenset({"tendon_slack", "sheath_asymmetry", "tension_dependent_friction", "elongation_coupling"})


class Form(Enum):
    """How the transmission is described; the values are said to people."""

    GIVEN = "as the file gives it"
    UNIFORM = "full model (3.53), evenly bent sheath"
    MOTOR_END = "full model (3.53), sheath bent at the motor"


@dataclass(frozen=True)
class Estimate:
    """The new model and how it came about.

    `calibration` is that of the form that was kept, `errors` each form's RMS error while sliding (N*m; all have the
    same two free parameters), `effects` what the diagnosis added with certainty.
    """

    model: TendonSheath
    calibration: Calibration
    form: Form
    errors: Mapping[Form, float]
    effects: tuple[str, ...]
    notes: tuple[str, ...]


def estimate(logs: Sequence[Dataset], model: TendonSheath, certified_gain: bool, forms: bool) -> Estimate:
    """Calibrate `model`; with `forms` also as the full model with an evenly or a motor-side bent sheath.

    Raises UsageError when the logs do not show enough.
    """
    candidates = {Form.GIVEN: model}
    if forms and not EXCLUDES_COUPLING & set(model.effects):
        for form, profile in ((Form.UNIFORM, "uniform"), (Form.MOTOR_END, "motor_end")):
            effects = {**model.effects, "elongation_coupling": {"curvature_profile": profile}}
            candidates[form] = model.with_effects(effects)
    found = {}
    for form, candidate in candidates.items():
        try:
            found[form] = calibrate(logs, candidate, certified_gain=certified_gain)
        except UsageError:
            if form is Form.GIVEN:
                raise
    errors = {form: sliding_error(logs, result.model) for form, result in found.items()}
    best = min(errors, key=lambda form: errors[form])
    if errors[best] > CLEARLY_BETTER * errors[Form.GIVEN]:
        best = Form.GIVEN
    notes = list(found[best].notes)
    if best is not Form.GIVEN:
        notes.append(
            f"{best.value} predicts sliding better than the given form ({1e3 * errors[best]:.1f} against "
            f"{1e3 * errors[Form.GIVEN]:.1f} mN*m); at one bending angle an error of the torque "
            "constant would look alike"
        )
    return Estimate(found[best].model, found[best], best, errors, (), tuple(notes))


def sliding_error(logs: Sequence[Dataset], model: TendonSheath) -> float:
    """Error of the prediction but its mean (N*m) where the joint surely slides; at reversals all forms err alike."""
    prepared = prepare(logs, model, {})
    errors = [(predict(model, log.signals) - log.tau_j)[log.mask] for log in prepared]
    return float(np.std(np.concatenate(errors)))


def extended(logs: Sequence[Dataset], model: TendonSheath, without: Estimate) -> Estimate:
    """`without`, or in its place the model that the diagnosis extends by effects of which it is certain.

    Certain: each cause is named without alternatives, and the extension predicts held-out data better.
    """
    from tsa_ctrl.identify.diagnosis import diagnose

    found = diagnose(list(logs), model)
    names = tuple(cause.effect for cause in found.causes)
    open_names = [cause.effect for cause in found.causes if cause.alternatives]
    before, after = found.rms.recalibrated, found.rms.extended
    if not names or not isinstance(found.model, TendonSheath) or before is None or after is None:
        return dataclasses.replace(without, notes=(*without.notes, f"diagnosis: {found.sentence}"))
    if open_names or after > CLEARLY_BETTER * before:
        note = f"diagnosis: {found.sentence}; not certain enough to be used ({', '.join(open_names) or 'no gain'})"
        return dataclasses.replace(without, notes=(*without.notes, note))
    return Estimate(
        found.model,
        without.calibration,
        Form.GIVEN,
        without.errors,
        names,
        (f"diagnosis: {found.sentence}",),
    )
