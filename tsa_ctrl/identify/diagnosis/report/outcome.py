"""All that the stages of a diagnosis found, for its conclusion."""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.identify.diagnosis.data.audit import Audit
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Candidates
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.diagnosis.rivals.groups import Group
from tsa_ctrl.identify.diagnosis.selection.detection_limits import DetectionLimits
from tsa_ctrl.identify.diagnosis.selection.forward import Selection
from tsa_ctrl.model.effects.search import Scales


@dataclass(frozen=True)
class Outcome:
    """One field for each stage."""

    parts: Split
    audit: Audit
    scales: Scales
    testable: Candidates
    base: Fit  # recalibrated, without effects
    chosen: Selection
    findings: tuple[Finding, ...]  # what is left
    groups: tuple[Group, ...]  # one for each cause
    reported: Refit
    errors: HeldOut
    limits: DetectionLimits
