"""What a diagnosis found: the object that `diagnose` returns and that `diagnosis.json` is written from."""

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

SCHEMA = 2  # of diagnosis.json: it changes when a reader of the last one would go wrong
DIGITS = 6  # significant, of every number written: more is rounding of this machine


class Verdict(Enum):
    """What the logs say of the model."""

    CONSISTENT = "consistent"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"
    INSUFFICIENT = "insufficient"


@dataclass(frozen=True)
class Cause:
    """A claim: this effect acts, or one of `alternatives` in its place (none when the name is sure).

    `probability`: of `effect` within it and its alternatives. `explained_fraction`: share of the improvement that is
    lost without it. `parameters`: numbers with intervals (infinite where these logs leave all open that is allowed),
    choices as words. `rivals`: the model with each alternative in its place, fitted to the same logs. `others`: the
    probability of each alternative, estimated from these logs alone.
    """

    effect: str
    alternatives: tuple[str, ...]
    probability: float
    parameters: Mapping[str, Quantity | str]
    explained_fraction: float
    rivals: Mapping[str, Model] = field(default_factory=dict, compare=False, repr=False)
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ParameterError:
    """A number of the base model: what the file says, and what the logs say."""

    nominal: float
    found: Quantity


@dataclass(frozen=True)
class Rms:
    """Errors of the simulation in N*m over all held-out samples; None where nothing could be said.

    `simulated`: of the model as given over all samples, held out or not.
    """

    as_given: float | None = None
    recalibrated: float | None = None
    extended: float | None = None
    noise_floor: float | None = None  # the noise of the sensor
    refitted: float | None = None  # the extended model after a fit to the held-out samples
    simulated: float | None = None


@dataclass(frozen=True)
class StretchRms:
    """What is left of the tendons' stretch, m, without and with the effects that only it shows."""

    without: float
    extended: float


@dataclass(frozen=True)
class Experiment:
    """The motion that would settle what is open: in words, and as a set-point (t in s, tau_j_des in N*m)."""

    text: str
    t: tuple[float, ...] = ()
    tau_j_des: tuple[float, ...] = ()

    def csv(self) -> str:
        """The set-point file as `tsa run` and `tsa tune` play it."""
        rows = [f"{t:.4f},{torque:.6g}" for t, torque in zip(self.t, self.tau_j_des, strict=True)]
        return "\n".join(["t,tau_j_des", *rows]) + "\n"


@dataclass(frozen=True, repr=False)
class Diagnosis(Displayed):
    """Result of `diagnose`; `to_json` is the contents of diagnosis.json; `report.page.write` makes the whole report.

    `sentence` is the first line of the report. `model` is the extended model, or the recalibrated one when nothing was
    named, or the given one when the logs say nothing. `at_bounds`: (value, low, high, unit) of its friction angle or
    pretension where [uncertainty] holds it. `formula`: what it leaves, where that follows one. `stretch`: None where
    the logs lack an angle.
    `errors`: of `model` over all samples of all logs, as `tsa simulate` prints them.
    `gain`: over held-out samples whose direction is known; `gain_all`: over all that are held out.
    `details` holds the curves that `report.pictures.plot` draws.
    """

    verdict: Verdict
    sentence: str
    causes: tuple[Cause, ...]
    parameter_errors: Mapping[str, ParameterError]
    unexplained: str
    not_testable: Mapping[str, str]
    detection_limit: Mapping[str, float]
    experiment: Experiment
    rms: Rms
    gain: float
    model: Model
    at_bounds: Mapping[str, tuple[float, float, float, str]] = field(default_factory=dict)
    formula: Formula | None = None
    stretch: StretchRms | None = None
    errors: ThreeErrors = field(default_factory=ThreeErrors)
    gain_all: float = 0.0
    details: Details | None = field(default=None, compare=False, repr=False)

    @property
    def of_torque(self) -> tuple[Cause, ...]:
        """The causes without those that only the stretch shows."""
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
        """The public JSON object."""
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
        """The text of diagnosis.json; the same input gives the same text."""
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
