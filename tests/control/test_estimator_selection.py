"""Test the default estimator of an axis without a configured kind, and the reasons against the kind "stretch"."""

from __future__ import annotations

import dataclasses
import re

import pytest

from tests.control.sliding import actuator
from tsa_ctrl.control.estimator_selection import chosen, reason_for_fixed
from tsa_ctrl.control.settings import EstimatorSettings
from tsa_ctrl.model.parameters import TendonSheath

KNOWN = dataclasses.replace(actuator(), bending_centre=0.5)


def test_two_encoders_and_a_known_shape_make_it_the_stretch() -> None:
    settings, why = chosen(EstimatorSettings(), KNOWN, True, False, False)
    assert (settings.kind, settings.use, why) == ("stretch", True, "")


def test_a_joint_torque_sensor_comes_first_where_the_model_allows_it() -> None:
    settings, why = chosen(EstimatorSettings(), actuator(), True, True, False)
    assert (settings.kind, settings.use, why) == ("sensor", True, "")
    heated = KNOWN.with_effects({"thermal_friction_drift": {"temperature_coefficient": 0.01}})
    settings, why = chosen(EstimatorSettings(), heated, True, True, False)
    assert (settings.kind, settings.use) == ("fixed", False)
    assert "effects.thermal_friction_drift" in why


def test_what_the_file_says_counts() -> None:
    """A configured kind is kept, and it is used only if `use` is set. The default kind also respects `use = false`."""
    named, _ = chosen(EstimatorSettings(kind="stretch"), KNOWN, True, False, False)
    assert named.use is False
    unused, _ = chosen(EstimatorSettings(use=False), KNOWN, True, False, False)
    assert (unused.kind, unused.use) == ("stretch", False)
    fixed, why = chosen(EstimatorSettings(kind="fixed"), KNOWN, True, False, False)
    assert (fixed.kind, why) == ("fixed", "")


@pytest.mark.parametrize(
    ("model", "has_encoder", "words"),
    [
        (KNOWN, False, r"needs an \[axis.encoder\]"),
        (actuator(), True, "does not state where the sheath bends"),
        (dataclasses.replace(KNOWN, bending_centre=0.8), True, "the centre of the bends is at 0.80"),
        (dataclasses.replace(KNOWN, bending_centre=0.69), True, r"bending_centre 0.05 leaves 16 % of the half loop"),
        (dataclasses.replace(KNOWN, axial_stiffness_uncertainty=0.5), True, "axial_stiffness 0.5 is above 0.25"),
        (KNOWN.recalibrated(0.0), True, "no friction or no pretension"),
        (KNOWN.with_effects({"motor_side_friction": {"coulomb": 0.02}}), True, "effects.motor_side_friction"),
        (KNOWN.with_effects({"custom": {"expression": "0.1*sigma", "stage": "motor"}}), True, "effects.custom"),
    ],
)
def test_what_stands_against_it_is_said_in_one_line(model: TendonSheath, has_encoder: bool, words: str) -> None:
    settings, why = chosen(EstimatorSettings(), model, has_encoder, False, False)
    assert (settings.kind, settings.use) == ("fixed", False)
    assert "\n" not in why
    assert re.search(words, why)


def test_what_acts_on_the_joint_alone_does_not_matter() -> None:
    model = KNOWN.with_effects({"gravity_load": {"amplitude": 0.2}})
    assert reason_for_fixed(model, True) == ""
