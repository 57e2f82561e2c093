"""Calculate the gain of an extended model on a new motion, without the simulation of the package."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from .bench import draw_bench, rms
from .cases import Case, generator
from .size import channels, recalibrated


def fresh_gain(case: Case, causes: list[dict[str, Any]]) -> float | None:
    """Return the share of the hidden effects' mean square that the identified causes remove with their reported
    parameters.

    The motion is a new one of the same rig without noise. Friction angle and pretension are fitted again both times.
    Return None without a bench, without causes, with a cause that is not hidden, or with a hidden velocity lag.
    """
    bench, hidden = case.bench, case.truth.effects
    if bench is None or not causes or any(cause["effect"] not in hidden for cause in causes):
        return None
    fresh = draw_bench(generator("fresh", case.name, case.seed), bench.recipe, like=bench)
    fresh = replace(fresh, motor_angle=bench.motor_angle)
    torque = np.concatenate(fresh.ideal(hidden))
    seen = channels(fresh, hidden)
    before = rms(recalibrated(bench.nominal, seen, torque)[2])
    named = {cause["effect"]: _parameters(cause, hidden[cause["effect"]]) for cause in causes}
    if "velocity_lag" in hidden:
        return None  # the lag is in the logged velocity, not in the torque

    def after(scales: np.ndarray) -> float:
        rig = replace(bench.rig, mu=bench.rig.mu * scales[0], pretension=bench.rig.pretension * scales[1])
        return rms(torque - np.concatenate(replace(fresh, rig=rig).ideal(named)))

    found = minimize(after, np.ones(2), method="Nelder-Mead", options={"maxfev": 60, "xatol": 1e-4, "fatol": 1e-9})
    return float(1.0 - (found.fun / before) ** 2)


def _parameters(cause: dict[str, Any], hidden: dict[str, Any]) -> dict[str, Any]:
    """Return the reported parameters, completed by the true values of parameters that the report does not contain."""
    out = dict(hidden)
    for key, quantity in cause["parameters"].items():
        out[key] = quantity["value"] if isinstance(quantity, dict) else quantity
    return out
