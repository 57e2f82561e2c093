"""Names that the torque leaves, and the angles of both pulleys beside it: on logs that the package did not make."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from tests.blind.cases import Case
from tests.blind.two_encoders import two_encoder_case, without_motor_angle
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import model_from


def names(case: Case) -> list[set[str]]:
    """What is named, a set for each cause."""
    logs = [Dataset.from_arrays(log.columns, log.name) for log in case.logs]
    found = diagnose(logs, model_from(tomllib.loads(case.model), "nominal.toml"))
    return [{cause.effect, *cause.alternatives} for cause in found.causes]


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [pytest.param(1, id="evenly bent"), pytest.param(2, id="bent at the motor", marks=pytest.mark.soak)]
)
def test_the_stretch_parts_shape_from_torque_constant(seed: int) -> None:
    """Twins to the torque sensor; friction before the bends stretches the tendons, the motor's scale does not."""
    case = two_encoder_case("elongation_or_gain:joint", seed, short=True)
    (group,) = names(without_motor_angle(case))
    assert {"elongation_coupling", "torque_constant_error"} <= group
    assert names(case) == [{"elongation_coupling"}]


@pytest.mark.slow
def test_a_cause_that_the_stretch_contradicts_gives_its_place_to_a_rival() -> None:
    case = two_encoder_case("gain_or_elongation:joint", 0, short=True)
    (group,) = names(case)
    assert "torque_constant_error" in group
    assert "elongation_coupling" not in group


@pytest.mark.slow
@pytest.mark.soak  # angles that contradict the file: test_by_stretch.py, too
def test_a_stretch_that_follows_no_hypothesis_excludes_none() -> None:
    """A motor's encoder on another shaft: its angle has nothing to do with the tendons."""
    case = two_encoder_case("elongation_or_gain:joint", 1, short=True)
    logs = []
    for log in case.logs:
        t = log.columns["t"]
        rig = case.bench.rig if case.bench else None
        assert rig is not None
        other = rig.joint_radius / rig.motor_radius * log.columns["q_j"] + 0.05 * np.sin(2.0 * np.pi * 0.37 * t)
        logs.append(replace(log, columns={**log.columns, "q_m": other}))
    (group,) = names(replace(case, logs=logs))
    assert {"elongation_coupling", "torque_constant_error"} <= group


ALL_ALONG = [40.0, 2.0, 2.5, 3.0, 2.2, 1.8, 9.0, 2.1, 2.6, 3.1, 1.9, 2.4]  # what blocks gain, very unequally
NOW_AND_THEN = [40.0, -2.0, 2.5, -3.0, 2.2, -1.8, 9.0, -2.1, 2.6, -3.1, 1.9, -2.4]  # two say all of it
