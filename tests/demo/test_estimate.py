"""Test the benefit of the default estimator on the demo's rig.

The model file of this rig has a wrong friction, pretension and stiffness.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.rig import VIRTUAL, play_for
from tsa_ctrl.demo.run import compare

SECONDS = 6.0
# Time for two friction reversals (s). Before, the initial state of the tendons and the friction are unknown.
TURNED = 2.0


@pytest.mark.slow
@pytest.mark.parametrize("load", [pytest.param("imposed", marks=pytest.mark.soak), "weight"])
def test_measured_torque_and_stretch_make_a_better_command_than_the_file(tmp_path: Path, load: str) -> None:
    controllers = {
        name: rig.controller(VIRTUAL, name, 1000.0, "nominal.toml", 0.95, estimator)
        for name, estimator in (("default", None), ("fixed", {"kind": "fixed"}))
    }
    tables = rig.plant(VIRTUAL, "distributed", load=load)
    courses = compare(tmp_path, VIRTUAL, play_for(load), tables, controllers, SECONDS, lambda what, share: None)
    late = {
        name: np.sqrt(np.mean(np.square((course.delivered - course.wanted)[course.t > TURNED])))
        for name, course in courses.items()
    }
    assert late["default"] < 0.9 * late["fixed"]
