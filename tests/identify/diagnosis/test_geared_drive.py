"""A geared drive with a joint torque sensor: hidden causes are found in motion and with a locked joint."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.blind.cases import Case
from tests.blind.geared import NAMES, STATIC, geared_case, held_case
from tests.identify.diagnosis.nominal import diagnosed
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify import Diagnosis, diagnose
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.report.page import write
from tsa_ctrl.identify.diagnosis.report.result import Verdict
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.simulate import simulate
from tsa_ctrl.model.parameters import GearedDrive, load_model, model_from

SIZES = {
    "torque_saturation": "limit",
    "torque_sensor_lag": "time_constant",
    "torque_constant_error": "relative_error",
    "torque_offset": "offset",
    "torque_ripple": "amplitude",
    "viscous_friction": "coefficient",
    "inertia": "inertia",
    "gravity_load": "amplitude",
    "backlash": "gap",
    "transport_delay": "delay",
}  # the compared parameter of each effect; the three parameters of Stribeck friction are correlated


def check(case: Case, result: Diagnosis) -> None:
    """Require that the only cause is the hidden one, with its size within 10 %."""
    (cause,) = result.causes
    assert cause.effect == case.name
    if case.name in SIZES:
        found = cause.parameters[SIZES[case.name]]
        assert isinstance(found, Quantity)
        assert found.value == pytest.approx(case.truth.effects[case.name][SIZES[case.name]], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(6, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", NAMES[1:])
def test_a_hidden_cause_is_named(name: str, seed: int, tmp_path: Path) -> None:
    case = geared_case(name, seed, short=True)
    result = diagnosed(case)
    check(case, result)
    write(result, tmp_path, plot=lambda *_: {})
    assert name in load_model(tmp_path / "extended.toml").effects


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_healthy_drive_has_no_cause(seed: int) -> None:
    assert diagnosed(geared_case("none", seed, short=True)).verdict is Verdict.CONSISTENT


@pytest.mark.slow
@pytest.mark.parametrize("name", STATIC)
def test_stairs_of_torque_on_a_held_joint_show_gain_zero_and_saturation(name: str) -> None:
    """Such a log identifies no losses, and does not separate an offset from a weight."""
    result = diagnosed(case := held_case(name, 0))
    check(case, result)
    assert result.causes[0].alternatives == (("gravity_load",) if name == "torque_offset" else ())
    assert not result.parameter_errors


def test_the_motion_of_the_joint_may_come_from_the_motor() -> None:
    """The gear ratio converts q_m and omega_m to the joint, and back."""
    case = geared_case("none", 0, short=True)
    model = model_from(tomllib.loads(case.model), "nominal")
    assert isinstance(model, GearedDrive)
    columns = {**case.logs[0].columns}
    by_joint = simulate(Dataset.from_arrays(columns), model).rms
    columns["q_m"] = columns.pop("q_j") * model.ratio
    by_motor = Dataset.from_arrays(columns)
    assert simulate(by_motor, model).rms == pytest.approx(by_joint, rel=1e-6)
    np.testing.assert_allclose(by_motor.completed_for(model)["omega_j"] * model.ratio, by_motor["omega_m"], rtol=1e-9)


def test_without_motion_or_joint_torque_the_columns_are_named() -> None:
    t = np.arange(2000) * 0.002
    model = GearedDrive(9.0)
    with pytest.raises(UsageError, match="column tau_j is missing"):
        diagnose({"a": {"t": t, "tau_m": np.sin(t), "q_j": np.sin(t)}}, model)
