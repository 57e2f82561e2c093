"""From logs to a new model: friction angle and pretension, and which form of the transmission predicts best."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import Calibration, calibrate
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath

CLEARLY_BETTER = 0.97  # of the given form's held-out error; another form must be below
EXCLUDES_COUPLING = frozenset({"tendon_slack", "sheath_asymmetry", "tension_dependent_friction", "elongation_coupling"})


class Form(Enum):
    """How the transmission is described; the values are said to people."""

    GIVEN = "as the file gives it"
    UNIFORM = "full model (3.53), evenly bent sheath"
    MOTOR_END = "full model (3.53), sheath bent at the motor"


@dataclass(frozen=True)
class Estimate:
    """The new model and how it came about.

    `calibration` is that of the form that was kept, `held_out` each form's error on data not used for its fit (N*m),
    `effects` what the diagnosis added with certainty.
    """

    model: TendonSheath
    calibration: Calibration
    form: Form
    held_out: Mapping[Form, float]
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
    held_out = {form: result.rms_after for form, result in found.items()}
    best = min(held_out, key=lambda form: held_out[form])
    if held_out[best] > CLEARLY_BETTER * held_out[Form.GIVEN]:
        best = Form.GIVEN
    notes = list(found[best].notes)
    if best is not Form.GIVEN:
        notes.append(
            f"{best.value} predicts data not used for the fit better than the given form "
            f"({1e3 * held_out[best]:.1f} against {1e3 * held_out[Form.GIVEN]:.1f} mN*m); at one bending angle an "
            "error of the torque constant would look alike"
        )
    return Estimate(found[best].model, found[best], best, held_out, (), tuple(notes))


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
        without.held_out,
        names,
        (f"diagnosis: {found.sentence}",),
    )
