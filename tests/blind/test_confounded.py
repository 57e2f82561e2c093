"""Test that the effects of a row are indistinguishable in its log, and that its experiment shows the effect."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from .bench import Bench, rms
from .cases import Case
from .confounded import ROWS
from .drawn import drawn, together
from .size import UNCERTAINTY

pytestmark = together

# Parameters of an imitating effect as functions of free numbers of order one, scaled by the bench.
FREE: dict[str, Any] = {
    "torque_constant_error": lambda b, p: {"relative_error": 0.1 * p[0]},
    "joint_stiffness": lambda b, p: {"stiffness": b.scale * p[0], "rest_angle": 0.1 * p[1]},
    "gravity_load": lambda b, p: {"amplitude": b.scale * p[0], "phase": p[1]},
    "torque_offset": lambda b, p: {"offset": 0.1 * b.scale * p[0]},
    "direction_asymmetric_friction": lambda b, p: {"viscous_difference": 0.1 * b.scale / b.speed * p[0]},
    "viscous_friction": lambda b, p: {"coefficient": 0.1 * b.scale / b.speed * p[0]},
    "motor_side_friction": lambda b, p: {"coulomb": 0.1 * b.rig.torque_limit * p[0]},
    "load_dependent_friction": lambda b, p: {"coefficient": 0.1 * p[0]},
    "sheath_asymmetry": lambda b, p: {"relative_difference": p[0]},
    "thermal_friction_drift": lambda b, p: {"temperature_coefficient": 0.01 * p[0]},
    "pretension_relaxation": lambda b, p: {"relaxed_fraction": 0.1 * p[0], "time_constant": 10.0 * abs(p[1]) + 0.1},
}
TWO = ("joint_stiffness", "gravity_load", "pretension_relaxation")
STARTS = ((0.3, 1.5), (0.3, -1.5), (0.5, 1.0))


def leftover(hidden: Case, twin: str) -> float:
    """Return the RMS error (N·m) of the best imitation of the hidden effect, with x and T_p free within their
    uncertainty.
    """
    bench = hidden.bench
    assert bench is not None
    torque = np.concatenate(bench.ideal(hidden.truth.effects))
    if twin == "parameter_error":
        return hidden.truth.size
    if twin == "elongation_coupling":
        profiles = ("uniform", "motor_end")
        return min(
            _fit(bench, torque, lambda b, p, c=c: {"curvature_profile": c}, "elongation_coupling") for c in profiles
        )
    return _fit(bench, torque, FREE[twin], twin)


def _fit(bench: Bench, torque: np.ndarray, parameters: Any, twin: str) -> float:
    low, high = 1.0 / (1.0 + UNCERTAINTY), 1.0 + UNCERTAINTY
    nominal = bench.nominal

    def miss(free: np.ndarray) -> np.ndarray:
        rig = replace(bench.rig, mu=nominal.mu * free[0], pretension=nominal.pretension * free[1])
        ideal = replace(bench, rig=rig).ideal({twin: parameters(bench, free[2:])})
        return (np.concatenate(ideal) - torque)[::5]

    starts = STARTS if twin in TWO else ((0.1,), (-0.1,))
    free = len(starts[0])
    bounds = ([low, low, *[-np.inf] * free], [high, high, *[np.inf] * free])
    true = bench.rig.x / nominal.x, bench.rig.pretension / nominal.pretension
    return min(rms(least_squares(miss, [*true, *start], bounds=bounds, max_nfev=40).fun) for start in starts)


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.exact])
def test_a_twin_imitates_the_hidden_effect(name: str) -> None:
    """The best imitation leaves a residual below a tenth of the noise."""
    hidden = drawn("confounded", name, 0)
    twin = next(other for other in hidden.truth.twins if other not in hidden.truth.effects)
    assert leftover(hidden, twin) < 0.1 * hidden.truth.noise


@pytest.mark.parametrize("name", ROWS)
def test_the_experiment_shows_the_hidden_effect(name: str) -> None:
    """In the experiment's log, the size of the effect is at least 1.3 times the noise."""
    hidden = drawn("confounded", name, 0)
    if hidden.experiment is None:
        assert ROWS[name].parted_by is None
        return
    assert hidden.experiment.truth.effects == hidden.truth.effects
    assert hidden.experiment.truth.size >= 1.3 * hidden.experiment.truth.noise
