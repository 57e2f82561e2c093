"""Estimate friction angle and pretension from logs, with intervals that include model errors."""

from tsa_ctrl.identify.calibrate.estimate import calibrate, errors_of, routing_of_logs
from tsa_ctrl.identify.calibrate.result import Calibration

__all__ = ["Calibration", "calibrate", "errors_of", "routing_of_logs"]
