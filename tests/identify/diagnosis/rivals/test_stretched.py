"""Causes that the torque cannot separate are separated by the angles of both pulleys.

The logs are independent of the package.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind.two_encoders import two_encoder_case, without_motor_angle
from tests.identify.diagnosis.nominal import diagnosed, named


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [pytest.param(1, id="evenly bent"), pytest.param(2, id="bent at the motor", marks=pytest.mark.soak)]
)
def test_the_stretch_parts_shape_from_torque_constant(seed: int) -> None:
    """The torque sensor cannot distinguish them.

    Friction ahead of the bends elongates the tendons. A scale error of the motor torque does not.
    """
    case = two_encoder_case("elongation_or_gain:joint", seed, short=True)
    (group,) = named(diagnosed(without_motor_angle(case)))
    assert {"elongation_coupling", "torque_constant_error"} <= group
    assert named(diagnosed(case)) == [{"elongation_coupling"}]


@pytest.mark.slow
def test_a_cause_that_the_stretch_contradicts_gives_its_place_to_a_rival() -> None:
    case = two_encoder_case("gain_or_elongation:joint", 0, short=True)
    (group,) = named(diagnosed(case))
    assert "torque_constant_error" in group
    assert "elongation_coupling" not in group


@pytest.mark.slow
@pytest.mark.soak  # test_by_stretch.py also tests angles that contradict the file
def test_a_stretch_that_follows_no_hypothesis_excludes_none() -> None:
    """The motor's encoder is on another shaft, so its angle is unrelated to the tendons."""
    case = two_encoder_case("elongation_or_gain:joint", 1, short=True)
    logs = []
    for log in case.logs:
        t = log.columns["t"]
        rig = case.bench.rig if case.bench else None
        assert rig is not None
        other = rig.joint_radius / rig.motor_radius * log.columns["q_j"] + 0.05 * np.sin(2.0 * np.pi * 0.37 * t)
        logs.append(replace(log, columns={**log.columns, "q_m": other}))
    (group,) = named(diagnosed(replace(case, logs=logs)))
    assert {"elongation_coupling", "torque_constant_error"} <= group
