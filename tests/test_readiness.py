"""Bounds of a whole configuration that are looser than shipped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.virtual.files import controller, write
from tsa_ctrl.cli import cli
from tsa_ctrl.config import load_configuration
from tsa_ctrl.readiness import loose_lines

WORN = {"class": "worn", "wearer_speed": 4.0, "travel": [-1.0, 2.0]}


def lines(folder: Path, **changes: Any) -> list[str]:
    return loose_lines(load_configuration(write(folder, controller(**changes))[0]))


def test_the_example_has_no_loose_bound() -> None:
    assert loose_lines(load_configuration(Path(__file__).parents[1] / "config/controller.toml")) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"limits": {"joint_speed": 900.0, "over_speed": 1000.0}}, "over_speed 1000 rad/s (shipped is 12)"),
        ({"limits": {"travel": [-90.0, 45.0]}}, "travel 90 rad (shipped is 6.283)"),
        ({"limits": {"torque": 500.0}, "drive": {"max_torque": 500.0}}, "torque 500 N*m (shipped is 40)"),
        ({"drive": {"host_timeout": 10.0}}, "host_timeout 10 s (shipped is 0.1)"),
        ({"torque_sensor": {"heartbeat_timeout": 10.0}}, "[axis.torque_sensor] heartbeat_timeout 10 s"),
        ({"file": {"safety": {"zero_torque_within": 5.0}}}, "zero_torque_within 5 s (shipped is 0.25)"),
        ({"file": {"safety": {"wearer_speed": 9.0}}}, "joint_speed 11.25 rad/s (shipped is 10)"),
        ({"file": {"safety": WORN | {"wearer_speed": 9.0}}}, "joint_speed 11.25 rad/s (shipped is 8.75)"),
    ],
)
def test_a_bound_that_is_looser_than_shipped_is_listed(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    assert any(words in line for line in lines(tmp_path, **changes))


def test_a_check_prints_the_loose_bounds(tmp_path: Path) -> None:
    path, _ = write(tmp_path, controller(drive={"host_timeout": 0.3}))
    result = CliRunner().invoke(cli, ["run", "--check", str(path)])
    assert "looser than shipped: axis 'knee': [axis.drive] host_timeout 0.3 s (shipped is 0.1)" in result.output
