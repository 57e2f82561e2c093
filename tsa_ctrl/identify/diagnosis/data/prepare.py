"""Logs made ready for scoring: admitted, denoised at the compute rate, torques averaged to the score rate.

Averaging is linear and the same for the measured torque and for every prediction, so comparing averages loses nothing
but resolution: a pulse shorter than one average keeps its area.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.denoise import denoised, denoised_within
from tsa_ctrl.identify.diagnosis.data.frame import Run
from tsa_ctrl.identify.diagnosis.data.thinning import informative
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model

Log = Dataset | Mapping[str, ArrayLike]
Logs = Sequence[Log] | Mapping[str, Mapping[str, ArrayLike]]

COMPUTE_RATE = 500.0  # Hz at most: reversals are placed to 2 ms
COMPUTE_SAMPLES = 90_000  # of all logs together at most: three minutes at COMPUTE_RATE
SCORE_RATE = 125.0  # Hz about: rate at which torques are compared
SCORE_SAMPLES = 12_000  # of all logs together at most: whitened columns of a thousand responses then fit into 100 MB


def prepare(logs: Logs, model: Model, hold_out: str | None = None) -> list[Run]:
    """Admit, choose, denoise and reduce the logs. Raises UsageError, one line that names log and column.

    hold_out: pattern of the logs that are held out, of which some stay where there are too many.
    """
    target = model.target
    datasets = _datasets(logs)
    for log in datasets:
        _admit(log, model, target)
    return _reduced(informative([log.completed_for(model) for log in datasets], hold_out), target)


def _datasets(logs: Logs) -> list[Dataset]:
    if isinstance(logs, Mapping):
        return [Dataset.from_arrays(columns, name) for name, columns in logs.items()]
    out = []
    for number, log in enumerate(logs):
        out.append(log if isinstance(log, Dataset) else Dataset.from_arrays(log, f"log_{number + 1}"))
    if not out:
        raise UsageError("diagnose: no log given; name at least one")
    names = [log.name for log in out]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise UsageError(f"diagnose: two logs are named {doubled[0]}; give each a different name")
    return out


def _admit(log: Dataset, model: Model, target: str) -> None:
    if target not in log:
        raise UsageError(
            f"{log.label or log.name}: column {target} is missing; this kind of model needs the measured "
            'joint torque (N·m): add it, or describe a drive without torque sensor as [actuator] kind = "rigid_drive"'
        )
    admit(log, model, target)


def _reduced(logs: Sequence[Dataset], target: str) -> list[Run]:
    slowest = min(log.rate for log in logs)
    total = sum(log.seconds for log in logs)
    rate = min(slowest, COMPUTE_RATE, COMPUTE_SAMPLES / total)
    factor = max(1, round(slowest / rate)) if slowest / rate > 1.3 else 1
    bin_ = max(1, round(slowest / factor / min(SCORE_RATE, SCORE_SAMPLES / total)))
    return [_run_of(log, log[target], factor * max(1, round(log.rate / slowest)), bin_) for log in logs]


def _run_of(log: Dataset, measured: Array, factor: int, bin_: int) -> Run:
    """One log with `factor` of its samples to one at the compute rate, `bin_` of those to a score sample.

    `measured` (n): the predicted torque, N*m.
    """
    full, noise, error = denoised(log)
    signals = full.means(factor)
    averages = _means(measured, factor), bin_, noise, _means(error, factor)
    return Run(log.name, signals, *averages, log, full, measured, factor * bin_)


def narrowed(run: Run, band: float) -> Run:
    """The run with derived motion up to `band` Hz; what does not change is shared with it, not made again."""
    factor = run.full_bin // run.bin
    clean, uncertain = denoised_within(run.raw, band)
    small: dict[str, Any] = {name: _means(y, factor) for name, y in clean.items()}
    noise, error = (
        (run.velocity_noise, run.velocity_error) if uncertain is None else (uncertain[0], _means(uncertain[1], factor))
    )
    return dataclasses.replace(
        run,
        signals=dataclasses.replace(run.signals, **small),
        full=dataclasses.replace(run.full, **cast(dict[str, Any], clean)),
        velocity_noise=noise,
        velocity_error=error,
        band=band,
    )


def _means(y: Array, factor: int) -> Array:
    whole = len(y) // factor * factor
    return np.asarray(y[:whole].reshape(-1, factor).mean(axis=1))
