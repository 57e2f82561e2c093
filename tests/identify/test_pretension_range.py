"""The appropriate range of the pretension, compared with the capstan tensions, and its remark in a calibration."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.blind import tendon_logs
from tests.control.sliding import actuator
from tests.identify.test_calibrate import rig_and_model
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.calibrate.pretension_range import appropriate, remark
from tsa_ctrl.identify.dataset import Dataset


def test_the_range_is_that_of_the_capstan() -> None:
    """At the lower end, one tendon is slack at the motor. At the upper end, friction alone takes the whole torque."""
    model = dataclasses.replace(actuator(), bending_centre=0.5)
    r_m, x = model.motor_pulley_radius, model.friction_angle
    lowest, highest = appropriate(model, 1.0)
    assert lowest - 0.5 / r_m == pytest.approx(0.0, abs=1e-9)
    assert 2.0 * highest * r_m * x == pytest.approx(1.0, rel=0.03)  # tanh x, x and sinh x differ by 2 % at 0.26


@pytest.mark.parametrize(
    ("torque", "words"), [(1.79, "one tendon is slack"), (1.2, ""), (0.5, ""), (0.3, "friction takes all of it")]
)
def test_what_is_not_appropriate_is_said(torque: float, words: str) -> None:
    """A pretension of 45 N carries 1.8 N*m, and friction takes 0.46 N*m."""
    said = remark(actuator(), torque)
    assert words in said
    assert bool(said) is bool(words)


def test_a_model_that_knows_slack_may_have_it() -> None:
    assert not remark(actuator().with_effects({"tendon_slack": {}}), 1.79)


def test_a_calibration_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same log is calibrated twice.

    The second time, the motor torque reaches 97 % of the capacity of both tendons.
    """
    load, more = tendon_logs._load, 1.0
    monkeypatch.setattr(tendon_logs, "_load", lambda t, rng: more * load(t, rng))
    said = []
    for _ in range(2):
        rng, rig, model = rig_and_model(1)
        columns = tendon_logs.record(rig, rng)
        found = calibrate([Dataset.from_arrays(columns, "a.csv")], model)
        said.append(any("one tendon is slack, or nearly so" in note for note in found.notes))
        more = 0.97 * 2.0 * rig.pretension * rig.r_m / float(np.abs(columns["tau_m"]).max())
    assert said == [False, True]
