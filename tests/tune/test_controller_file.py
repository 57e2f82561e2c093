"""The slew in the controller's file: nothing else changes, and one can see whether anything else did."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from tsa_ctrl.tune.controller_file import differ_in_slew_alone, with_slew

CONFIG = Path(__file__).resolve().parents[2] / "config" / "controller.toml"
TWO = """\
[[axis]]
name = "hip"
law = { slew = 50.0 }
[[axis]]
name = "knee" # of the left leg
[axis.limits]
torque = 2.0
"""


def test_the_shipped_file_gets_one_line() -> None:
    before = CONFIG.read_text(encoding="utf-8")
    after = with_slew(before, "knee", 85.6)
    assert set(after.splitlines()) - set(before.splitlines()) == {"slew = 85.6"}
    assert len(after.splitlines()) == len(before.splitlines()) + 1
    assert tomllib.loads(after)["axis"][0]["law"]["slew"] == 85.6


def test_a_slew_that_is_there_is_replaced() -> None:
    assert with_slew(TWO, "hip", 60.0) == TWO.replace("50.0", "60.0")


def test_an_axis_without_a_law_gets_one_and_keeps_its_comments() -> None:
    after = with_slew(TWO, "knee", 60.0)
    assert after.startswith(TWO)
    assert tomllib.loads(after)["axis"][1]["law"] == {"slew": 60.0}


@pytest.mark.parametrize("axis", ["hip", "knee"])
def test_one_sees_whether_anything_else_changed(axis: str) -> None:
    after = with_slew(TWO, axis, 60.0)
    assert differ_in_slew_alone(TWO, after, axis)
    assert not differ_in_slew_alone(TWO, after + "# mine\n", axis)
    assert not differ_in_slew_alone(TWO, after.replace("2.0", "3.0"), axis)
