"""The chain of tendon contacts alone: it slides by the capstan equation and has return-point memory."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.control.sliding import actuator
from tests.model.capstan import Pair
from tsa_ctrl.model.curvature import NAMED
from tsa_ctrl.observer import tendons
from tsa_ctrl.observer.stretch import pairs_of

R_M, R_J, X, TENSION = 0.020, 0.025, 0.26, 45.0


def pair() -> np.ndarray:
    """Return two evenly bent tendons with EA = 60 kN at their pretension."""
    chain = pairs_of(dataclasses.replace(actuator(), axial_stiffness=60e3))[0].copy()
    tendons.grip(chain, X)
    return chain


def joint_torque(chain: np.ndarray) -> float:
    return float(R_J * (chain[1, tendons.TENSION, -1] - chain[0, tendons.TENSION, -1]))


@pytest.mark.parametrize("sigma", [-1.0, 1.0])
@pytest.mark.parametrize("tau_m", [-0.3, 0.0, 0.5])
def test_a_joint_that_is_moved_slides_by_the_capstan(sigma: float, tau_m: float) -> None:
    chain = pair()
    for _ in range(400):
        _, settled = tendons.move(chain, tau_m / R_M, sigma * 1e-5)
        assert settled
    truth = Pair(NAMED["uniform"], X, TENSION, R_M, R_J).joint_torque(tau_m, sigma)
    assert joint_torque(chain) == pytest.approx(truth, abs=2e-3)


def test_a_held_joint_feels_nothing_until_the_front_is_through() -> None:
    """The slip fronts start at the motor, so a small motor torque does not reach the joint.

    Once torque has reached the joint, a small reversal of the motor torque does not change it.
    """
    chain = pair()
    for tau in np.linspace(0.0, 0.2, 50):
        tendons.move(chain, tau / R_M, 0.0)
    assert joint_torque(chain) == pytest.approx(0.0, abs=1e-9)
    for tau in np.linspace(0.2, 0.8, 100):
        tendons.move(chain, tau / R_M, 0.0)
    reached = joint_torque(chain)
    assert reached > 0.4
    for tau in np.linspace(0.8, 0.6, 50):
        tendons.move(chain, tau / R_M, 0.0)
    assert joint_torque(chain) == pytest.approx(reached, abs=1e-9)


def test_a_partial_reversal_closes_its_loop() -> None:
    """Return-point memory: every tension returns to its value before the reversal when the motor torque does."""
    chain = pair()
    for tau in np.linspace(0.0, 0.8, 100):
        tendons.move(chain, tau / R_M, 0.0)
    before = chain[:, tendons.TENSION].copy()
    way = 0.0
    for tau in (*np.linspace(0.8, 0.55, 40), *np.linspace(0.55, 0.8, 40)):
        way += tendons.move(chain, tau / R_M, 0.0)[0]
    assert np.abs(chain[:, tendons.TENSION] - before).max() < 1e-6
    assert abs(way) < 1e-10


def test_one_step_or_many_end_alike() -> None:
    """A single step that passes all contacts gives the same joint torque as 200 small steps."""
    one, many = pair(), pair()
    for chain, steps in ((one, 1), (many, 200)):
        for target in (0.9, -0.4):
            start = R_M * (chain[1, tendons.TENSION, 0] - chain[0, tendons.TENSION, 0])
            for tau in np.linspace(start, target, steps + 1)[1:]:
                assert tendons.move(chain, tau / R_M, 0.0)[1]
    assert joint_torque(one) == pytest.approx(joint_torque(many), abs=1e-6)
