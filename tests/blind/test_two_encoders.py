"""Compare the tendon elongation of the blind rigs with an independent calculation, and test logs with both angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from . import test_plant
from .plant import simulate
from .rig import Rig, draw_rig
from .two_encoders import SHAPES, names, stretch, two_encoder_case, without_motor_angle


def rig_without_friction() -> Rig:
    return replace(draw_rig(np.random.default_rng(3)), mu=0.0)


@pytest.mark.parametrize("shape", SHAPES)
def test_without_friction_the_stretch_is_the_torque_over_the_stiffness(shape: str) -> None:
    rig = rig_without_friction()
    moment = test_plant.scene(np.random.default_rng(0), rig)
    found = stretch(rig, simulate(rig, moment, {}), shape)
    assert found == pytest.approx(moment.tau_m / (2.0 * rig.tendon_stiffness * rig.motor_radius), abs=1e-9)


def test_a_tendon_alone_is_half_as_stiff() -> None:
    rig = rig_without_friction()
    moment = test_plant.scene(np.random.default_rng(0), rig, level=2.0)
    found = stretch(rig, simulate(rig, moment, {"tendon_slack": {}}), "joint")
    last = int(np.argmax(moment.tau_m))
    expected = moment.tau_m[last] / rig.motor_radius - rig.pretension
    assert found[last] == pytest.approx(expected / rig.tendon_stiffness)


def test_the_logs_have_both_angles_and_the_file_says_where_the_sheath_bends() -> None:
    case = two_encoder_case(names()[0], 0, short=True)
    assert {"q_m", "q_j"} <= case.logs[0].columns.keys()
    assert "bending_centre" in case.model
    assert "q_m" not in without_motor_angle(case).logs[0].columns
