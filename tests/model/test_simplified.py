"""The short way for a model without effects gives what the long way gives."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.model.actuator import ACTUATOR
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.simplified import SimplifiedFeedforward


@given(st.floats(-5.0, 5.0), st.floats(-1.0, 1.0), st.floats(0.01, 1.0), st.floats(1.0, 100.0))
def test_agrees_with_the_composed_inverse(tau_j: float, sigma: float, x: float, pretension: float) -> None:
    """Same torque, same domain, for any wanted torque, direction, friction angle and pretension."""
    short, long = SimplifiedFeedforward(ACTUATOR), Feedforward(ACTUATOR, 1e-3)
    for inverse in (short, long):
        inverse.set(x, pretension)
    assert short.update(tau_j, sigma) == pytest.approx(long.update(tau_j, sigma, 0.0), rel=1e-12, abs=1e-12)
    assert short.domain_limit() == pytest.approx(long.domain_limit())


def test_does_not_hide_what_is_not_finite() -> None:
    """nan comes out as nan, for the limiter to refuse."""
    assert math.isnan(SimplifiedFeedforward(ACTUATOR).update(math.nan, 1.0))
