"""Diagnose many logs separately, on all cores or on a scheduler, with one table of verdicts; a run can be resumed."""

from tsa_ctrl.identify.fleet.ledger import Row
from tsa_ctrl.identify.fleet.sweep import logs_in, sweep

__all__ = ["Row", "logs_in", "sweep"]
