"""The catalogue of effects as data."""

from __future__ import annotations

import math

import pytest

from tsa_ctrl.model.catalogue import CATALOGUE, Parameter, Stage, check_effects

STAGES = list(Stage)


def test_order_of_the_table_is_the_order_of_composition() -> None:
    """Stages never go back."""
    order = [STAGES.index(spec.stage) for spec in CATALOGUE.values()]
    assert order == sorted(order)


def test_effects_within_a_stage_keep_their_order() -> None:
    """Gain before ripple before motor friction; bending before stiffness before relaxation."""
    names = list(CATALOGUE)
    chain = [
        ("torque_constant_error", "torque_ripple", "motor_side_friction"),
        ("configuration_dependent_bending", "stiffness_nonlinearity", "pretension_relaxation"),
        ("stribeck_friction", "thermal_friction_drift", "tension_dependent_friction"),
    ]
    for group in chain:
        assert [names.index(name) for name in group] == sorted(names.index(name) for name in group)


def test_defaults_are_filled_in() -> None:
    """A file need not say what the catalogue knows; what depends on the log stays out."""
    assert check_effects({"pretension_relaxation": {"relaxed_fraction": 0.1, "time_constant": 9}}, "file") == {
        "pretension_relaxation": {"relaxed_fraction": 0.1, "time_constant": 9.0, "law": "exponential"}
    }


@pytest.mark.parametrize(
    ("parameter", "accepted", "refused"),
    [
        (Parameter("k", "1", low=0.0), (0, 0.0, 5.0), (-1e-9, math.nan, math.inf, "1", True, None)),
        (Parameter("k", "1", low=0.0, low_open=True), (1e-9,), (0.0,)),
        (Parameter("k", "1", low=-2.0, high=2.0, low_open=True, high_open=True), (1.99,), (-2.0, 2.0)),
        (Parameter("n", "1", low=1, integer=True), (1, 4.0), (0, 1.5)),
        (Parameter("law", "1", choices=("a", "b")), ("a",), ("c", 1)),
    ],
)
def test_bounds(parameter: Parameter, accepted: tuple[object, ...], refused: tuple[object, ...]) -> None:
    """Open and closed bounds, whole numbers, choices; numbers are finite."""
    assert all(parameter.accepts(value) for value in accepted)
    assert not any(parameter.accepts(value) for value in refused)
