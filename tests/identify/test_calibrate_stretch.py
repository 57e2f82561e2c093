"""Stiffness, curvature profile and motor inertia from the tendon elongation, in logs of the distributed plant.

Logs that do not determine them are rejected.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.identify.test_calibrate_cli import tsa, write_csv
from tests.virtual.joints import GAIT, play, sine
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate.stretch import fit_stretch
from tsa_ctrl.identify.calibrate.tendon_log import jump
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, save_model

OFF = {"friction_coefficient": 1.15, "pretension": 0.9, "axial_stiffness": 0.85}  # ratio of true to nominal value
STIFFNESS = 0.85 * NOMINAL.axial_stiffness
BENDS = [[0.0, 0.0], [0.6, 1.0], [1.0, 1.0]]  # s_c 0.3
COLUMNS = ("t", "tau_m", "q_m", "q_j", "omega_m", "omega_j", "tau_j")


def columns(
    folder: Path, load: str, setpoint: dict[str, Any], seconds: float = 5.0, bends: list[list[float]] = BENDS
) -> dict[str, np.ndarray]:
    """Return a log of a rig that is not nominal. Its motor inertia is 1e-4 kg*m^2."""
    plant = {"perturbation": OFF, "tendon": {"curvature": bends}}
    result = play(folder, load, setpoint, seconds, compensation=0.7, plant=plant)
    log = result.log
    kept = np.isfinite(log["q_m"]) & np.isfinite(log["q_j"]) & np.isfinite(log["tau_m"]) & np.isfinite(log["tau_j"])
    return {name: log[name][kept] for name in COLUMNS}


TWO_BENDS = [[0.0, 0.0], [0.1, 0.0], [0.35, 0.5], [0.65, 0.5], [0.9, 1.0], [1.0, 1.0]]


@pytest.fixture(scope="module")
def gait(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    return columns(tmp_path_factory.mktemp("gait"), "imposed", GAIT)


def dataset(found: dict[str, np.ndarray], *without: str) -> Dataset:
    return Dataset.from_arrays({name: values for name, values in found.items() if name not in without}, "log")


@pytest.mark.slow
def test_with_a_torque_sensor_stiffness_shape_and_inertia_are_found(gait: dict[str, np.ndarray]) -> None:
    fit = fit_stretch([dataset(gait)], NOMINAL)
    assert fit.axial_stiffness.low < STIFFNESS < fit.axial_stiffness.high
    assert fit.axial_stiffness.value == pytest.approx(STIFFNESS, rel=0.01)
    assert fit.centre is not None
    assert fit.centre.low < 0.3 < fit.centre.high
    assert fit.motor_inertia.value == pytest.approx(1e-4, rel=0.15)
    assert fit.model.axial_stiffness_uncertainty < 0.03
    assert fit.friction_angle.value == pytest.approx(1.15 * 0.9 * NOMINAL.friction_angle, rel=0.03)


@pytest.mark.slow
def test_two_bends_with_a_straight_piece_between_are_told_from_an_even_one(tmp_path: Path) -> None:
    """Both profiles have their centre at 0.5.

    The profile is compared where one sixth, two fifths, three fifths and five sixths of the wrap angle are reached.
    """
    fit = fit_stretch([dataset(columns(tmp_path, "imposed", GAIT, bends=TWO_BENDS))], NOMINAL)
    course = fit.model.bending_course
    assert course is not None
    places = np.interp([1.0 / 6.0, 0.4, 0.6, 5.0 / 6.0], *np.array(course).T[::-1])
    assert places == pytest.approx([0.183, 0.3, 0.7, 0.817], abs=0.06)
    assert fit.centre is not None
    assert fit.centre.low < 0.5 < fit.centre.high
    assert fit.motor_inertia.value == pytest.approx(1e-4, rel=0.1)


@pytest.mark.slow
def test_without_one_the_stiffness_is_found_and_the_shape_is_kept(gait: dict[str, np.ndarray]) -> None:
    """A note reports that the profile and the friction are not separately identifiable."""
    fit = fit_stretch([dataset(gait, "tau_j")], dataclasses.replace(NOMINAL, bending_centre=0.3))
    assert fit.axial_stiffness.low < STIFFNESS < fit.axial_stiffness.high
    assert fit.centre is None
    assert any("without a joint torque sensor" in note for note in fit.notes)


@pytest.mark.slow
@pytest.mark.parametrize("end", ["motor_end", "joint_end"])
def test_a_file_that_bends_the_sheath_at_one_end_is_where_the_search_begins(
    gait: dict[str, np.ndarray], end: str
) -> None:
    """A file with a single bend at either end gives the centre of the rig's bends and its stiffness."""
    wrong = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": end}})
    fit = fit_stretch([dataset(gait)], wrong)
    assert fit.centre is not None
    assert fit.centre.value == pytest.approx(0.3, abs=0.01)
    assert fit.axial_stiffness.value == pytest.approx(STIFFNESS, rel=0.01)


@pytest.mark.slow
def test_a_held_joint_tells_its_stiffness_too(tmp_path: Path) -> None:
    fit = fit_stretch([dataset(columns(tmp_path, "held", sine(0.6, 0.5)))], NOMINAL)
    assert fit.axial_stiffness.value == pytest.approx(STIFFNESS, rel=0.015)


@pytest.mark.slow
def test_the_verb_writes_what_it_found(
    gait: dict[str, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a joint torque sensor the command writes a file that loads.

    The file contains the interval of the friction torque.
    """
    model, log, out = tmp_path / "a.toml", tmp_path / "log.csv", tmp_path / "b.toml"
    save_model(dataclasses.replace(NOMINAL, bending_centre=0.3), model)
    write_csv(log, {name: values for name, values in gait.items() if name != "tau_j"})
    assert tsa(str(log), "--model", str(model), "--out", str(out), "--stretch", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"schema", "stretch", "notes"}
    written = load_tendon_sheath(out)
    assert written.axial_stiffness == pytest.approx(found["stretch"]["axial_stiffness"]["value"])
    assert written.axial_stiffness_uncertainty < 0.05
    assert written.bending_centre == 0.3
    assert written.half_loop_low == pytest.approx(found["stretch"]["half_loop_torque"]["low"], rel=1e-5)


def rows(seconds: float = 3.0, elastic: bool = False) -> dict[str, np.ndarray]:
    """Return a log of a rigid transmission, or of one whose motor angle shows the elongation by a larger torque."""
    t = np.arange(0.0, seconds, 1e-3)
    q_j = np.sin(t)
    tau_m = 0.6 * np.sin(2.0 * t) if elastic else 0.1 * np.cos(t)
    return {
        "t": t,
        "tau_m": tau_m,
        "q_j": q_j,
        "q_m": 1.25 * q_j + elastic * tau_m / 40.0,
        "omega_m": 1.25 * np.cos(t),
        "omega_j": np.cos(t),
    }


@pytest.mark.parametrize(
    ("factor", "words"),
    [(-1.25, "one of them has the wrong sign"), (2.5, "counts per turn or a pulley's radius is wrong")],
)
def test_angles_that_contradict_each_other_are_refused(factor: float, words: str) -> None:
    data = rows()
    data |= {"q_m": factor * data["q_j"], "omega_m": factor * data["omega_j"]}
    with pytest.raises(UsageError, match=f"q_m and q_j contradict each other.*{words}"):
        fit_stretch([Dataset.from_arrays(data, "log")], NOMINAL)


def test_a_stiffness_that_the_stretch_does_not_tell_is_refused_with_the_cure() -> None:
    """The encoders are so coarse that the elongation is below one count. The stiffness is not guessed."""
    data = rows(8.0)
    count = 2.0 * np.pi / 64
    data["q_m"] = count * np.round(data["q_m"] / count)
    data["tau_m"] = 0.6 * np.sign(np.cos(data["t"]))
    with pytest.raises(UsageError, match="does not show their stiffness here; record motion") as caught:
        fit_stretch([Dataset.from_arrays(data, "log")], NOMINAL)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("turned", [("tau_m",), ("q_m", "q_j")])
def test_a_torque_that_turns_against_both_angles_is_refused(turned: tuple[str, ...]) -> None:
    """The tendons elongate in proportion to the motor torque. The torque or both angles have the wrong sign."""
    data = rows(elastic=True)
    for name in turned:
        data[name] = -data[name]
    with pytest.raises(UsageError, match="tau_m, or both angles, have the wrong sign") as caught:
        fit_stretch([Dataset.from_arrays(data, "log")], NOMINAL)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("size", [0.02, -1.0])
def test_a_zero_that_jumps_within_a_log_is_refused_with_its_time(size: float) -> None:
    data = rows(elastic=True)
    at = float(data["t"][len(data["t"]) // 2])
    data["q_j"] = data["q_j"] + size * (data["t"] >= at)
    with pytest.raises(UsageError, match=rf" m at {at:.4g} s: a pulley slipped") as caught:
        fit_stretch([Dataset.from_arrays(data, "log")], NOMINAL)
    said = float(str(caught.value).split("jumps by ")[1].split()[0])
    assert said == pytest.approx(-size * NOMINAL.joint_pulley_radius, rel=0.01)


def test_what_comes_back_is_no_jump() -> None:
    """A reading that is wrong for three rows is not a jump, and neither are steps of one count."""
    stretch = 1e-4 * np.sin(np.linspace(0.0, 20.0, 2000))
    count = 2e-5
    assert jump(count * np.round(stretch / count), 1e-5) is None
    stretch[1000:1003] += 5e-4
    assert jump(stretch, 1e-5) is None
    stretch[1003:] += 5e-4
    assert jump(stretch, 1e-5) == (1000, pytest.approx(5e-4, rel=0.01))


@pytest.mark.parametrize(
    ("change", "model", "words"),
    [
        ({"q_m": None}, NOMINAL, "q_m"),
        (dict.fromkeys(("q_j", "q_m", "omega_m", "omega_j"), 0.0), NOMINAL, "did not slide all along"),
        ({}, NOMINAL.recalibrated(0.0), "must be above 0"),
    ],
    ids=["no motor encoder", "tendons that never slid", "no friction in the file"],
)
def test_what_shows_no_stretch_is_refused(change: dict[str, float | None], model: TendonSheath, words: str) -> None:
    data = {name: values for name, values in rows().items() if change.get(name, 1.0) is not None}
    data |= {name: factor * data[name] for name, factor in change.items() if factor is not None}
    with pytest.raises(UsageError, match=words):
        fit_stretch([Dataset.from_arrays(data, "log")], model)
