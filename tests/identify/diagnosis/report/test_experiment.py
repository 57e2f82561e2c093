"""Wording of the experiment that separates indistinguishable effects."""

from __future__ import annotations

import pytest

from tsa_ctrl.identify.diagnosis.report.experiment import parted_by


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("transport_delay", "presliding_hysteresis"), ["several speeds"]),
        (("presliding_hysteresis", "transport_delay"), ["several speeds"]),
        (("elongation_coupling", "torque_constant_error"), ["bending angles", "known weight"]),
        (("parameter_error", "torque_constant_error"), ["known weight"]),
        (("inertia", "joint_stiffness"), ["two or more frequencies"]),
        (("thermal_friction_drift", "pretension_relaxation"), ["heat and cool"]),
        (("sheath_asymmetry", "torque_sensor_error"), ["torques of both signs"]),
        (("torque_ripple", "inertia"), ["several speeds", "torques of both signs"]),
    ],
)
def test_a_pair_is_parted_by_what_one_of_the_two_says(names: tuple[str, ...], words: list[str]) -> None:
    """The order of the pair does not matter.

    A pair without a specific rule gets the experiment that separates most pairs.
    """
    found = parted_by(names)
    assert len(found) == len(words)
    assert all(word in text for word, text in zip(words, found, strict=True))


def test_a_group_is_parted_pair_by_pair_and_nothing_is_said_twice() -> None:
    """Three effects that differ only by speed need one motion."""
    assert len(parted_by(("transport_delay", "velocity_lag", "backlash"))) == 1
