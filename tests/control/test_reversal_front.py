"""Compare the propagation of a reversal into the sheath with independent calculations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.control.sliding import actuator
from tsa_ctrl.control.reversal import ReversalFront, front_of
from tsa_ctrl.model.curvature import NAMED, Points
from tsa_ctrl.model.steady_sliding import joint_side_compliance

S_BENT: Points = ((0.0, 0.0), (0.2, 0.5), (0.7, 0.5), (1.0, 1.0))


@pytest.mark.parametrize("points", [*NAMED.values(), S_BENT], ids=str)
@pytest.mark.parametrize("p", [0.0, 0.2, 0.77])
def test_table_is_the_integral(points: Points, p: float) -> None:
    """The table of S(p) agrees with an integral by the midpoint rule on a fine grid."""
    u = (np.arange(200_000) + 0.5) / 200_000
    places, shares = np.array(points).T
    b = np.interp(u, places + 1e-9 * np.arange(places.size), shares)
    front = ReversalFront(points)
    expected = np.mean(np.maximum(0.0, p - b))
    assert np.interp(p, np.linspace(0.0, 1.0, len(front.table)), front.table) == pytest.approx(expected, abs=3e-4)


def test_named_shapes() -> None:
    """The centres of curvature of the profiles uniform, joint_end and motor_end are at 0.5, 1 and 0 of the length."""
    uniform, joint, motor = (ReversalFront(NAMED[name]) for name in ("uniform", "joint_end", "motor_end"))
    assert (uniform.centre, joint.centre, motor.centre) == pytest.approx((0.5, 1.0, 0.0))
    assert sum(uniform.lengths(16)) == pytest.approx(1.0)
    assert (joint.lengths(16)[0], motor.lengths(16)[-1]) == pytest.approx((1.0, 1.0))


@pytest.mark.parametrize("at_joint", [False, True])
def test_a_series_spring_is_length_without_bends(at_joint: bool) -> None:
    """A series spring adds straight length on its side, so the centre is 1 minus the joint-side share of compliance."""
    model = dataclasses.replace(
        actuator().with_effects({"elongation_coupling": {"curvature_profile": S_BENT}}),
        series_stiffness=2e4,
        series_at_joint=at_joint,
    )
    beyond = joint_side_compliance(model) * model.tendon_stiffness
    assert front_of(model).centre == pytest.approx(1.0 - beyond)


def test_a_model_that_does_not_say_how_it_bends_is_evenly_bent() -> None:
    assert front_of(actuator()).centre == pytest.approx(0.5)
