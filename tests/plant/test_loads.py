"""Test the loads of the joint: locked, moved by its torque, held by a hand that moves and lets go."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.plant.bench import axis
from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.axis import Axis

HOLD = [(0.0, 20.0, 1.0, 0.3), (1.0, 20.0, 1.0, 0.3)]


def free_of_friction(folder: Path, **joint: Any) -> Axis:
    """Return an axis without friction in its tendons, whose motor is off."""
    made = axis(folder, joint=joint)
    made.parameters["friction"] = 0.0
    made.parameters["motor_damping"] = 1e-9
    return made


def course(joint: Axis, seconds: float, *names: str) -> np.ndarray:
    """Return the values of these names in each millisecond, (n, names)."""
    start, rows = joint.time, []
    for n in range(round(seconds * 1e3)):
        joint.advance(start + (n + 1) * 1e-3)
        values = joint.values()
        rows.append([values[name] for name in names])
    assert joint.values()["unsolved"] == 0
    return np.array(rows)


def test_a_held_joint_stays_where_it_is(tmp_path: Path) -> None:
    held = axis(tmp_path, joint={"load": "held", "initial_angle": 0.4})
    held.command.enabled, held.command.torque = True, 1.0
    assert np.all(course(held, 0.2, "q_j", "omega_j") == [0.4, 0.0])


def test_a_limb_swings_at_its_own_frequency(tmp_path: Path) -> None:
    limb = free_of_friction(tmp_path, load="limb", initial_angle=0.1)
    angle = course(limb, 2.0, "q_j")[:, 0]
    turns = np.flatnonzero((angle[:-1] > 0.0) & (angle[1:] <= 0.0))
    assert 1e-3 * np.diff(turns).mean() == pytest.approx(2.0 * math.pi * math.sqrt(0.05 / 4.0), rel=0.02)


def test_a_hand_carries_the_weight_that_it_holds(tmp_path: Path) -> None:
    held = free_of_friction(tmp_path, load="limb", hand=HOLD, initial_angle=0.3)
    angle, torque = course(held, 3.0, "q_j", "tau_outside")[-1]
    assert torque == pytest.approx(4.0 * math.sin(angle), abs=1e-3)
    assert torque == pytest.approx(20.0 * (0.3 - angle), abs=1e-3)


def test_a_hand_that_lets_go_takes_no_part_any_more(tmp_path: Path) -> None:
    script = [(0.0, 20.0, 1.0, 0.5), (0.5, 20.0, 1.0, 0.5), (0.52, 0.0, 0.0, 0.5)]
    limb = free_of_friction(tmp_path, load="limb", hand=script, hand_repeat=False, initial_angle=0.5)
    values = course(limb, 2.0, "q_j", "tau_outside")
    assert abs(values[400, 0] - 0.5) < 0.2
    assert np.all(values[530:, 1] == 0.0)
    assert values[530:, 0].min() < -0.1  # it oscillates


def test_a_hand_moves_smoothly_from_row_to_row(tmp_path: Path) -> None:
    script = [(0.0, 15.0, 1.0, 0.0), (1.0, 15.0, 1.0, 0.6), (2.0, 15.0, 1.0, 0.0)]
    moved = free_of_friction(tmp_path, load="free", hand=script)
    angle, speed = course(moved, 4.0, "hand_angle", "hand_speed").T
    assert angle[999] == pytest.approx(0.6, abs=1e-5)
    assert angle[1999] == pytest.approx(0.0, abs=1e-5)
    assert angle[2999] == pytest.approx(0.6, abs=1e-5)  # the script has repeated
    assert np.abs(np.diff(angle) / 1e-3 - speed[1:]).max() < 0.01
    assert np.abs(np.diff(speed)).max() < 0.01


@pytest.mark.parametrize("elements", [4, 40])
def test_a_joint_that_is_thrown_through_many_turns_has_a_solution(tmp_path: Path, elements: int) -> None:
    """A hand jumps by 1000 rad in 1 ms. The rounding errors of such angles must not prevent a solution."""
    script = [(0.0, 15.0, 1.0, 0.0), (0.1, 15.0, 1.0, 0.0), (0.101, 15.0, 1.0, 1000.0), (9.0, 15.0, 1.0, 1000.0)]
    thrown = axis(
        tmp_path,
        joint={"load": "wearer", "hand": script, "inertia": 0.02},
        tendon={"kind": "distributed", "elements": elements},
        motor={"inertia": 1e-4},
    )
    assert course(thrown, 0.8, "q_j").max() > 500.0


@pytest.mark.parametrize(
    ("joint", "motion", "message"),
    [
        (
            {"load": "spring", "stiffness": 1e12, "rest_angle": 1e3},
            {},
            r"speed .* rad/s at .*; allowed is at most 1e\+06",
        ),
        ({"load": "free", "initial_angle": 1e300}, {}, r"angle 1\.25e\+300 rad .*; allowed is at most 100000 rad"),
        ({}, {"kind": "gait", "scale": 1e12, "ramp": 0.0}, r"plant's axis 'joint': .*motion"),
    ],
)
@pytest.mark.parametrize("kind", ["full", "distributed"])
def test_a_state_beyond_the_range_of_the_equations_is_one_error(
    tmp_path: Path, joint: dict[str, Any], motion: dict[str, Any], message: str, kind: str
) -> None:
    moved = axis(tmp_path, joint=joint, motion=motion, tendon={"kind": kind}, motor={"inertia": 1e-4})
    with pytest.raises(UsageError, match=message) as error:
        course(moved, 2.0, "q_j")
    assert "\n" not in str(error.value)
