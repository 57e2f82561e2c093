"""By how much the loop's direction leads the velocity: only where the model file says how late that is."""

from __future__ import annotations

import math

import pytest

from tests.control.sliding import actuator
from tsa_ctrl.control.direction import MOST_LEAD
from tsa_ctrl.control.law import LawSettings
from tsa_ctrl.daemon.assembly import lead_of

LAW = LawSettings(compensation=0.9, slew=100.0)


def test_without_a_measured_lag_nothing_is_led() -> None:
    assert lead_of(actuator(), LAW) == 0.0
    assert lead_of(actuator().with_effects({"viscous_friction": {"coefficient": 0.1}}), LAW) == 0.0


def test_the_lead_is_the_lag_and_half_of_the_friction_terms_turn() -> None:
    """The term turns from -c 2 T_p r_M tanh x to +c 2 T_p r_M tanh x at the slew limit."""
    model = actuator()
    friction = 2.0 * model.pretension * model.motor_pulley_radius * math.tanh(model.friction_angle)
    lead = lead_of(model.with_effects({"velocity_lag": {"time_constant": 0.003}}), LAW)
    assert lead == pytest.approx(0.003 + 0.9 * friction / 100.0)


def test_a_velocity_that_is_too_late_is_not_guessed() -> None:
    assert lead_of(actuator().with_effects({"velocity_lag": {"time_constant": 0.5}}), LAW) == MOST_LEAD
