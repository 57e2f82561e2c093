"""`tsa tune` on a simulated rig without a joint torque sensor. The torque follows from the tendon elongation."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

from tests.tune import rig
from tests.tune.test_in_virtual_time import RATE, SHORT, tune
from tsa_ctrl.demo.rig import NOMINAL, VIRTUAL
from tsa_ctrl.errors import TooStillError, UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import load_tendon_sheath
from tsa_ctrl.tune.by_stretch import estimate_by_stretch


@pytest.mark.slow
@pytest.mark.soak  # with each change: by the elongation below, moved by hand; with a limb in test_beside_stretch.py
@pytest.mark.parametrize("load", ["imposed", "limb"])
def test_the_half_loop_and_the_stiffness_are_found_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], load: str
) -> None:
    """The rig has 15 % more friction, 12 % less pretension and 10 % softer tendons than the file.

    A limb creeps between its strokes. A regression on the moving samples would give a friction torque that is 8 % too
    low.
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


class Person(io.StringIO):
    """A person at a terminal who moves the joint when the first line is read and confirms at the second."""

    def __init__(self, plant: Path) -> None:
        super().__init__()
        self._plant = plant
        self._answers = iter(("\n", "y\n"))

    def isatty(self) -> bool:
        return True

    def readline(self, size: int | None = -1, /) -> str:
        text = self._plant.read_text(encoding="utf-8")
        self._plant.write_text(text.replace('load = "free"', 'load = "imposed"'), encoding="utf-8")
        return next(self._answers)


@pytest.mark.slow
def test_a_person_who_is_asked_moves_the_joint_and_the_tuning_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is another excitation after Enter. The plant's joint is free before it and moved from outside after it."""
    rig.write(tmp_path, VIRTUAL, RATE, "distributed", {"joint": {"load": "free"}})
    rig.without(tmp_path / rig.CONTROLLER, "torque_sensor")
    truth = load_tendon_sheath(tmp_path / rig.MODEL)
    monkeypatch.setattr("sys.stdin", Person(tmp_path / "plant.toml"))
    assert tune(tmp_path, "--seconds", "8", "--verify-seconds", "4", "--out", str(tmp_path / "out")) == 0
    said = capsys.readouterr()
    assert "move the joint by hand" in said.err
    assert "press Enter" in said.err
    assert "start again" not in said.err
    assert "written:" in said.out
    written = load_tendon_sheath(tmp_path / rig.MODEL)
    made = 2.0 * written.joint_pulley_radius * written.pretension * written.friction_angle
    assert made == pytest.approx(rig.true_half_loop(truth), rel=0.06)


def test_a_cure_is_said_only_of_what_it_cures(tmp_path: Path) -> None:
    """Moving the joint does not correct an angle with the wrong sign."""
    t = np.arange(0.0, 4.0, 0.002)
    q_j = np.sin(2.0 * np.pi * 0.5 * t)
    model = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})
    columns = {
        "t": t,
        "q_j": q_j,
        "q_m": -q_j,
        "tau_m": 0.3 * np.sign(np.gradient(q_j)),
        "omega_j": np.gradient(q_j, t),
    }
    with pytest.raises(UsageError, match="contradict each other") as caught:
        estimate_by_stretch([Dataset.from_arrays(columns, "log")], model)
    assert not isinstance(caught.value, TooStillError)
