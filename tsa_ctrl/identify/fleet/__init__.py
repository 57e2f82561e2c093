"""Fleets of logs: each diagnosed separately, on all cores or on a scheduler, resumable, with one table of verdicts."""

from tsa_ctrl.identify.fleet.ledger import Row
from tsa_ctrl.identify.fleet.sweep import logs_in, sweep

__all__ = ["Row", "logs_in", "sweep"]
