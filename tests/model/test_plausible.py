"""Wrong units in a model file are errors that state place, value, range and the likely mistake."""

from __future__ import annotations

import dataclasses
import tomllib
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from tests.conftest import ROOT
from tests.model.actuator import ACTUATOR
from tests.virtual.files import controller, merged, write
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import TendonSheath, check_consistent, dump_model, model_from

EXAMPLE = tomllib.loads((ROOT / "config" / "actuator.toml").read_text(encoding="utf-8"))


def rejected(changes: dict[str, dict[str, float]], words: str) -> str:
    """Return the one-line error with which the example with these changes is rejected."""
    with pytest.raises(UsageError, match=words) as error:
        model_from(merged(EXAMPLE, changes), "knee.toml")
    line = str(error.value)
    assert "knee.toml" in line
    assert "\n" not in line
    return line


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("actuator", "motor_pulley_radius", 20.0, "from 0.001 to 0.5 m, found 20 .*divide millimetres"),
        ("tendon", "unstrained_length", 1200.0, "from 0.01 to 20 m, found 1200 .*divide millimetres"),
        ("sheath", "bending_angle", 149.0, "from 0 to 18.8.* rad, found 149 .*degrees"),
        ("sheath", "contact_offset", 0.4, "from 0 to 0.02 m, found 0.4 .*divide mm"),
        ("uncertainty", "pretension", 25.0, "from 0 to 10, found 25; lower it .*per cent"),
    ],
)
def test_a_number_that_no_such_part_has_is_rejected(table: str, key: str, value: float, words: str) -> None:
    assert f"{table}.{key}" in rejected({table: {key: value}}, words)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tendon": {"axial_stiffness": 60.0}}, "modulus of 0.212 GPa; allowed is 0.3 to 1000 GPa.*not in kN"),
        ({"pretension": {"value": 4500.0}}, "strains .* by 7.5 %; allowed is 4 %.*gram-force"),
        ({"pretension": {"value": 10.0 / 0.00981}}, "stresses .* 3.61 GPa; allowed is 3 GPa.*gram-force"),
        ({"tendon": {"diameter": 0.06e-3}}, "modulus of 2.12e.04 GPa.*diameter in m"),
        ({"tendon": {"series_stiffness": 20.0}}, "lengthens tendon and series_stiffness 20 N/m .*not in N/mm"),
        ({"sheath": {"bending_angle": 17.0, "friction_coefficient": 0.2}}, "17 rad is 3.4; allowed is 3.*degrees"),
    ],
)
def test_numbers_that_contradict_each_other_are_rejected(changes: dict[str, dict[str, float]], words: str) -> None:
    """The check comes before a motor runs. A log of such a rig can still be calibrated and diagnosed."""
    model = model_from(merged(EXAMPLE, changes), "knee.toml")
    with pytest.raises(UsageError, match=words) as error:
        check_consistent(model)
    assert str(error.value).startswith("knee.toml: ")
    assert "\n" not in str(error.value)


def test_a_value_a_thousand_times_beyond_its_limit_is_rejected_by_every_command() -> None:
    """Random models without a real material, for example of a benchmark, still load."""
    rejected({"tendon": {"axial_stiffness": 1e-300}}, "modulus of 3.54e-303 GPa")
    assert model_from(merged(EXAMPLE, {"tendon": {"axial_stiffness": 60e6}}), "knee.toml")


@pytest.mark.parametrize(
    ("kind", "key", "value", "words"),
    [
        ("rigid_drive", "inertia", 1e6, "from 0 to 1000 kg.*, found 1e.06 .*g.cm"),
        ("rigid_drive", "torque_offset", -1e4, "from -500 to 500 N.m, found -10000"),
        ("geared_drive", "ratio", 1e-9, "from 0.01 to 10000, found 1e-09; raise it .*motor turns"),
    ],
)
def test_a_number_that_no_drive_has_is_rejected(kind: str, key: str, value: float, words: str) -> None:
    needed = {"ratio": 50.0} if kind == "geared_drive" else {}
    with pytest.raises(UsageError, match=words) as error:
        model_from({"actuator": {"kind": kind, **needed, key: value}}, "knee.toml")
    assert f"knee.toml: actuator.{key}" in str(error.value)
    assert "\n" not in str(error.value)


def loaded(folder: Path, actuator: dict[str, Any], **axis: Any) -> TendonSheath:
    """Return the model of a configuration whose actuator file and axis have these changes."""
    path, _ = write(folder, controller(**axis))
    file = folder / "actuator.toml"
    document = merged(tomlkit.parse(file.read_text(encoding="utf-8")).unwrap(), actuator)
    file.write_text(tomlkit.dumps(document), encoding="utf-8")
    return load_configuration(path).models[0]


@pytest.mark.parametrize("tension", [4.0, 45.0, 150.0])
def test_gram_force_is_found_with_the_motor_at_every_pretension(tmp_path: Path, tension: float) -> None:
    with pytest.raises(UsageError, match=r"actuator.toml: .*gram-force times 0.00981"):
        loaded(tmp_path, {"pretension": {"value": tension / 0.00981}})


@pytest.mark.parametrize("tension", [2.0, 45.0, 150.0])
def test_the_same_in_newtons_is_loaded(tmp_path: Path, tension: float) -> None:
    # a tendon goes slack at a factor of 0.05
    model = loaded(tmp_path, {"pretension": {"value": tension}}, setpoint={"amplitude": 0.02 * tension})
    assert model.pretension == tension


def test_an_inertia_in_other_units_would_ring_as_no_motor_does(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"motor_inertia 1 .* would ring at 1.0. Hz; allowed is 2 to 5000 Hz"):
        loaded(tmp_path, {}, law={"motor_inertia": 1.0, "damping": 0.0})  # in g*m^2 by mistake


def test_soft_tendons_of_a_series_elastic_actuator_are_loaded() -> None:
    soft = {"tendon": {"axial_stiffness": 5e3, "diameter": 1e-3, "series_stiffness": 3e3}}
    assert isinstance(model_from(merged(EXAMPLE, soft), "soft.toml"), TendonSheath)


def test_a_calibration_beyond_the_greatest_friction_coefficient_moves_the_angle_and_loads_again() -> None:
    """Only the product is identified, so the bending angle is corrected."""
    straight = dataclasses.replace(ACTUATOR, bending_angle=0.5)
    found = straight.recalibrated(friction_angle=0.6)
    assert found.friction_angle == pytest.approx(0.6)
    assert model_from(tomllib.loads(dump_model(found)), "found.toml") == dataclasses.replace(found, source="found.toml")


@pytest.mark.parametrize(
    ("actuator", "axis", "words"),
    [
        ({"actuator": {"joint_pulley_radius": 0.25}}, {}, "is 12.5; allowed is 0.1 to 10.*gear_ratio"),
        ({"pretension": {"value": 0.045}}, {}, "slack at 0.0018 N.m .*10 steps .* pretension of 0.25 N"),
        ({"sheath": {"friction_coefficient": 0.0}}, {}, "is 0; allowed is 0.01 to 0.8.*compensation = 0"),
        ({"sheath": {"bending_angle": 0.0}}, {}, "is 0 N.m at the motor; allowed is at least one step .* 0.001 N.m"),
        ({"pretension": {"value": 4.5}}, {}, "reaches 0.5 N.m .* slack at 0.225 N.m.*kgf"),
        ({}, {"setpoint": {"amplitude": 500.0}}, "reaches 500 N.m .* allows 3.125 N.m"),
        ({}, {"setpoint": {"offset": -2.7}}, "reaches 3.2 N.m .* allows 3.125 N.m"),
        ({}, {"limits": {"travel": [-120.0, 120.0]}}, "within 18.8 rad .*0.01745"),
        ({"tendon": {"unstrained_length": 0.1}}, {"limits": {"travel": [-3.0, 3.0]}}, "a width of at most 4 rad"),
        ({}, {"limits": {"joint_speed": 573.0, "over_speed": 688.0}}, "joint_speed 573 rad/s .* 14.3 m/s.* 200 rad/s"),
    ],
)
def test_a_number_that_contradicts_the_rest_of_the_files_is_rejected(
    tmp_path: Path, actuator: dict[str, Any], axis: dict[str, Any], words: str
) -> None:
    with pytest.raises(UsageError, match=words) as error:
        loaded(tmp_path, actuator, **axis)
    assert "\n" not in str(error.value)


def test_a_model_without_friction_is_loaded_for_a_rig_that_compensates_none(tmp_path: Path) -> None:
    none = {"sheath": {"friction_coefficient": 0.0}}
    assert loaded(tmp_path, none, law={"compensation": 0.0}, estimator={"kind": "fixed"}).friction_angle == 0.0


@pytest.mark.parametrize(("phase", "loads"), [(0.0, False), (3.14159265, True)], ids=["in-phase", "opposite"])
def test_the_largest_value_of_a_sum_counts_not_the_sum_of_its_amplitudes(
    tmp_path: Path, phase: float, loads: bool
) -> None:
    parts = [{"amplitude": 2.0, "frequency": 1.0}, {"amplitude": 1.5, "frequency": 1.0, "phase": phase}]
    setpoint = {"kind": "multi_sine", "amplitude": None, "frequency": None, "components": parts}
    expected = nullcontext() if loads else pytest.raises(UsageError, match=r"reaches 3\.5 N.m .* allows 3.125")
    with expected:
        loaded(tmp_path, {"pretension": {"value": 90.0}}, setpoint=setpoint)
