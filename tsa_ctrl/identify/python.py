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

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import Calibration
from tsa_ctrl.identify.calibrate import calibrate as estimate
from tsa_ctrl.identify.dataset import Dataset, load_log
from tsa_ctrl.identify.diagnosis import Diagnosis
from tsa_ctrl.identify.diagnosis import diagnose as explain
from tsa_ctrl.identify.simulate import simulate
from tsa_ctrl.model.parameters import Model, TendonSheath, load_model


def dataset(log: Any, name: str = "log") -> Dataset:
    """Return one log as a Dataset; raise UsageError if `log` has no usable form or lacks a column."""
    if isinstance(log, Dataset):
        return log
    if isinstance(log, (str, Path)):
        return load_log(log)
    columns = log if isinstance(log, Mapping) else {c: log[c] for c in getattr(log, "columns", ())}
    if not columns:
        raise UsageError(
            f"{name}: is a {type(log).__name__}; give a Dataset, a mapping of arrays, a data frame or a path"
        )
    return Dataset.from_arrays(columns, name)


def predict(model: Model | str | Path, log: Any) -> NDArray[np.float64]:
    """Return the joint torque that the model predicts, N*m, shape (n,); for a rigid drive, the motor torque."""
    return simulate(dataset(log), _model(model)).predicted


def calibrate(logs: Any, model: TendonSheath | str | Path) -> Calibration:
    """Estimate friction angle and pretension from one log or several."""
    found = _model(model)
    if not isinstance(found, TendonSheath):
        raise UsageError("calibrate: needs the model of a tendon-sheath; diagnose recalibrates a rigid drive")
    return estimate(_all(logs), found)


def diagnose(logs: Any, model: Model | str | Path, *, hold_out: str | None = None, seed: int = 0) -> Diagnosis:
    """Find and explain the errors of the model on one log or several; the same seed yields the same result."""
    return explain(_all(logs), _model(model), hold_out=hold_out, seed=seed)


def _model(model: Model | str | Path) -> Model:
    return load_model(model) if isinstance(model, (str, Path)) else model


def _all(logs: Any) -> list[Dataset]:
    several = isinstance(logs, Sequence) and not isinstance(logs, str)
    if isinstance(logs, Mapping) and logs and all(np.ndim(log) != 1 for log in logs.values()):
        return [dataset(log, str(name)) for name, log in logs.items()]
    return [dataset(log, f"log {i}") for i, log in enumerate(logs, start=1)] if several else [dataset(logs)]
