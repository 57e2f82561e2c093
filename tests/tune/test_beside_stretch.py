"""`tsa tune` with a joint torque sensor and two encoders: selection of the source of the friction."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.tune import rig
from tests.tune.test_command import tsa
from tests.tune.test_in_virtual_time import RATE, tune
from tests.virtual.rigs import draw
from tsa_ctrl.demo.rig import NOMINAL, VIRTUAL
from tsa_ctrl.model.parameters import load_tendon_sheath, save_model
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.tune.excitation import multi_sine
from tsa_ctrl.virtual.simulation import simulate_loop

DRAWN = draw(1, 1)  # bends at the motor, soft tendons, a heavy motor; friction and pretension differ from nominal


def write(folder: Path, axis: dict[str, Any]) -> Path:
    """Write the rig's files and return the controller's file. `axis`: tables of the controller's axis."""
    plant = {**DRAWN.axis(), "joint": {"load": "limb"}}
    controller = rig.write(folder, VIRTUAL, RATE, "distributed", plant, axis)
    save_model(DRAWN.nominal, folder / "actuator.toml")  # the plant's own file: tune writes the controller's model file
    text = (folder / "plant.toml").read_text().replace(rig.MODEL, "actuator.toml")
    (folder / "plant.toml").write_text(text)
    save_model(DRAWN.nominal, folder / rig.MODEL)
    return controller


def check(data: dict[str, Any], model: Path) -> None:
    """Check the friction torque in the JSON output of `tsa tune` and in the written file."""
    truth = DRAWN.truth
    half_loop = 2.0 * truth.joint_pulley_radius * truth.pretension * math.sinh(truth.friction_angle)
    found = data["calibration"]["combinations"]["half_loop_torque"]
    assert found["low"] <= half_loop <= found["high"]
    assert found["value"] == pytest.approx(half_loop, rel=0.02)
    assert any("the value from the elongation is used" in note for note in data["notes"])
    written = load_tendon_sheath(model)
    assert written.pretension * written.friction_angle == pytest.approx(
        truth.pretension * truth.friction_angle, rel=0.03
    )


@pytest.mark.slow
def test_of_a_limbs_log_the_half_loop_is_the_stretchs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A regression on the moving samples would give an eighth of the true friction torque."""
    wave = multi_sine((0.2, 0.5, 0.9), 0.8, 8.0)
    table = np.column_stack([wave.t, wave.tau_j_des])
    np.savetxt(tmp_path / "wave.csv", table, delimiter=",", header="t,tau_j_des", comments="")
    played = {"setpoint": {"kind": "file", "file": "wave.csv"}, "law": {"compensation": 0.0, "fade_in": 0.1}}
    controller = write(tmp_path, played)
    simulate_loop(controller, tmp_path / "plant.toml", wave.seconds, out=tmp_path)
    assert tsa(str(controller), "--from-log", str(tmp_path / "tsa.mcap"), "--yes", "--json") == 0
    check(json.loads(capsys.readouterr().out), tmp_path / rig.MODEL)


@pytest.mark.slow
@pytest.mark.soak  # with each change, one log is tested above and the whole procedure in test_in_virtual_time.py
def test_on_a_limb_the_half_loop_is_the_stretchs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A regression on the moving samples would give 28 % of the true friction torque."""
    write(tmp_path, {"law": {"compensation": rig.COMPENSATION, "fade_in": 1.0}})
    spans = ("--seconds", "10", "--verify-seconds", "4")
    assert tune(tmp_path, "--yes", "--json", "--out", str(tmp_path / "out"), *spans) == 0
    data = json.loads(capsys.readouterr().out)
    check(data, tmp_path / rig.MODEL)
    assert data["verification"]["reduction_percent"]["after"] > 80.0


@pytest.mark.slow
def test_much_friction_near_the_motor_leaves_the_half_loop_of_the_torque_sensor(tmp_path: Path) -> None:
    """Two descriptions of the bends fit the log, each with its own friction angle. This is not a contradiction."""
    bends = [[0.0, 0.0], [0.06, 0.0], [0.2, 1.0], [1.0, 1.0]]
    file = NOMINAL.recalibrated(1.07, 44.0)
    truth = dataclasses.replace(file.recalibrated(1.05, 54.0), axial_stiffness=0.87 * file.axial_stiffness)
    factors = {
        "friction_coefficient": truth.friction_coefficient / file.friction_coefficient,
        "pretension": truth.pretension / file.pretension,
        "axial_stiffness": truth.axial_stiffness / file.axial_stiffness,
    }
    axis = {"perturbation": factors, "tendon": {"kind": "distributed", "curvature": bends}}
    wave = multi_sine((0.2, 0.5, 0.9), 0.4, 12.0)
    table = np.column_stack([wave.t, wave.tau_j_des])
    np.savetxt(tmp_path / "wave.csv", table, delimiter=",", header="t,tau_j_des", comments="")
    played = {"setpoint": {"kind": "file", "file": "wave.csv"}, "law": {"compensation": 0.0, "fade_in": 0.1}}
    controller = rig.write(tmp_path, VIRTUAL, RATE, "distributed", axis, played)
    for name in ("nominal.toml", rig.MODEL):
        save_model(dataclasses.replace(file, bending_centre=None), tmp_path / name)
    simulate_loop(controller, tmp_path / "plant.toml", wave.seconds, out=tmp_path)
    assert tsa(str(controller), "--from-log", str(tmp_path / "tsa.mcap"), "--yes", "--json") == 0
    written = load_tendon_sheath(tmp_path / rig.MODEL)
    true = truth.with_effects({"elongation_coupling": {"curvature_profile": bends}})
    assert sliding(written).half_loop == pytest.approx(sliding(true).half_loop, rel=0.03)
