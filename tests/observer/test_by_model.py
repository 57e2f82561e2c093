"""Joint torque from motor torque and model alone, compared with an independent evaluation of (3.55)."""

from __future__ import annotations

import math

import pytest

from tests.control.sliding import PERIOD, R_J, R_M, actuator
from tsa_ctrl.observer.joint_torque import STILL, ModelTorque

X, TENSION = 0.26, 45.0


def delivered(tau_m: float, sigma: float) -> float:
    return R_J * (tau_m / R_M * math.cosh(X) - sigma * 2.0 * TENSION * math.sinh(X))


@pytest.mark.parametrize("sigma", [-1.0, 1.0])
def test_sliding_it_is_the_models_line(sigma: float) -> None:
    seen = ModelTorque(actuator(), PERIOD, 0.0)
    seen.update(0.4, 0.0, sigma * 2.0 * STILL)
    assert seen.torque == pytest.approx(delivered(0.4, sigma))
    half = math.hypot(0.25, 0.25) * 2.0 * R_J * TENSION * math.sinh(X)
    assert (seen.high - seen.low) / 2.0 == pytest.approx(half)


def test_standing_it_is_the_frictions_band() -> None:
    """At standstill the band contains the lines of both directions. The estimate is their mean."""
    seen = ModelTorque(actuator(), PERIOD, 0.0)
    seen.update(0.4, 0.0, 0.5 * STILL)
    assert seen.torque == pytest.approx(0.5 * (delivered(0.4, 1.0) + delivered(0.4, -1.0)))
    assert seen.low < delivered(0.4, 1.0) < delivered(0.4, -1.0) < seen.high


def test_the_motors_own_acceleration_is_taken_off() -> None:
    seen = ModelTorque(actuator(), PERIOD, motor_inertia=1e-4)
    seen.update(0.4, 0.0, 1.0)
    seen.update(0.4, 1.0, 1.0)  # 1000 rad/s^2
    assert seen.torque == pytest.approx(delivered(0.3, 1.0))


def test_stale_values_are_not_taken() -> None:
    seen = ModelTorque(actuator(), PERIOD, 0.0)
    seen.update(0.4, 0.0, 1.0)
    before = seen.torque
    seen.update(9.0, 0.0, 1.0, fresh=False)
    seen.update(math.nan, 0.0, 1.0)
    assert seen.torque == before


def test_parameters_follow_the_estimate() -> None:
    seen = ModelTorque(actuator(), PERIOD, 0.0)
    seen.set_parameters(X, 0.0)
    seen.update(0.4, 0.0, 1.0)
    assert seen.torque == pytest.approx(R_J * 0.4 / R_M * math.cosh(X))
