"""Diagnosis of a model on logs: what the simulation gets wrong, the cause, the extended model, the gain."""

from tsa_ctrl.identify.diagnosis.pipeline import diagnose
from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Verdict

__all__ = ["Cause", "Diagnosis", "Verdict", "diagnose"]
