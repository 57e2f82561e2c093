"""Provide the public Python functions of `tsa_ctrl`; models and logs may be objects, mappings, data frames or files.

A log is a Dataset, a mapping from column to array, a pandas or polars frame, or the path of a file. Columns and units
are those of the log table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.arguments import kind_of, listing_arguments, whole_of
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import Calibration
from tsa_ctrl.identify.calibrate import calibrate as estimate
from tsa_ctrl.identify.dataset import Dataset, dataset_of
from tsa_ctrl.identify.diagnosis import Diagnosis
from tsa_ctrl.identify.diagnosis import diagnose as explain
from tsa_ctrl.identify.simulate import simulate
from tsa_ctrl.model.parameters import Model, TendonSheath, load_model


@listing_arguments
def predict(model: Model | str | Path | Mapping[str, Any], log: Any) -> NDArray[np.float64]:
    """Return the joint torque that the model predicts, N*m, shape (n,); for a rigid drive, the motor torque."""
    return simulate(dataset_of(log), load_model(model)).predicted


@listing_arguments
def calibrate(logs: Any, model: TendonSheath | str | Path | Mapping[str, Any]) -> Calibration:
    """Estimate friction angle and pretension from one log or several."""
    found = load_model(model)
    if not isinstance(found, TendonSheath):
        raise UsageError("calibrate: needs the model of a tendon-sheath; diagnose recalibrates a rigid drive")
    return estimate(_all(logs), found)


@listing_arguments
def diagnose(
    logs: Any, model: Model | str | Path | Mapping[str, Any], *, hold_out: str | None = None, seed: int = 0
) -> Diagnosis:
    """Find and explain the errors of the model on one log or several; the same seed yields the same result."""
    if hold_out is not None and not isinstance(hold_out, str):
        raise UsageError(f"diagnose: hold_out is a {kind_of(hold_out)}; give a pattern of names of logs, or None")
    return explain(_all(logs), load_model(model), hold_out=hold_out, seed=whole_of(seed, "diagnose: seed"))


def _all(logs: Any) -> list[Dataset]:
    several = isinstance(logs, Sequence) and not isinstance(logs, str)
    if isinstance(logs, Mapping) and logs and all(np.ndim(log) != 1 for log in logs.values()):
        return [dataset_of(log, str(name)) for name, log in logs.items()]
    return [dataset_of(log, f"log {i}") for i, log in enumerate(logs, start=1)] if several else [dataset_of(logs)]
