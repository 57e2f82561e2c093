"""Friction that drifts with a temperature which nobody recorded: the twin of a pretension that relaxes.

Any course of the temperature is possible then, so the rival gets the one that imitates the relaxation best: its own.
Only the slope, which follows friction and not pretension, can part the two.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, safely
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.hypotheses.base import Coordinate
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Variant
from tsa_ctrl.model.catalogue import Value
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import Signals

RISE = 10.0  # K, of the temperature that is made up
REFERENCE = 25.0  # deg C


def warmth(problem: Problem, fitted: Fit, smaller: Fit, index: int) -> Fit | None:
    """The fit of `smaller` with a hidden warm-up in place of the relaxation, which is number `index` of `fitted`.

    None where a temperature was recorded.
    """
    frame = problem.frame
    if frame.has("temperature"):
        return None
    parameters = fitted.hypothesis.variants[index].parameters(fitted.hypothesis.own(fitted.point)[index])
    runs = tuple(dataclasses.replace(run, signals=_warmed(run.signals, parameters)) for run in frame.runs)
    warmed = dataclasses.replace(problem, frame=dataclasses.replace(frame, runs=runs))
    return safely(warmed, smaller.hypothesis.plus(_drift()), np.append(smaller.point, 0.0))


def _warmed(signals: Signals, relaxation: dict[str, Value]) -> Signals:
    elapsed = (signals.t - signals.t[0]) / float(relaxation["time_constant"])
    course = np.log10(1.0 + elapsed) if relaxation.get("law") == "logarithmic" else -np.expm1(-elapsed)
    return dataclasses.replace(signals, temperature=REFERENCE + RISE * course)


def _drift() -> Variant:
    def parameters(u: Array) -> dict[str, Value]:
        return {"temperature_coefficient": float(u[0]) / RISE, "reference_temperature": REFERENCE}

    coordinate = Coordinate("temperature_coefficient", -0.95, 0.95, 1e-3)
    return Variant("thermal_friction_drift", (coordinate,), ((0.0,),), (0,), parameters)
