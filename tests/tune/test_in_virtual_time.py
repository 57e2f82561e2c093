"""`tsa tune` on a simulated rig in virtual time: the whole procedure."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.tune import rig
from tsa_ctrl.cli import main
from tsa_ctrl.demo.bus_choice import VIRTUAL
from tsa_ctrl.model.parameters import load_tendon_sheath

RATE = 500.0  # Hz
SHORT = ("--seconds", "12", "--verify-seconds", "6")


def tune(folder: Path, *options: str) -> int:
    """The exit status of `tsa tune --virtual` in a folder with a rig's files."""
    with pytest.raises(SystemExit) as done:
        main(["tune", str(folder / rig.CONTROLLER), "--virtual", str(folder / "plant.toml"), *options])
    assert isinstance(done.value.code, int)
    return done.value.code


@pytest.mark.slow
def test_the_whole_procedure_finds_the_half_loop_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig.write(tmp_path, VIRTUAL, RATE)
    truth = load_tendon_sheath(tmp_path / rig.MODEL)
    x = truth.friction_angle * rig.TRUTH["friction_coefficient"]
    half_loop = 2.0 * truth.joint_pulley_radius * truth.pretension * rig.TRUTH["pretension"] * x  # evenly bent
    assert tune(tmp_path, "--yes", "--json", "--out", str(tmp_path / "out"), *SHORT) == 0
    data = json.loads(capsys.readouterr().out)
    found = data["calibration"]["combinations"]["half_loop_torque"]
    assert found["value"] == pytest.approx(half_loop, rel=0.05)
    reduction = data["verification"]["reduction_percent"]
    assert reduction["after"] > 85.0
    assert data["written"] is not None
    assert load_tendon_sheath(tmp_path / rig.MODEL) != truth
    assert (tmp_path / "out" / "report.html").stat().st_size > 50_000
    assert not list(tmp_path.glob(".tune-*"))


def test_a_plant_that_is_not_there_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    controller = rig.write(tmp_path, VIRTUAL, RATE)
    with pytest.raises(SystemExit) as done:
        main(["tune", str(controller), "--virtual", str(tmp_path / "nowhere.toml"), "--out", str(tmp_path / "out")])
    assert done.value.code == 2
    assert "nowhere.toml: no such file" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
