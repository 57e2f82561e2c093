"""Selection of the form of the transmission in tune.

The logs come from the elongation equilibrium, which shares no code with the package.
"""

from __future__ import annotations

import dataclasses
import tomllib

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.blind import tendon_logs
from tsa_ctrl.identify import diagnosis
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath, model_from
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.tune.estimate import Form, estimate, extended, sliding_error


def rig_and_log(
    profile: str, seed: int = 3, x: float | None = None, rate: float = 200.0
) -> tuple[tendon_logs.Rig, TendonSheath, Dataset]:
    rng = np.random.default_rng(seed)
    rig = tendon_logs.draw_rig(rng, profile)
    if x is not None:
        rig = dataclasses.replace(rig, mu=0.2, theta=x / 0.2)
    model = model_from(tomllib.loads(tendon_logs.model_text(rig, rng)), "nominal.toml")
    assert isinstance(model, TendonSheath)
    return rig, model, Dataset.from_arrays(tendon_logs.record(rig, rng, seconds=20.0, rate=rate), "a.csv")


@pytest.mark.parametrize(
    ("profile", "form"), [("joint_end", Form.GIVEN), ("uniform", Form.UNIFORM), ("motor_end", Form.MOTOR_END)]
)
def test_short_errors_that_all_forms_share_do_not_hide_the_form(profile: str, form: Form) -> None:
    """Ten bursts of 60 ms resemble the errors after the machine stalled. Without them, the model fits the sliding."""
    rig, model, log = rig_and_log(profile)
    columns = {name: log[name].copy() for name in log.columns}
    rng = np.random.default_rng(8)
    for first in rng.integers(0, len(log) - 12, 10):
        columns["tau_j"][first : first + 12] += rng.choice([-1.0, 1.0])
    found = estimate([Dataset.from_arrays(columns, "bursts.csv")], model, certified_gain=False, forms=True)
    assert found.form is form
    clean = estimate([log], model, certified_gain=False, forms=True)
    assert clean.form is form
    assert sliding(clean.model).half_loop == pytest.approx(rig.truth()["half_loop_torque"], rel=0.03)
    if profile == "uniform":
        assert sliding_error([log], clean.model) < 0.7 * sliding_error([log], model)


def test_the_given_form_is_kept_without_a_lag_when_asked_for() -> None:
    for model, log in (rig_and_log("motor_end")[1:], late_log("joint_end", LAG)):
        found = estimate([log], model, certified_gain=False, forms=False)
        assert (found.form, found.model.effects, found.effects) == (Form.GIVEN, {}, ())


@pytest.mark.parametrize("profile", ["joint_end", "uniform", "motor_end"])
def test_the_half_loop_of_a_friction_angle_of_one_point_two_is_estimated(profile: str) -> None:
    rig, model, log = rig_and_log(profile, x=1.2)
    found = estimate([log], model, certified_gain=False, forms=True)
    assert sliding(found.model).half_loop == pytest.approx(rig.truth()["half_loop_torque"], rel=0.03)


def viscous_log(coefficient: float) -> tuple[TendonSheath, Dataset]:
    """Return the model and a log of a rig whose joint also has viscous friction."""
    _, model, log = rig_and_log("joint_end")
    columns = {name: log[name].copy() for name in log.columns}
    columns["tau_j"] -= coefficient * columns["omega_j"]
    return model, Dataset.from_arrays(columns, "a.csv")


@pytest.mark.slow
def test_the_extension_brings_the_effect_with_its_interval_into_model_and_numbers() -> None:
    coefficient = 0.1
    model, log = viscous_log(coefficient)
    found = extended([log], model, estimate([log], model, certified_gain=False, forms=False))
    assert found.effects == ("viscous_friction",)
    quantity = found.parameters["viscous_friction.coefficient"]
    assert quantity.low < found.model.effects["viscous_friction"]["coefficient"] < quantity.high
    assert quantity.value == pytest.approx(coefficient, rel=0.1)
    result = found.calibration
    loop = 2.0 * found.model.pretension * found.model.joint_pulley_radius * np.sinh(found.model.friction_angle)
    assert result.half_loop_torque.value == pytest.approx(loop, rel=0.02)
    for name, value in (("friction_angle", found.model.friction_angle), ("pretension", found.model.pretension)):
        assert getattr(result, name).low <= value <= getattr(result, name).high


def test_without_an_effect_nothing_is_added() -> None:
    model, log = viscous_log(0.0)
    without = estimate([log], model, certified_gain=False, forms=False)
    found = extended([log], model, without)
    assert found.model is without.model
    assert found.parameters == {}
    assert "diagnosis: " in found.notes[-1]


@pytest.mark.slow
def test_a_name_with_rivals_is_told_and_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    model, log = viscous_log(0.1)
    without = estimate([log], model, certified_gain=False, forms=False)
    real = diagnosis.diagnose([log], model)
    doubtful = dataclasses.replace(real.causes[0], alternatives=("motor_side_friction",))
    monkeypatch.setattr(diagnosis, "diagnose", lambda *_: dataclasses.replace(real, causes=(doubtful,)))
    found = extended([log], model, without)
    assert found.effects == ()
    assert "Not used: alternatives to viscous_friction are not excluded" in found.notes[-1]


LAG = 4e-3  # s, of the encoder's velocity


def late_log(profile: str, lag: float) -> tuple[TendonSheath, Dataset]:
    """Return the model and a log at 1 kHz whose velocity passed a first-order low-pass."""
    _, model, log = rig_and_log(profile, seed=4, rate=1000.0)
    columns = {name: log[name].copy() for name in log.columns}
    if lag > 0.0:
        keep = np.exp(-1e-3 / lag)
        columns["omega_j"] = lfilter([1.0 - keep], [1.0, -keep], columns["omega_j"])
    return model, Dataset.from_arrays(columns, "late.csv")


@pytest.mark.parametrize("profile", ["joint_end", "uniform"])
def test_a_late_velocity_is_found_with_its_interval_and_one_in_time_gets_no_lag(profile: str) -> None:
    model, log = late_log(profile, LAG)
    found = estimate([log], model, certified_gain=False, forms=True)
    assert found.effects == ("velocity_lag",)
    assert found.model.effects["velocity_lag"]["time_constant"] == pytest.approx(LAG, abs=1e-3)
    quantity = found.parameters["velocity_lag.time_constant"]
    assert quantity.low <= LAG + 0.5e-3
    assert quantity.high >= LAG - 0.5e-3
    if profile == "joint_end":
        model, log = late_log(profile, 0.0)
        assert estimate([log], model, certified_gain=False, forms=True).effects == ()
