"""Causes that no torque shows are identified from the angles of both pulleys.

The logs are independent of the package.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind.stretch_effects import NAMES
from tests.blind.two_encoders import NOTHING, two_encoder_case, without_motor_angle
from tests.identify.diagnosis.nominal import diagnosed
from tsa_ctrl.identify.diagnosis.report.result import Verdict
from tsa_ctrl.identify.quantity import Quantity

MOST_WORDS = 35


@pytest.mark.slow
@pytest.mark.parametrize(("name", "shape"), list(zip(NAMES, ("even", "joint", "motor", "joint"), strict=True)))
def test_each_is_named_alone_with_its_numbers(name: str, shape: str) -> None:
    """The parameter is found within 5 %, and the prediction of the torque does not change.

    A slip occurs once and is not part of the model.
    """
    case = two_encoder_case(f"{name}:{shape}", 0, short=True)
    found = diagnosed(case)
    (cause,) = found.causes
    assert (cause.effect, cause.alternatives) == (name, ())
    assert found.verdict is Verdict.EXPLAINED
    assert found.gain == cause.explained_fraction == 0.0
    assert found.of_torque == ()
    assert len(found.sentence.split()) <= MOST_WORDS
    for key, true in case.truth.effects[name].items():
        quantity = cause.parameters[key]
        if isinstance(quantity, Quantity):
            assert quantity.value == pytest.approx(true, rel=0.05)
        else:
            assert quantity == true
    assert (name in found.model.effects) is (name != "pulley_slip")
    assert found.stretch is not None
    assert found.stretch.extended < 0.3 * found.stretch.without


@pytest.mark.slow
def test_without_the_motor_angle_nothing_is_said_of_them() -> None:
    case = two_encoder_case("pulley_slip:joint", 0, short=True)
    found = diagnosed(without_motor_angle(case))
    assert found.causes == ()
    assert found.stretch is None
    assert all(found.not_testable[name] == "no q_m column" for name in NAMES)


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape", [pytest.param("joint", marks=pytest.mark.soak), "even", pytest.param("motor", marks=pytest.mark.soak)]
)
def test_a_rig_as_its_file_says_has_none(shape: str) -> None:
    found = diagnosed(two_encoder_case(f"{NOTHING}:{shape}", 1, short=True))
    assert found.causes == ()
    assert not set(NAMES) & set(found.not_testable)


@pytest.mark.slow
def test_a_spring_is_a_wrong_stiffness_where_nobody_knows_the_shape() -> None:
    """If the file does not state where the sheath bends, only the total compliance is known.

    A series spring and a wrong stiffness both add to it.
    """
    case = two_encoder_case("series_spring:joint", 0, short=True)
    lines = [line for line in case.model.splitlines() if not line.startswith("bending_centre")]
    (cause,) = diagnosed(replace(case, model="\n".join(lines))).causes
    assert (cause.effect, cause.alternatives) == ("series_spring", ("parameter_error",))
    assert cause.probability < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.0, pytest.param(0.4, marks=pytest.mark.soak)])
def test_angles_that_contradict_the_file_name_nothing(factor: float) -> None:
    """The motor's encoder follows another shaft, or the tendons are stiffer than in the file.

    The reason is reported.
    """
    case = two_encoder_case("pulley_slip:joint", 0, short=True)
    assert case.bench is not None
    rig = case.bench.rig
    logs = []
    for log in case.logs:
        joint = rig.joint_radius / rig.motor_radius * log.columns["q_j"]
        other = joint + factor * (log.columns["q_m"] - joint) + 0.02 * (factor == 0.0) * np.sin(log.columns["t"])
        logs.append(replace(log, columns={**log.columns, "q_m": other}))
    found = diagnosed(replace(case, logs=logs))
    assert found.causes == ()
    assert "the angles of both pulleys" in found.not_testable["pulley_slip"]
