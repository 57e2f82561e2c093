"""`tsa tune` with a joint torque sensor and two encoders on a limb, which creeps between its strokes."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tests.tune import rig
from tests.tune.test_in_virtual_time import RATE, tune
from tests.virtual.rigs import draw
from tsa_ctrl.demo.bus_choice import VIRTUAL
from tsa_ctrl.model.parameters import load_tendon_sheath, save_model

DRAWN = draw(1, 1)  # bends at the motor, soft tendons, a heavy motor; friction and pretension are off


@pytest.mark.slow
def test_on_a_limb_the_half_loop_is_the_stretchs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Regressed on where the joint moves, the half loop came out as 28 % of the true one."""
    law = {"compensation": rig.COMPENSATION, "fade_in": 1.0}
    plant = {**DRAWN.axis(), "joint": {"load": "limb"}}
    controller = rig.write(tmp_path, VIRTUAL, RATE, "distributed", plant, {"law": law})
    save_model(DRAWN.nominal, tmp_path / "actuator.toml")  # the plant's own: tune writes the controller's
    text = (tmp_path / "plant.toml").read_text().replace(rig.MODEL, "actuator.toml")
    (tmp_path / "plant.toml").write_text(text)
    save_model(DRAWN.nominal, tmp_path / rig.MODEL)
    spans = ("--seconds", "10", "--verify-seconds", "4")
    assert tune(controller.parent, "--yes", "--json", "--out", str(tmp_path / "out"), *spans) == 0
    data = json.loads(capsys.readouterr().out)
    truth = DRAWN.truth
    half_loop = 2.0 * truth.joint_pulley_radius * truth.pretension * math.sinh(truth.friction_angle)
    found = data["calibration"]["combinations"]["half_loop_torque"]
    assert found["low"] <= half_loop <= found["high"]
    assert found["value"] == pytest.approx(half_loop, rel=0.02)
    assert any("the stretch's is taken" in note for note in data["notes"])
    assert data["verification"]["reduction_percent"]["after"] > 80.0
    written = load_tendon_sheath(tmp_path / rig.MODEL)
    assert written.pretension * written.friction_angle == pytest.approx(
        truth.pretension * truth.friction_angle, rel=0.03
    )
