"""Reference values of the memoryless effects, alone and in combination, with an agreement of 1e-9 N*m.

The table of `tests.blind` is independent of the package.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import blind
from tests.model.actuator import ACTUATOR
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

TABLE = json.loads(Path(blind.__file__).with_name("vectors.json").read_text(encoding="utf-8"))
STATES: list[dict[str, float]] = TABLE["states"]
OFF_CENTRE = {"pulley_eccentricity": {"relative_eccentricity": 0.2, "phase": 0.4}}
LATER: tuple[tuple[dict[str, dict[str, Any]], tuple[float, ...]], ...] = (  # effects that the table does not have
    (
        {"torque_saturation": {"limit": 0.8}},
        (0.442377522765, 1.625604149705, -1.237857586117, -0.054630959177, 0.442377522765, -1.625604149705),
    ),
    (
        {"torque_saturation": {"limit": 0.8}, "torque_constant_error": {"relative_error": 0.05}},
        (0.494077064576, 1.677303691516, -1.270169799749, -0.086943172809, 0.494077064576, -1.677303691516),
    ),
    (OFF_CENTRE, (0.791178476, 2.126856207158, -1.397347536369, -0.061669805212, 2.3619868216, -3.475279973076)),
    (
        {
            "load_dependent_friction": {"coefficient": 0.1},
            **OFF_CENTRE,
            "gravity_load": {"amplitude": 0.4, "phase": 0.2},
        },
        (0.52748294456, 2.171403348067, -1.744378589184, -0.247833674724, 2.339030962351, -3.669651976865),
    ),
)
CASES = [*((row["effects"], tuple(row["expected"])) for row in TABLE["cases"]), *LATER]


def columns(state: dict[str, float]) -> dict[str, Any]:
    return {name: np.array([value]) for name, value in state.items()}


@pytest.mark.parametrize(("effects", "expected"), CASES, ids=["+".join(effects) or "none" for effects, _ in CASES])
def test_joint_torque_equals_the_reference(effects: dict[str, dict[str, Any]], expected: tuple[float, ...]) -> None:
    """Each state of the reference table agrees within 1e-9 N*m in each case."""
    model = ACTUATOR.with_effects(effects)
    found = [float(predict(model, Signals(**columns(state)))[0]) for state in STATES]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)


def test_a_joint_that_moves_as_this_one_bends_the_sheath_as_this_one() -> None:
    """The references of configuration_dependent_bending hold for a hip with the same angle, with all or part of the
    gain.
    """
    gain = {"bending_per_joint_angle": 0.6}
    expected = next(values for effects, values in CASES if effects == {"configuration_dependent_bending": gain})
    for effects in (
        {"routing_by_joint": {"hip": 0.6}},
        {"routing_by_joint": {"hip": 0.4}, "configuration_dependent_bending": {"bending_per_joint_angle": 0.2}},
    ):
        for state, reference in zip(STATES, expected, strict=True):
            log = columns(state)
            found = predict(ACTUATOR.with_effects(effects), Signals(**log, joints={"hip": log["q_j"]}))[0]
            assert found == pytest.approx(reference, abs=1e-9)


def test_another_joint_that_changes_the_pretension_changes_only_the_loss() -> None:
    """T_p changes by c q, so the torque changes by -2 r_J c q sinh(sigma x)."""
    log = columns(STATES[0])
    plain = predict(ACTUATOR, Signals(**log))[0]
    changed = ACTUATOR.with_effects({"pretension_per_joint_angle": {"hip": 12.0}})
    found = predict(changed, Signals(**log, joints={"hip": np.array([0.5])}))[0]
    loss = 2.0 * ACTUATOR.joint_pulley_radius * 12.0 * 0.5 * np.sinh(ACTUATOR.friction_angle)
    assert found - plain == pytest.approx(-np.sign(STATES[0]["omega_j"]) * loss, abs=1e-9)
