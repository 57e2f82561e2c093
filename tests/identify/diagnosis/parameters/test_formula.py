"""A law outside the catalogue is reported as a formula that a model file accepts. Noise is not.

The data are synthetic.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind import case
from tests.blind.score import mark
from tests.identify.diagnosis.nominal import diagnosed
from tsa_ctrl.identify.diagnosis import Diagnosis, diagnose
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.noise.nuisance import Moment, Nuisance
from tsa_ctrl.identify.diagnosis.parameters.formula import with_direction
from tsa_ctrl.identify.diagnosis.parameters.formula_numbers import regressed
from tsa_ctrl.model.parameters import RigidDrive, load_model, save_model
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

DRIVE = RigidDrive(inertia=0.004, coulomb_friction=0.05, viscous_friction=0.01, torque_offset=0.0)
DRAG, NOISE = 0.03, 0.01  # N*m*s^2/rad^2, N*m
Columns = dict[str, NDArray[np.float64]]


def log(seed: int) -> Columns:
    """Return 20 s at 100 Hz of a drive whose drag grows with the square of its speed. No effect has this form."""
    rng = np.random.default_rng(seed)
    t = np.arange(2000) * 1e-2
    w, v = rng.uniform(1.0, 1.6), rng.uniform(3.0, 4.5)
    q = 1.2 * np.sin(w * t) + 0.4 * np.sin(v * t)
    omega = 1.2 * w * np.cos(w * t) + 0.4 * v * np.cos(v * t)
    acceleration = -1.2 * w**2 * np.sin(w * t) - 0.4 * v**2 * np.sin(v * t)
    tau = 0.004 * acceleration + 0.05 * np.sign(omega) + 0.01 * omega + DRAG * omega * np.abs(omega)
    return {
        "t": t,
        "tau_m": tau + rng.normal(0.0, NOISE, len(t)),
        "q_m": q,
        "omega_m": omega,
        "acceleration_m": acceleration,
    }


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return diagnose({f"{k}.csv": log(k) for k in range(6)}, DRIVE)


@pytest.mark.slow
def test_what_is_left_is_told_as_a_formula_with_its_gain_on_other_logs(found: Diagnosis) -> None:
    assert found.unexplained
    assert found.formula is not None
    assert found.formula.gain > 0.7
    assert found.rms.refitted is not None
    assert found.rms.refitted <= found.formula.rms[1] < 1.1 * NOISE
    assert (found.formula.better, found.formula.logs) == (2, 2)
    assert found.to_dict()["formula"]["expression"] == found.formula.expression
    assert all(value.low < value.value < value.high for value in found.formula.constants.values())
    assert found.details is not None
    for curves in found.details.curves:  # the curves of the pictures
        assert curves.described is not None
        assert np.std(curves.measured - curves.described) < 0.6 * np.std(curves.measured - curves.extended)


@pytest.mark.slow
def test_the_formula_is_a_table_that_a_model_file_takes_and_that_mends_the_simulation(
    found: Diagnosis, tmp_path: Path
) -> None:
    assert found.formula is not None
    save_model(found.formula.limited, tmp_path / "formula.toml")
    mended = load_model(tmp_path / "formula.toml")
    assert mended.effects["custom"]["expression"] == found.formula.ranged
    assert found.formula.ranged.startswith(f"({found.formula.expression})*inside(")
    columns = log(99)
    signals = Signals(
        t=columns["t"],
        tau_m=columns["tau_m"],
        omega_j=columns["omega_m"],
        omega_m=columns["omega_m"],
        q_m=columns["q_m"],
        acceleration_m=columns["acceleration_m"],
    )
    before, after = (float(np.std(columns["tau_m"] - predict(each, signals))) for each in (found.model, mended))
    assert after < 0.6 * before


@pytest.mark.parametrize(("values", "sure"), [(1.0, True), (1e-12, False)], ids=["large", "as small as rounding"])
@pytest.mark.filterwarnings("error")
def test_deviations_of_twin_terms_are_numbers(values: float, sure: bool) -> None:
    """Two columns are equal except for rounding. No argument of a square root is negative."""
    rng = np.random.default_rng(4)
    column = rng.normal(0.0, 1.0, 2400)
    twins = np.column_stack([column, column * (1.0 + 1e-15), np.cumsum(column) * 1e6])
    blocks = np.arange(2400) // 100
    deviations = regressed(twins, values * column + rng.normal(0.0, 1e-6, 2400), blocks)[1]
    assert np.all(np.isfinite(deviations))
    assert bool(np.all(deviations[:2] < 1e-3 * values)) is sure


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed", "starts"),
    [
        # regression test: an offset was reported in addition
        pytest.param("temperature_crosstalk", 9102, "a*(temperature - ", marks=pytest.mark.soak),
        # regression test: sheaths that differ by -1.8 were reported
        pytest.param("bridge_asymmetry", 9100, "a*abs(tau)", marks=pytest.mark.soak),
        pytest.param("sensor_clipping", 9101, "a*tau**3", marks=pytest.mark.soak),
        ("sheath_kink", 9101, "a*sigma*exp(-((q_j - "),
        # regression test: was rejected because of another log
        ("sensor_dead_zone", 9601, "a*(abs(tau + b) - abs(tau - b))"),
        ("viscoelastic_tendon", 9702, "a*(tau - lag(tau, b))"),
        pytest.param("sensor_resonance", 9701, "a*(tau - ring(tau, b, c))", marks=pytest.mark.soak),
        pytest.param("sensor_hysteresis", 9700, "a*dahl(tau, b)", marks=pytest.mark.soak),
    ],
)
def test_a_cause_outside_the_catalogue_is_told_as_its_formula(kind: str, seed: int, starts: str) -> None:
    """Blind logs: every cause has alternatives, and the formula explains most of the error above the noise."""
    hidden = case("outside", kind, seed, short=True)
    found = diagnosed(hidden)
    assert all(cause.alternatives for cause in found.causes)
    assert found.formula is not None
    assert found.formula.expression.startswith(starts)
    assert mark(hidden, found.to_dict()).described


def test_samples_of_an_unknown_direction_teach_no_formula() -> None:
    """Such samples are excluded only if enough others remain. A model of the reversals keeps them."""
    moments = (Moment(10, np.ones(3)), Moment(50, np.ones(1)))
    problem = cast(Problem, SimpleNamespace(nuisance=Nuisance(np.zeros((100, 0)), moments)))
    plain, presliding = (cast(Fit, SimpleNamespace(names=names)) for names in ((), ("presliding_hysteresis",)))
    mask = np.arange(100) >= 11
    assert np.flatnonzero(mask & ~with_direction(problem, plain, mask)).tolist() == [11, 12, 50]
    assert with_direction(problem, presliding, mask).sum() == 89
    few = np.arange(100) == 50
    assert with_direction(problem, plain, few).sum() == 1
