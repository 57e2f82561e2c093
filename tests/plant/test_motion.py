"""Test the prescribed motion of a joint: the shipped cycle, and its cost at startup."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tsa_ctrl.plant.motion import _KNEE, build_motion
from tsa_ctrl.plant.settings import MotionSettings


@pytest.mark.parametrize("period", [0.7, 1.2])
def test_a_gait_is_the_periodic_spline_through_its_points(period: float) -> None:
    motion = build_motion(MotionSettings(kind="gait", period=period, scale=0.8))
    x, y = np.array([*_KNEE, (1.0, _KNEE[0][1])]).T
    expected = CubicSpline(period * x, 0.8 * np.radians(y), bc_type="periodic")
    t = motion.grid * np.arange(motion.angle.size)
    np.testing.assert_allclose(motion.angle, expected(t), atol=1e-12)
    np.testing.assert_allclose(motion.speed, expected(t, 1), atol=1e-11)


def test_a_plant_with_the_shipped_motion_starts_without_scipys_splines() -> None:
    """They took 0.8 s of 1.5 s for all imports, and three times as long in a vcan guest."""
    code = (
        "import sys; from tsa_ctrl.plant import process; from tsa_ctrl.plant.motion import build_motion; "
        "from tsa_ctrl.plant.settings import MotionSettings; build_motion(MotionSettings()); "
        "sys.exit('scipy.interpolate' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
