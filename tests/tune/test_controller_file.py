"""Changes of the controller's file by a tuning: nothing else changes, and other changes can be detected."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from tsa_ctrl.errors import UsageError
from tsa_ctrl.tune.mechanics import Key, differ_in_law_alone, with_law

CONFIG = Path(__file__).resolve().parents[2] / "config" / "controller.toml"
TWO = """\
[[axis]]
name = "hip"
law = { delay = 0.002 }
[[axis]]
name = "knee" # of the left leg
[axis.limits]
torque = 2.0
"""
KEYS = {"motor_inertia": Key(1.02e-4, "measured, 1e-4 to 1.04e-4 kg*m^2"), "delay": Key(0.003, "measured")}


def test_the_shipped_file_gets_a_line_for_each_key_with_its_comment() -> None:
    """A second tuning replaces numbers and comments."""
    before = CONFIG.read_text(encoding="utf-8")
    after = with_law(before, "knee", KEYS)
    added = set(after.splitlines()) - set(before.splitlines())
    assert added == {
        "motor_inertia = 0.000102 # tsa tune: measured, 1e-4 to 1.04e-4 kg*m^2",
        "delay = 0.003 # tsa tune: measured",
    }
    assert len(after.splitlines()) == len(before.splitlines()) + 2
    assert tomllib.loads(after)["axis"][0]["law"]["motor_inertia"] == 1.02e-4
    again = with_law(after, "knee", {"delay": Key(0.004, "measured anew")})
    assert "delay = 0.004 # tsa tune: measured anew" in again.splitlines()
    assert "delay = 0.003" not in again


def test_keys_in_braces_are_replaced_without_comments() -> None:
    after = with_law(TWO, "hip", {"delay": Key(0.003, "measured")})
    assert after == TWO.replace("0.002", "0.003")


def test_an_axis_without_a_law_gets_one_and_keeps_its_comments() -> None:
    after = with_law(TWO, "knee", KEYS)
    assert after.startswith(TWO)
    assert tomllib.loads(after)["axis"][1]["law"] == {"motor_inertia": 1.02e-4, "delay": 0.003}


@pytest.mark.parametrize("axis", ["hip", "knee"])
def test_one_sees_whether_anything_else_changed(axis: str) -> None:
    after = with_law(
        TWO, axis, {"lead": Key(0.01, "half the turn"), **KEYS} if axis == "knee" else {"delay": KEYS["delay"]}
    )
    assert differ_in_law_alone(TWO, after, axis)
    assert not differ_in_law_alone(TWO, after + "# mine\n", axis)
    assert not differ_in_law_alone(TWO, after.replace("2.0", "3.0"), axis)
    assert not differ_in_law_alone(TWO, TWO.replace("2.0", "3.0"), axis)


def test_a_layout_that_has_no_place_for_them_is_one_line() -> None:
    flat = 'axis = [{ name = "knee", law.delay = 0.002 }]\n'
    with pytest.raises(
        UsageError, match=r"delay = 0\.003 cannot be inserted into this layout; write it into \[axis.law\]"
    ):
        with_law(flat, "knee", {"delay": Key(0.003, "measured")})
