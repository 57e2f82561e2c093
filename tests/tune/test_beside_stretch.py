"""`tsa tune` with a joint torque sensor and two encoders: selection of the source of the friction."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.tune import rig
from tests.tune.test_command import tsa
from tests.tune.test_in_virtual_time import RATE
from tests.virtual.rigs import draw
from tsa_ctrl.demo.rig import NOMINAL, VIRTUAL
from tsa_ctrl.model.parameters import load_tendon_sheath, save_model
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.tune.excitation import multi_sine
from tsa_ctrl.virtual.simulation import simulate_loop

DRAWN = draw(1, 1)  # bends at the motor, soft tendons, a heavy motor; friction and pretension differ from nominal


def played(folder: Path, controller: Path, peak: float, seconds: float) -> None:
    """Play a waveform (N*m, s) without compensation, tune from its log, and write the model file."""
    wave = multi_sine((0.2, 0.5, 0.9), peak, seconds)
    table = np.column_stack([wave.t, wave.tau_j_des])
    np.savetxt(folder / "wave.csv", table, delimiter=",", header="t,tau_j_des", comments="")
    simulate_loop(controller, folder / "plant.toml", wave.seconds, out=folder)
    assert tsa(str(controller), "--from-log", str(folder / "tsa.mcap"), "--yes", "--json") == 0


PLAYED = {"setpoint": {"kind": "file", "file": "wave.csv"}, "law": {"compensation": 0.0, "fade_in": 0.1}}


@pytest.mark.slow
def test_of_a_limbs_log_the_half_loop_is_the_stretchs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A regression on the moving samples would give an eighth of the true friction torque."""
    plant = {**DRAWN.axis(), "joint": {"load": "limb"}}
    controller = rig.write(tmp_path, VIRTUAL, RATE, "distributed", plant, PLAYED)
    save_model(DRAWN.nominal, tmp_path / "actuator.toml")  # the plant's own file: tune writes the controller's
    text = (tmp_path / "plant.toml").read_text().replace(rig.MODEL, "actuator.toml")
    (tmp_path / "plant.toml").write_text(text)
    save_model(DRAWN.nominal, tmp_path / rig.MODEL)
    played(tmp_path, controller, 0.8, 8.0)
    data, truth = json.loads(capsys.readouterr().out), DRAWN.truth
    half_loop = 2.0 * truth.joint_pulley_radius * truth.pretension * math.sinh(truth.friction_angle)
    found = data["calibration"]["combinations"]["half_loop_torque"]
    assert found["low"] <= half_loop <= found["high"]
    assert found["value"] == pytest.approx(half_loop, rel=0.02)
    assert any("the value from the elongation is used" in note for note in data["notes"])
    written = load_tendon_sheath(tmp_path / rig.MODEL)
    true = truth.pretension * truth.friction_angle
    assert written.pretension * written.friction_angle == pytest.approx(true, rel=0.03)


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
    controller = rig.write(tmp_path, VIRTUAL, RATE, "distributed", axis, PLAYED)
    for name in ("nominal.toml", rig.MODEL):
        save_model(dataclasses.replace(file, bending_centre=None), tmp_path / name)
    played(tmp_path, controller, 0.4, 12.0)
    written = load_tendon_sheath(tmp_path / rig.MODEL)
    true = truth.with_effects({"elongation_coupling": {"curvature_profile": bends}})
    assert sliding(written).half_loop == pytest.approx(sliding(true).half_loop, rel=0.03)
