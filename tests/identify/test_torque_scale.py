"""Torques in a wrong unit and columns that are not torques give one line with the reason, never a cause.

The logs follow (3.55) as written here, tau_J = R cosh(x) tau_M - 2 T_p r_J sinh(x) sign(omega), with noise.
"""

from __future__ import annotations

import math
import re
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest

from tests.identify.diagnosis.nominal import model as tendons
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.dataset import Dataset, load_log
from tsa_ctrl.identify.energy import foreign_torque
from tsa_ctrl.model.parameters import RigidDrive, load_model, model_from

Columns = dict[str, np.ndarray]
# values of tests.identify.diagnosis.nominal
RATIO, X, FRICTION = 0.025 / 0.02, 0.26, 2.0 * 45.0 * 0.025 * math.sinh(0.26)
SIZED = [(1000.0, "N\\*mm|mN"), (100.0, "N\\*cm"), (10.197, "kgf\\*cm")]


def log(seed: int = 0) -> Columns:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 25.0, 0.004)
    omega = 1.2 * np.cos(2.0 * np.pi * 0.31 * t) + 0.5 * np.cos(2.0 * np.pi * 0.83 * t)
    q = np.concatenate([[0.0], np.cumsum(0.5 * (omega[1:] + omega[:-1])) * 0.004])
    tau_m = 0.6 * np.sin(2.0 * np.pi * 0.47 * t + 0.4) + 0.3 * np.sin(2.0 * np.pi * 0.13 * t)
    tau_j = RATIO * math.cosh(X) * tau_m - FRICTION * np.sign(omega) + rng.normal(0.0, 0.01, len(t))
    return {"t": t, "tau_m": tau_m + rng.normal(0.0, 0.003, len(t)), "tau_j": tau_j, "omega_j": omega, "q_j": q}


def changed(name: str, values: np.ndarray) -> Dataset:
    return Dataset.from_arrays({**log(), name: values}, "log")


@pytest.mark.parametrize("seed", range(2))
def test_a_right_log_is_accepted(seed: int) -> None:
    found = Dataset.from_arrays(log(seed), "log")
    assert foreign_torque(found, tendons()) == ""
    assert calibrate([found], tendons()).half_loop_torque.value == pytest.approx(FRICTION, rel=0.05)


@pytest.mark.parametrize(("factor", "unit"), SIZED)
def test_a_joint_torque_in_another_unit_is_named_with_its_factor(factor: float, unit: str) -> None:
    values = factor * log()["tau_j"]
    with pytest.raises(UsageError, match=unit):
        calibrate([changed("tau_j", values)], tendons())


def test_friction_that_does_not_follow_the_motion_is_not_calibrated() -> None:
    """The joint torque shows no friction, but the file of the drive has friction."""
    columns = log()
    columns["tau_j"] = columns["tau_j"] + FRICTION * np.sign(columns["omega_j"])
    with pytest.raises(UsageError, match="friction"):
        calibrate([Dataset.from_arrays(columns, "log")], tendons())


def drive(factor: float, friction: float = 1.0) -> tuple[Dataset, RigidDrive]:
    """Return the log of a motor with inertia, and a file whose friction is a guess.

    `factor` scales the torque, `friction` the true friction relative to the file.
    """
    model = model_from(
        tomllib.loads('[actuator]\nkind = "rigid_drive"\ninertia = 0.006\ncoulomb_friction = 0.02'), "drive"
    )
    assert isinstance(model, RigidDrive)
    t = np.arange(0.0, 20.0, 0.005)
    angle = 1.2 * np.sin(2.0 * np.pi * 0.5 * t) + 0.4 * np.sin(2.0 * np.pi * 1.7 * t)
    omega = np.gradient(angle, t)
    tau = 0.006 * np.gradient(omega, t) + friction * 0.02 * np.sign(omega)
    tau = factor * (tau + np.random.default_rng(0).normal(0.0, 0.002, len(t)))
    return Dataset.from_arrays({"t": t, "tau_m": tau, "q_m": angle, "omega_m": omega}, "log"), model


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "mN"), (10.197, "kgf\\*cm")])
def test_a_plain_drives_torque_in_another_unit_is_named(factor: float, unit: str) -> None:
    found, model = drive(factor)
    verdict = diagnose([found], model)
    assert verdict.verdict.value == "insufficient"
    assert re.search(unit, verdict.sentence), verdict.sentence


@pytest.mark.parametrize("friction", [0.2, 4.0])
def test_a_guess_of_friction_is_no_unit(friction: float) -> None:
    found, model = drive(1.0, friction)
    assert diagnose([found], model).verdict.value != "insufficient"


def test_a_plain_drives_angle_in_degrees_is_named() -> None:
    found, model = drive(1.0)
    columns = {name: found.columns[name] for name in ("t", "tau_m")}
    verdict = diagnose([Dataset.from_arrays({**columns, "q_m": np.degrees(found["q_m"])}, "log")], model)
    assert "degrees" in verdict.sentence
    assert verdict.causes == ()


def test_no_measured_log_of_the_cable_drive_is_called_foreign(data_dir: Path) -> None:
    model = load_model(data_dir / "davinci" / "actuator.toml")
    some = sorted((data_dir / "davinci").glob("*.csv.gz"))[1::5]  # one of each load
    foreign = {path.name: foreign_torque(load_log(path), model) for path in some}
    assert foreign
    assert {name: reason for name, reason in foreign.items() if reason} == {}


@pytest.mark.parametrize(("factor", "said"), [(1000.0, "a factor of 1000"), (10.197, "rests on one level")])
def test_one_measured_load_in_another_unit_names_no_cause(data_dir: Path, factor: float, said: str) -> None:
    """Regression test: this log once gave a traceback or a gravity load of 40 N·m."""
    measured = load_log(data_dir / "davinci" / "load030_0.2Hz.csv.gz")
    columns = {name: y for name, y in measured.columns.items() if name not in measured.derived}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = diagnose(
            {"log": {**columns, "tau_j": factor * columns["tau_j"]}},
            load_model(data_dir / "davinci" / "actuator.toml"),
        )
    assert found.causes == ()
    assert said in found.sentence
