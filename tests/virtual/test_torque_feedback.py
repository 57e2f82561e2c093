"""Test the correction by the torque sensor in the whole loop, on the plant's distributed tendons."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.virtual.joints import GAIT, error, play, rms, sine

JOINTS = {"held": sine(0.5, 0.5), "imposed": GAIT}


def remaining(folder: Path, load: str, friction: float, feedback: float) -> float:
    """Return the RMS error from 3.5 s on, mN*m. The plant has `friction` times the friction of the file."""
    plant = {"perturbation": {"friction_coefficient": friction}}
    axis = {"law": {"feedback": feedback}}
    result = play(folder, load, JOINTS[load], 7.0, compensation=0.95, axis=axis, plant=plant)
    assert not result.axes[0].faults
    return rms(error(result, 3.5))


@pytest.mark.slow
@pytest.mark.parametrize("load", JOINTS)
def test_friction_that_the_file_does_not_have_is_corrected(tmp_path: Path, load: str) -> None:
    """The plant has 6 % more friction than the file. At least a third of the error is removed."""
    assert remaining(tmp_path, load, 1.06, 3.0) < 0.67 * remaining(tmp_path, load, 1.06, 0.0)


@pytest.mark.slow
def test_a_rig_that_the_file_describes_exactly_does_not_get_worse(tmp_path: Path) -> None:
    assert remaining(tmp_path, "held", 1.0, 3.0) < 1.1 * remaining(tmp_path, "held", 1.0, 0.0)
