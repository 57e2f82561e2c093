"""Define the result of a diagnosis: the object that `diagnose` returns and from which diagnosis.json is written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

from tsa_ctrl.display import Displayed, bars
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula
from tsa_ctrl.identify.diagnosis.report.details import Details
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.three_errors import ThreeErrors
from tsa_ctrl.model.catalogue import of_the_stretch
from tsa_ctrl.model.parameters import Model
from tsa_ctrl.outputs import json_types

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = 2  # version of diagnosis.json: it changes if a program for the previous version would misread the file
DIGITS = 6  # significant digits of every written number: further digits depend on the rounding of the machine


class Verdict(Enum):
    """List the possible conclusions about the model from the logs."""

    CONSISTENT = "consistent"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"
    INSUFFICIENT = "insufficient"


@dataclass(frozen=True)
class Cause:
    """An identified cause: either `effect` acts, or one of `alternatives` acts in its place.

    A parameter is a number with its interval, or a choice as a word. An interval is infinite if the logs do not
    constrain the parameter within its bounds.
    """

    effect: str
    alternatives: tuple[str, ...]  # empty if the logs exclude all other effects
    probability: float  # of `effect`, compared with its alternatives
    parameters: Mapping[str, Quantity | str]
    explained_fraction: float  # share of the improvement that is lost without this cause
    # The model with each alternative in place of the effect, fitted to the same logs
    rivals: Mapping[str, Model] = field(default_factory=dict, compare=False, repr=False)
    others: Mapping[str, float] = field(default_factory=dict)  # probability of each alternative, from these logs alone


@dataclass(frozen=True)
class ParameterError:
    """A parameter of the base model, from the model file and from the logs."""

    nominal: float  # value of the model file
    found: Quantity  # value determined from the logs


@dataclass(frozen=True)
class Rms:
    """RMS errors of the simulation over all held-out samples, N*m; None if an error could not be determined."""

    as_given: float | None = None
    recalibrated: float | None = None
    extended: float | None = None
    noise_floor: float | None = None  # the sensor noise
    refitted: float | None = None  # the extended model after a fit to the held-out samples
    simulated: float | None = None  # the nominal model over all samples, as `tsa simulate` prints
    # On held-out samples with a known direction: the better of nominal and recalibrated model, and the extended model
    sliding: tuple[float, float] | None = None


@dataclass(frozen=True)
class StretchRms:
    """RMS residual of the tendon elongation, m, without and with the effects that only the elongation shows."""

    without: float
    extended: float


@dataclass(frozen=True)
class Experiment:
    """The motion that would resolve the open questions: in words, and as a set-point (t in s, tau_j_des in N*m)."""

    text: str
    t: tuple[float, ...] = ()
    tau_j_des: tuple[float, ...] = ()

    def csv(self) -> str:
        """Return the text of the set-point file for `tsa run` and `tsa tune`."""
        rows = [f"{t:.4f},{torque:.6g}" for t, torque in zip(self.t, self.tau_j_des, strict=True)]
        return "\n".join(["t,tau_j_des", *rows]) + "\n"


@dataclass(frozen=True, repr=False)
class Diagnosis(Displayed):
    """Result of `diagnose`.

    `to_json` returns the contents of diagnosis.json. `report.page.write` writes the whole report.

    `model` is the extended model, which contains the causes. If no cause of the torque error is identified, it is based
    on the recalibrated or the nominal model, whichever has the smaller error on held-out data. For insufficient logs,
    it is the nominal model.
    """

    verdict: Verdict
    sentence: str  # first line of the report
    causes: tuple[Cause, ...]
    parameter_errors: Mapping[str, ParameterError]
    unexplained: str
    not_testable: Mapping[str, str]
    detection_limit: Mapping[str, float]
    experiment: Experiment
    rms: Rms
    gain: float  # share of the explainable error that the causes remove, on held-out samples with a known direction
    model: Model
    # (value, low, high, unit) of the friction angle or the pretension of `model` if it lies at a bound of [uncertainty]
    at_bounds: Mapping[str, tuple[float, float, float, str]] = field(default_factory=dict)
    formula: Formula | None = None  # of the residual; None if no formula describes it
    stretch: StretchRms | None = None  # None if the elongation could not be tested, for example without an angle
    errors: ThreeErrors = field(default_factory=ThreeErrors)  # of `model` over all samples, as `tsa simulate` prints
    nominal_errors: ThreeErrors = field(default_factory=ThreeErrors)  # the same of the nominal model
    gain_all: float = 0.0  # same as `gain`, but on all held-out samples
    details: Details | None = field(default=None, compare=False, repr=False)  # curves for `report.pictures.plot`

    @property
    def of_torque(self) -> tuple[Cause, ...]:
        """Return the causes without those that only the tendon elongation shows."""
        beside, _ = of_the_stretch([cause.effect for cause in self.causes])
        return tuple(cause for cause in self.causes if cause.effect not in beside)

    def facts(self) -> dict[str, str]:
        """Return the verdict, each cause with its parameters, and the errors on held-out data."""
        found = {"verdict": self.verdict.value}
        for cause in self.causes:
            values = ", ".join(f"{name} {value}" for name, value in cause.parameters.items())
            others = f" (or {', '.join(cause.alternatives)})" if cause.alternatives else ""
            found[cause.effect + others] = values
        errors = [f"{name} {value:.4g}" for name, value in self._rms_errors().items()]
        return {**found, "error (N·m)": ", ".join(errors) or "-"}

    def _rms_errors(self) -> dict[str, float]:
        """Return the known RMS errors by name, N*m."""
        rms = self.rms
        every = {
            "nominal": rms.as_given,
            "recalibrated": rms.recalibrated,
            "extended": rms.extended,
            "sensor noise": rms.noise_floor,
        }
        return {name: value for name, value in every.items() if value is not None}

    def plot(self) -> Figure:
        """Return a picture of the RMS errors on held-out data."""
        return bars(self._rms_errors(), "RMS error on held-out data (N·m)", self.sentence.split(":")[0])

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of diagnosis.json as a dictionary."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict.value,
            "causes": [
                {
                    "effect": cause.effect,
                    "alternatives": list(cause.alternatives),
                    "probability": _rounded(cause.probability),
                    "alternative_probabilities": {name: _rounded(value) for name, value in cause.others.items()},
                    "parameters": {name: _plain(value) for name, value in cause.parameters.items()},
                    "explained_fraction": _rounded(cause.explained_fraction),
                }
                for cause in self.causes
            ],
            "parameter_errors": {
                name: {"nominal": _rounded(error.nominal), **_plain(error.found)}
                for name, error in self.parameter_errors.items()
            },
            "unexplained": {"present": bool(self.unexplained), "description": self.unexplained},
            "not_testable": dict(self.not_testable),
            "detection_limit": {name: _rounded(value) for name, value in self.detection_limit.items()},
            "experiment": self.experiment.text,
            "rms": {
                "as_given": _rounded(self.rms.as_given),
                "recalibrated": _rounded(self.rms.recalibrated),
                "extended": _rounded(self.rms.extended),
                "noise_floor": _rounded(self.rms.noise_floor),
                "refitted": _rounded(self.rms.refitted),
                "unit": "N*m",
                "held_out": True,
            },
            "at_bounds": {
                name: {"value": _rounded(value), "low": _rounded(low), "high": _rounded(high), "unit": unit}
                for name, (value, low, high, unit) in self.at_bounds.items()
            },
            "formula": None if self.formula is None else _formula(self.formula),
            "simulated": {"rms": _rounded(self.rms.simulated), "unit": "N*m"},
            "stretch": None
            if self.stretch is None
            else {"without": _rounded(self.stretch.without), "extended": _rounded(self.stretch.extended), "unit": "m"},
            "errors": {k: _rounded(v) if isinstance(v, float) else v for k, v in self.errors.to_dict().items()},
            "gain": _rounded(self.gain),
            "gain_all": _rounded(self.gain_all),
            "summary": self.sentence,
        }

    def to_json(self) -> str:
        """Return the text of diagnosis.json; the same input always yields the same text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _rounded(x: float | None) -> float | None:
    if x is None or not math.isfinite(x):
        return None
    return float(f"{x:.{DIGITS}g}")


def _formula(found: Formula) -> dict[str, Any]:
    return {
        "expression": found.expression,
        "constants": {name: _plain(value) for name, value in found.constants.items()},
        "ranges": {name: [_rounded(low), _rounded(high)] for name, (low, high) in found.ranges.items()},
        "gain": _rounded(found.gain),
        "rms": {"before": _rounded(found.rms[0]), "after": _rounded(found.rms[1]), "unit": "N*m", "held_out": True},
        "logs": {"better": found.better, "of": found.logs},
    }


def _plain(value: Quantity | str) -> Any:
    if isinstance(value, str):
        return value
    return {key: _rounded(x) if isinstance(x, float) else x for key, x in json_types(value).items()}
