"""Which logs a diagnosis takes: datasets or arrays, each named once, and what cannot be right is refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from numpy.typing import ArrayLike

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import Model, RigidDrive

Log = Dataset | Mapping[str, ArrayLike]
Logs = Sequence[Log] | Mapping[str, Mapping[str, ArrayLike]]


def admitted(logs: Logs, model: Model) -> list[Dataset]:
    """The logs as datasets. Raises UsageError, one line that names log and column, where one cannot be right."""
    datasets, target = _datasets(logs), target_of(model)
    for log in datasets:
        if target not in log:
            raise UsageError(
                f"{log.label or log.name}: column {target} is missing; the diagnosis of a tendon-sheath needs the "
                "measured joint torque (N*m): add it, or describe a drive without torque sensor as [actuator] "
                'kind = "rigid_drive"'
            )
        admit(log, model, target)
    return datasets


def target_of(model: Model) -> str:
    """The column that the model predicts."""
    return "tau_m" if isinstance(model, RigidDrive) else "tau_j"


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
        raise UsageError(f"diagnose: two logs are named {doubled[0]}; give each a name of its own")
    return out
