"""Predict the torque of a log with a model, and compute the error."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.three_errors import ThreeErrors, three_errors
from tsa_ctrl.identify.units import TORQUES
from tsa_ctrl.log.convert import write_columns
from tsa_ctrl.model.parameters import Model, TendonSheath
from tsa_ctrl.model.predict import beyond_slack, predict
from tsa_ctrl.model.signals import Signals

Array = NDArray[np.float64]

# Error over the RMS of the measured torque: a model with a smaller error describes the log as it was recorded
LARGE = 0.5
ALIKE = 1.2  # ratio of two errors up to which either column may be wrong, as on a locked joint
MUCH_BETTER = 0.3  # largest ratio of the error with the corrected column: a wrong model does not improve as much
COURSES = ("tau_m", "tau_j", "omega_j", "omega_m")  # columns; one of them must vary for a meaningful error


@dataclass(frozen=True)
class Simulation:
    """The prediction of one model for all samples of one log, in SI units.

    `quantity` is the predicted column: tau_j, or tau_m for a plain drive. `predicted` and `residual` have shape (n,).
    The residual is measured minus predicted torque, or None if the log lacks the column. `beyond_slack` is the fraction
    of samples at which one tendon is slack; `slack_modelled` is True if the model has an effect for slack.
    """

    name: str
    quantity: str
    predicted: Array
    residual: Array | None
    beyond_slack: float
    slack_modelled: bool
    errors: ThreeErrors = field(default_factory=ThreeErrors)  # unknown without a measured torque
    likely: str = ""  # the likely wrong sign or unit of a torque column; empty without one

    @property
    def rms(self) -> float | None:
        """Return the root mean square of the residual, N*m; None without a measurement."""
        return None if self.residual is None else float(np.sqrt(np.mean(self.residual**2)))

    @property
    def bias(self) -> float | None:
        """Return the mean of the residual, N*m; None without a measurement."""
        return None if self.residual is None else float(np.mean(self.residual))

    @property
    def max_abs(self) -> float | None:
        """Return the largest absolute residual, N*m; None without a measurement."""
        return None if self.residual is None else float(np.max(np.abs(self.residual)))

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of this model in the JSON object."""
        return {
            "model": self.name,
            "rms": self.rms,
            "bias": self.bias,
            "max_abs": self.max_abs,
            "unit": "N*m",
            "samples": len(self.predicted),
            "beyond_slack": self.beyond_slack,
            "quantity": self.quantity,
            "errors": self.errors.to_dict(),
        }


def simulate(dataset: Dataset, model: Model, name: str = "model") -> Simulation:
    """Return the prediction of one model for a log, with its errors.

    Raises:
        UsageError: the log lacks a required column or cannot be used with the model, or the prediction is not finite.
    """
    dataset = dataset.completed_for(model)
    admit(dataset, model)
    signals = dataset.signals()
    predicted = predict(model, signals)
    quantity = model.target
    residual = dataset[quantity] - predicted if quantity in dataset else None
    if not np.isfinite(predicted).all():
        row = int(np.argmin(np.isfinite(predicted)))
        raise UsageError(
            f"{name}: predicts no finite torque for {dataset.label} from t = {dataset['t'][row]:g} s on; its "
            "parameters do not fit this log: check its effects"
        )
    slack_modelled = isinstance(model, TendonSheath) and "tendon_slack" in model.effects
    errors = ThreeErrors() if residual is None else three_errors([dataset], [residual], quantity)
    likely = "" if residual is None else likely_mistake(dataset[quantity], model, signals, predicted)
    return Simulation(name, quantity, predicted, residual, beyond_slack(model, signals), slack_modelled, errors, likely)


def likely_mistake(measured: Array, model: Model, signals: Signals, predicted: Array) -> str:
    """Return the sign or unit of a torque column that is likely wrong; empty without one.

    A sign or a unit is wrong if the model describes the log much better with this column corrected.

    Args:
        measured: measured torque of the column that the model predicts, (n,) in N*m.
        model: the model.
        signals: the signals of the log.
        predicted: torque predicted from these signals, (n,) in N*m.
    """
    before = _relative(measured, predicted)
    if not before > LARGE:
        return ""
    corrected = [(_relative(factor * measured, predicted), model.target, factor) for factor, _ in _factors()]
    if model.target != "tau_m":
        corrected += [(_by_motor(factor, measured, model, signals), "tau_m", factor) for factor, _ in _factors()]
    after, _, factor = min(corrected)
    if not after < MUCH_BETTER * before:
        return ""
    columns = " or ".join(name for error, name, own in corrected if own == factor and error < ALIKE * after)
    fault, remedy = dict(_factors())[factor]
    slope = float(predicted @ measured) / max(float(predicted @ predicted), 1e-300)
    return (
        f"column {columns} is likely {fault}: with {factor:.4g} times its values, the error is {after:.0%} instead of "
        f"{before:.0%} of the measured torque (regression slope of measured over predicted torque {slope:.3g}); "
        f"{remedy}"
    )


def _factors() -> Iterator[tuple[float, tuple[str, str]]]:
    """Yield each factor that corrects a sign or a unit, with the fault and its remedy."""
    yield -1.0, ("reversed", "turn its sign")
    for sign, turned, also in ((1.0, "", ""), (-1.0, "reversed and ", " and turn its sign")):
        for size, unit in TORQUES:
            yield sign / size, (f"{turned}in {unit}", f"convert it to N*m{also}")
        yield sign * 1000.0, (f"{turned}in kN*m", f"convert it to N*m{also}")


def _by_motor(factor: float, measured: Array, model: Model, signals: Signals) -> float:
    """Return the error as in `_relative` with `factor` times the motor torque; infinite if no torque is predicted."""
    try:
        return _relative(measured, predict(model, replace(signals, tau_m=factor * signals.tau_m)))
    except UsageError:  # the formula of a model file may have no value beyond its range
        return math.inf


def _relative(measured: Array, predicted: Array) -> float:
    """Return the RMS error over the RMS of the measured torque; not a finite number without a torque."""
    with np.errstate(all="ignore"):
        return float(np.sqrt(np.mean(np.square(measured - predicted)) / np.mean(np.square(measured))))


def simulate_all(dataset: Dataset, models: Sequence[tuple[str, Model]]) -> list[Simulation]:
    """Return the predictions of several models, given as (name, model).

    Raises:
        UsageError: as `simulate`, or the models do not predict the same quantity.
    """
    simulations = [simulate(dataset, model, name) for name, model in models]
    for simulation in simulations[1:]:
        if simulation.quantity != simulations[0].quantity:
            raise UsageError(
                f"{simulation.name} predicts {simulation.quantity}, {simulations[0].name} {simulations[0].quantity}; "
                "simulate a plain drive and a tendon-sheath in two calls"
            )
    return simulations


def unmoved(dataset: Dataset) -> str | None:
    """Return a remark if no column of `COURSES` changes in the log, or None if one does.

    The error of such a log is valid only for a single operating point.
    """
    constant = [name for name in COURSES if name in dataset and np.ptp(dataset[name]) == 0.0]
    if any(name in dataset and name not in constant for name in COURSES):
        return None
    change = "changes" if len(constant) == 1 else "change"
    return f"{', '.join(constant)} never {change}: an error of this log belongs to one point"


def labels(paths: Sequence[str]) -> list[str]:
    """Return short names for model files: the file's name, or the given path if two files have the same name."""
    names = [Path(path).name for path in paths]
    count = Counter(names)
    return [name if count[name] == 1 else path for name, path in zip(names, paths, strict=True)]


def write_csv(path: Path, dataset: Dataset, simulations: Sequence[Simulation]) -> None:
    """Write the columns t, tau_j, tau_j_sim and residual (numbered for several models); tau_m for a plain drive.

    Without a measurement of the torque, the file has neither the measured torque nor residuals.
    """
    quantity = simulations[0].quantity
    columns = {"t": dataset["t"]}
    if quantity in dataset:
        columns[quantity] = dataset[quantity]
    numbers = [""] if len(simulations) == 1 else [f"_{i + 1}" for i in range(len(simulations))]
    for number, simulation in zip(numbers, simulations, strict=True):
        columns[f"{quantity}_sim{number}"] = simulation.predicted
    for number, simulation in zip(numbers, simulations, strict=True):
        if simulation.residual is not None:
            columns[f"residual{number}"] = simulation.residual
    write_columns(path, columns, keeping=False)  # the caller has made a backup
