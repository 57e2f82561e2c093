"""Judgement of causes on held-out logs.

A cause that the held-out logs cannot reveal is kept. A cause that they can reveal and that increases the error is
rejected.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind import case
from tests.identify.diagnosis.nominal import diagnosed, model
from tsa_ctrl.identify.diagnosis.data.prepare import prepare
from tsa_ctrl.identify.diagnosis.data.split import split
from tsa_ctrl.identify.diagnosis.fitting.fit import fit
from tsa_ctrl.identify.diagnosis.fitting.noise_model import recalibrated
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import candidates, scales_of
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut, held_out

R_J, R_M, X, PRETENSION = 0.025, 0.02, 0.26, 45.0
LOADS = (0.1, 0.35, 0.6, 0.85, 1.1)  # N*m at the joint
T = np.arange(0.0, 12.0, 0.005)

Columns = dict[str, NDArray[np.float64]]


def log(number: int, growth: float) -> Columns:
    """Return one log at load `LOADS[number]`. Friction grows with the load about the middle load.

    At the middle load, friction is 2 % smaller.
    """
    rng = np.random.default_rng(number)
    omega = np.cos(2.0 * np.pi * 0.3 * T)
    heavier = 1.0 + growth * (LOADS[number] - LOADS[2]) - (0.02 if number == 2 else 0.0)
    friction = 2.0 * PRETENSION * R_J * np.sinh(X) * heavier
    tau_j = LOADS[number] + 0.05 * np.sin(2.0 * np.pi * 0.11 * T + number) + 0.01 * rng.normal(size=T.size)
    tau_m = (tau_j + friction * np.sign(omega)) * R_M / R_J / np.cosh(X)
    return {"t": T, "tau_m": tau_m, "omega_j": omega, "tau_j": tau_j}


@cache
def errors(hold_out: str, growth: float) -> HeldOut:
    """Return the held-out errors with load_dependent_friction and viscous_friction as causes.

    Only the first is present.
    """
    nominal = model()
    data = split(prepare({f"load{n}.csv": log(n, growth) for n in range(5)}, nominal, hold_out), hold_out)
    scales = scales_of(data.frame, nominal)
    catalogue = candidates(data.frame, nominal, scales).catalogue
    problem, base = recalibrated(data.frame, nominal, scales, catalogue)
    hypothesis, start = base.hypothesis, [base.point]
    for name in ("load_dependent_friction", "viscous_friction"):
        variant = catalogue[name][0]
        hypothesis = replace(hypothesis, variants=(*hypothesis.variants, variant))
        start.append(np.array(variant.starts[0]))
    found = fit(problem, hypothesis, np.concatenate(start))
    return held_out(problem, base, found, data, 0.0)


@pytest.mark.slow
def test_a_cause_of_the_other_loads_is_kept_where_the_middle_one_is_held_out() -> None:
    found = errors("load2*", 0.4)
    assert found.lost[0] > 0.2
    assert found.worthless != 0


@pytest.mark.slow
def test_a_cause_that_is_not_there_loses_nothing() -> None:
    assert max(errors("load2*", 0.0).lost) <= 0.05


@pytest.mark.slow
def test_a_cause_that_the_held_out_load_shows_is_judged_there() -> None:
    found = errors("load4*", 0.4)
    assert found.lost[0] > 0.2
    assert found.worthless == 1


def _named(family: str, name: str, seed: int) -> tuple[set[str], set[str]]:
    """Return the causes identified in a blind log and the effects hidden in it."""
    hidden = case(family, name, seed=seed, short=True)
    return {cause.effect for cause in diagnosed(hidden).causes}, set(hidden.truth.effects)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("late", "seed"),
    [
        ("velocity_lag", 8022),
        pytest.param("velocity_lag", 8026, marks=pytest.mark.soak),  # another cause is present
        # regression test: a third cause was identified because fits wandered along the lag
        pytest.param("velocity_lag", 8035, marks=pytest.mark.soak),
        ("backlash", 8045),
    ],
)
def test_a_cause_beside_what_moves_reversals_is_judged_without_those_missed_by_a_sample(late: str, seed: int) -> None:
    """The second cause explains a twentieth of the error that remains outside the reversals."""
    named, hidden = _named("pair", "any", seed)
    assert late in hidden
    assert named == hidden


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "name", "seed"),
    [
        # outside the reversals, a load hysteresis would explain the error equally well
        ("single", "transport_delay", 8009),
        ("confounded", "late_at_one_speed", 8005),
    ],
)
def test_a_delay_does_not_give_way_to_what_knows_no_reversal(family: str, name: str, seed: int) -> None:
    named, hidden = _named(family, name, seed)
    assert named == hidden
