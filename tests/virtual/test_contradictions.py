"""What lies on a running rig, in virtual time: the real loop and supervision on the real plant."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.virtual.joints import play

CONSTANT = {"kind": "constant", "offset": 0.5}


@pytest.mark.parametrize("wrong", [0.09, 0.05])
def test_a_lie_is_found_though_the_truth_is_told_now_and_then(tmp_path: Path, wrong: float) -> None:
    """The motor turns the wrong way for `wrong` s of each 0.1: not one tenth of a second in a row."""
    strict = {"plausibility": {"joint_torque": 0.5}}
    flaps = [f"reversed_sign duration={wrong}@{0.8 + 0.1 * n}" for n in range(8)]
    result = play(tmp_path, "held", CONSTANT, 1.6, axis=strict, faults=flaps)
    assert result.axes[0].faults[0].startswith("tripped by the controller: the joint torque sensor")
