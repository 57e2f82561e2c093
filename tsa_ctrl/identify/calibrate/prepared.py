"""Logs made ready for the fits: signals, admission, blocks of time, and the known change of the pretension."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify import admit as admissible
from tsa_ctrl.identify.calibrate.admission import Admission, admit, require
from tsa_ctrl.identify.calibrate.regression import block_labels, choose_lag
from tsa_ctrl.identify.dataset import Dataset, matches
from tsa_ctrl.identify.energy import foreign_torque
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.signals import Signals

FloatArray = NDArray[np.float64]

LAG_LIMIT = 0.5  # s: noise of the motor torque is uncorrelated beyond this
VARIED_FRACTION = 0.05  # a bending angle or pretension that varies by less is one configuration


@dataclass(frozen=True)
class PreparedLog:
    """One log prepared for the fits; `tensioner` is a known change of the pretension in N."""

    name: str
    signals: Signals
    tau_j: FloatArray
    tensions: FloatArray | None  # measured (T1 + T3)/2, N
    admission: Admission
    labels: NDArray[np.int64]
    tensioner: float
    chosen: NDArray[np.bool_]  # samples of this log that belong to the set at hand

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Samples to learn from (n)."""
        return self.admission.mask & self.chosen

    def restricted(self, chosen: NDArray[np.bool_]) -> PreparedLog:
        """The same log of which only some samples count; memory effects still see the whole motion."""
        return dataclasses.replace(self, chosen=self.chosen & chosen)


def prepare(logs: Sequence[Dataset], model: TendonSheath, tensioner: Mapping[str, float]) -> list[PreparedLog]:
    """Each log with what is admitted of it; `tensioner`: patterns of names to changes of T_p0, N. Raises UsageError."""
    if not logs:
        raise UsageError("calibrate: no log given; name at least one")
    for pattern in tensioner:
        if not any(matches(d.name, pattern) for d in logs):
            raise UsageError(
                f"calibrate: tensioner '{pattern}' matches no log; logs are {', '.join(d.name for d in logs)}"
            )
    _check_different(logs)
    admissions, prepared = [], []
    labels = block_labels([d.columns["t"].size for d in logs])
    for dataset, label in zip(logs, labels, strict=True):
        admissible.admit(dataset, model, "tau_j")
        signals = dataset.signals()
        admission = admit(signals.t, signals.omega_j)
        admissions.append(admission)
        change = sum(value for pattern, value in tensioner.items() if matches(dataset.name, pattern))
        columns = dataset.columns
        tensions = 0.5 * (columns["t1"] + columns["t3"]) if "t1" in columns and "t3" in columns else None
        everything = np.ones(signals.t.size, dtype=np.bool_)
        prepared.append(
            PreparedLog(dataset.name, signals, columns["tau_j"], tensions, admission, label, change, everything)
        )
    where = logs[0].name if len(logs) == 1 else f"{len(logs)} logs"
    require(admissions, [p.signals.tau_m for p in prepared], where)
    for dataset in logs:
        foreign = foreign_torque(dataset, model)
        if foreign:
            raise UsageError(f"{dataset.label or dataset.name}: {foreign}")
    return [p for p in prepared if p.mask.any()]


def _check_different(logs: Sequence[Dataset]) -> None:
    """The same data twice would make every interval too narrow."""
    seen: dict[tuple[str, float], str] = {}
    for log in logs:
        piece = log.sha256, float(log.columns["t"][0])  # of one file, between its holes
        if log.sha256 and piece in seen:
            raise UsageError(f"calibrate: {seen[piece]} and {log.name} hold the same data; give each log once")
        seen[piece] = log.name


def varied(logs: list[PreparedLog], model: TendonSheath) -> bool:
    """Whether bending angle or pretension varied, and by known amounts."""
    changes = [log.tensioner for log in logs]
    if max(changes) - min(changes) > VARIED_FRACTION * model.pretension:
        return True
    theta = np.concatenate(
        [np.zeros(0)] + [log.signals.theta[log.mask] for log in logs if log.signals.theta is not None]
    )
    return theta.size > 0 and float(np.ptp(theta)) > VARIED_FRACTION * model.bending_angle


def instrument_lag(logs: list[PreparedLog]) -> int:
    """Samples beyond which the noise of the motor torque no longer correlates with itself."""
    residuals = []
    for log in logs:
        x = np.column_stack([log.signals.tau_m, log.admission.direction, np.ones(log.tau_j.size)])
        if log.signals.theta is not None:
            x = np.column_stack([x, x * (log.signals.theta - log.signals.theta.mean())[:, None]])
        b = np.linalg.lstsq(x[log.mask], log.tau_j[log.mask], rcond=None)[0]
        residuals.append(np.where(log.mask, log.tau_j - x @ b, 0.0))
    period = float(logs[0].signals.t[1] - logs[0].signals.t[0])
    return choose_lag([log.signals.tau_m for log in logs], residuals, max(2, round(LAG_LIMIT / period)))


def offsets(logs: list[PreparedLog]) -> list[FloatArray]:
    """For each log, columns (n, m) of which its own is 1: a sensor's zero moves from log to log, not within one."""
    return [np.broadcast_to(row, (log.tau_j.size, len(logs))) for row, log in zip(np.eye(len(logs)), logs, strict=True)]


def stack(parts: list[FloatArray], logs: list[PreparedLog]) -> FloatArray:
    """The admitted samples of all logs in one array; `parts`: one array per log."""
    return np.concatenate([part[log.mask] for part, log in zip(parts, logs, strict=True)])
