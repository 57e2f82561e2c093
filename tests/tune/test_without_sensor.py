"""`tsa tune` on a simulated rig whose joint torque nothing measures but the tendons' stretch."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.tune import rig
from tests.tune.test_in_virtual_time import RATE, SHORT, tune
from tsa_ctrl.demo.bus_choice import VIRTUAL
from tsa_ctrl.model.parameters import load_tendon_sheath


@pytest.mark.slow
@pytest.mark.parametrize("load", ["imposed", "limb"])
def test_the_half_loop_and_the_stiffness_are_found_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], load: str
) -> None:
    """15 % more friction, 12 % less pretension, 10 % softer tendons than the file says.

    A limb creeps between its strokes: regressed on where it moves, the half loop came out 8 % too low.
    """
    rig.write(tmp_path, VIRTUAL, RATE, "distributed", {"joint": {"load": load}})
    rig.without(tmp_path / rig.CONTROLLER, "torque_sensor")
    truth = load_tendon_sheath(tmp_path / rig.MODEL)
    half_loop = rig.true_half_loop(truth)
    assert tune(tmp_path, "--yes", "--json", "--out", str(tmp_path / "out"), *SHORT) == 0
    data = json.loads(capsys.readouterr().out)
    found = data["calibration"]["combinations"]["half_loop_torque"]
    assert found["low"] <= half_loop <= found["high"]
    assert found["value"] == pytest.approx(half_loop, rel=0.04)
    assert data["parameters"]["axial_stiffness"]["value"] == pytest.approx(0.9 * truth.axial_stiffness, rel=0.03)
    assert any("without a joint torque sensor" in note for note in data["notes"])
    written = load_tendon_sheath(tmp_path / rig.MODEL)
    made = 2.0 * written.joint_pulley_radius * written.pretension * written.friction_angle
    assert made == pytest.approx(half_loop, rel=0.05)


def test_what_the_stretch_needs_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig.write(tmp_path, VIRTUAL, RATE)
    rig.without(tmp_path / rig.CONTROLLER, "torque_sensor", "encoder")
    assert tune(tmp_path, "--yes", *SHORT) == 2
    said = capsys.readouterr().err
    assert "has no joint torque sensor" in said
    assert said.count("\n") == 1


@pytest.mark.slow
def test_a_joint_that_nothing_loads_is_to_be_moved_by_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Alone it runs to and fro too fast for its friction to show; moved from outside (above) it is tuned."""
    rig.write(tmp_path, VIRTUAL, RATE, "distributed", {"joint": {"load": "free"}})
    rig.without(tmp_path / rig.CONTROLLER, "torque_sensor")
    before = (tmp_path / rig.MODEL).read_bytes()
    assert tune(tmp_path, "--yes", "--json", "--seconds", "8", "--verify-seconds", "4") == 2
    said = capsys.readouterr().err
    assert "steady" in said
    assert "take it by hand" in said
    assert said.count("\n") == 1
    assert (tmp_path / rig.MODEL).read_bytes() == before
