"""Test that `tsa init` writes valid files and never overwrites a file."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tsa_ctrl.cli import main
from tsa_ctrl.cli.init import DESK, RIG, SHIPPED, Changes, with_values
from tsa_ctrl.config import check_drives, load_configuration
from tsa_ctrl.control.setpoint import SetPoint
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.plant.process import check


def run(*line: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(line))
    return int(ended.value.code or 0)


def test_the_desk_set_is_valid_on_any_machine(tmp_path: Path) -> None:
    assert run("init", "--desk", str(tmp_path / "new")) == 0
    configuration = load_configuration(tmp_path / "new/controller.toml")
    check_drives(configuration)
    file, plant = configuration.file, check(tmp_path / "new/plant.toml")
    assert len(plant.axis) == 1
    assert (file.bus.interface, file.bus.channel) == (plant.bus.interface, plant.bus.channel)
    assert (file.bus.interface, file.realtime.allow_without, file.controller.rate) == ("udp_multicast", True, 250.0)


@pytest.mark.parametrize("options", [[], ["--rig"]])
def test_an_unfilled_rig_lists_every_empty_value_in_one_line(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("init", *options, str(tmp_path / "rig")) == 0
    capsys.readouterr()
    assert run("run", "--check", str(tmp_path / "rig/controller.toml")) == 2
    (line,) = capsys.readouterr().err.splitlines()
    for name in ("controller.toml", "actuator.toml"):
        text = (tmp_path / "rig" / name).read_text(encoding="utf-8")
        empty = re.findall(r'^(\w+) = "" +# FILL IN: \S', text, re.MULTILINE)
        assert len(empty) == len(re.findall(r'^\w+ = ""', text, re.MULTILINE)) > 5
        listed = line.partition(f"{name}: ")[2].partition(";")[0]
        assert [key.rpartition(".")[2] for key in listed.split(", ")] == empty
    assert "15 values are empty" in line
    with pytest.raises(UsageError, match=r"8 values are empty; .*actuator.toml: actuator.motor_pulley_radius, .*value"):
        load_model(tmp_path / "rig/actuator.toml")
    assert 'channel = "can0"' in (tmp_path / "rig/controller.toml").read_text()
    assert not [path for path in (tmp_path / "rig").rglob("*.toml") if "vcan" in path.read_text()]


def filled(folder: Path) -> Path:
    """Write the files of a rig, fill in every empty value, and return the path of the controller file."""
    run("init", "--rig", str(folder))
    shutil.copy(SHIPPED / "actuator.toml", folder)
    path = folder / "controller.toml"
    values = {"rated_torque": "1.5", "gear_ratio": "2.0", "counts_per_revolution": "65_536"}
    ids = iter(("1", "32", "64"))
    path.write_text(
        re.sub(
            r'^(\w+) = ""',
            lambda found: f"{found[1]} = {next(ids) if found[1] == 'node_id' else values[found[1]]}",
            path.read_text(encoding="utf-8"),
            flags=re.MULTILINE,
        ),
        encoding="utf-8",
    )
    return path


def test_a_filled_rig_cannot_move_anything(tmp_path: Path) -> None:
    """A second torque limit is rejected."""
    path = filled(tmp_path / "rig")
    (axis,) = load_configuration(path).file.axes
    assert axis.limits.torque == pytest.approx(0.3)  # a tenth of the rated torque, at the gear output
    assert axis.law.compensation == 0.0
    play = SetPoint(axis.setpoint, 1e-3, tmp_path)
    assert {play.update(0.01 * step) for step in range(300)} == {0.0}
    path.write_text(path.read_text().replace("torque_share = 0.1", "torque = 0.2\ntorque_share = 0.1"))
    with pytest.raises(UsageError, match="both torque and torque_share are given; keep one"):
        load_configuration(path)


def test_nothing_that_is_there_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two sets of files at once are rejected."""
    (tmp_path / "plant.toml").write_text("mine")
    assert run("init", str(tmp_path)) == 2
    assert "plant.toml: already exists" in capsys.readouterr().err
    for other in ("--desk", "--leg"):
        assert run("init", "--rig", other, str(tmp_path / "new")) == 2
        assert "give one of them" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plant.toml"]
    assert (tmp_path / "plant.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("changes", "name"),
    [(changes, name) for changes in (DESK, RIG) for name in changes],
    ids=lambda name: str(name)[:9],
)
def test_every_key_that_a_set_changes_stands_in_the_shipped_file(changes: dict[str, Changes], name: str) -> None:
    text = (SHIPPED / name).read_text(encoding="utf-8")
    before, after = text.splitlines(), with_values(text, changes[name]).splitlines()
    assert len(before) == len(after)

    with pytest.raises(KeyError):
        with_values(text, {"bus": {"no_such_key": "1"}})


def test_a_leg_has_three_joints_on_one_bus(tmp_path: Path) -> None:
    """The files are valid. The actuator files contain the routing, and only the first joint's keys are explained."""
    assert run("init", "--leg", str(tmp_path / "leg")) == 0
    configuration = load_configuration(tmp_path / "leg/controller.toml")
    check_drives(configuration)
    assert [axis.name for axis in configuration.file.axes] == ["hip", "knee", "ankle"]
    gains = [None if model.routing is None else dict(model.routing.a.gains) for model in configuration.models]
    assert gains == [None, {"hip": 0.8}, {"knee": 0.5}]
    assert [axis.name for axis in check(tmp_path / "leg/plant.toml").axis] == ["hip", "knee", "ankle"]
    text = (tmp_path / "leg/controller.toml").read_text(encoding="utf-8")
    assert text.count("share c of the friction term") == 1
