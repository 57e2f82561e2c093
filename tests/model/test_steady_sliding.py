"""The sliding transmission as a line, compared with the capstan equation integrated along the tendons."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from tests.model.actuator import ACTUATOR, with_effect
from tests.model.capstan import Pair
from tests.model.test_curvature import S_BENT
from tsa_ctrl.model.curvature import NAMED, Points, Profile
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals
from tsa_ctrl.model.steady_sliding import (
    bending_centre,
    joint_side_compliance,
    motor_stiffness,
    pretension_level,
    sliding,
    transmitted_by,
)

X, T_P, R_M, R_J = 0.26, 45.0, 0.020, 0.025
PROFILES: tuple[str | Points, ...] = (*NAMED, S_BENT)
SERIES = 2e4  # N/m
SPRINGS: dict[str, dict[str, Any]] = {
    "none": {},
    "motor": {"series_stiffness": SERIES},
    "joint": {"series_stiffness": SERIES, "series_at_joint": True},
}


def model_of(profile: str | Points, spring: str = "none") -> TendonSheath:
    bent = ACTUATOR.with_effects({"elongation_coupling": {"curvature_profile": profile}})
    return dataclasses.replace(bent, **SPRINGS[spring])


def pair_of(profile: str | Points, spring: str = "none", x: float = X) -> Pair:
    motor, joint = (1.0 / SERIES if spring == side else 0.0 for side in ("motor", "joint"))
    return Pair(Profile.of(profile).points, x, motor_spring=motor, joint_spring=joint)


@pytest.mark.parametrize("spring", SPRINGS)
@pytest.mark.parametrize("profile", PROFILES, ids=str)
class TestAgainstIntegration:
    """Any curvature profile, with and without a series spring at either end."""

    @pytest.mark.parametrize("sigma", [-1.0, 1.0])
    def test_line(self, profile: str | Points, spring: str, sigma: float) -> None:
        """The line is tau_J = a tau_M - sigma b."""
        line = sliding(model_of(profile, spring), sigma)
        for tau_m in (-1.0, 0.0, 1.5):
            expected = pair_of(profile, spring).joint_torque(tau_m, sigma)
            assert line.slope * tau_m - sigma * line.half_loop == pytest.approx(expected, abs=1e-10)

    def test_prediction_and_inverse(self, profile: str | Points, spring: str) -> None:
        """The simulation of a log gives this line, and the live inverse inverts it."""
        model, pair = model_of(profile, spring), pair_of(profile, spring)
        tau_m, omega = np.array([-1.0, 0.3, 1.2]), np.array([0.5, -0.5, 0.5])
        expected = [pair.joint_torque(tau, sigma) for tau, sigma in zip(tau_m, np.sign(omega), strict=True)]
        np.testing.assert_allclose(
            predict(model, Signals(t=np.arange(3.0), tau_m=tau_m, omega_j=omega)), expected, rtol=0.0, atol=1e-10
        )
        inverse = Feedforward(model, 1e-3)
        found = [inverse.update(tau, math.copysign(1.0, v), v) for tau, v in zip(expected, omega, strict=True)]
        np.testing.assert_allclose(found, tau_m, rtol=0.0, atol=1e-10)

    def test_transmitted_torque(self, profile: str | Points, spring: str) -> None:
        """The same torque is obtained for a single instant."""
        transmitted = transmitted_by(model_of(profile, spring))
        pair = pair_of(profile, spring)
        for tau_m in (-1.0, 0.4):
            expected = (pair.joint_torque(tau_m, 1.0), pair.joint_torque(tau_m, -1.0))
            assert transmitted(tau_m, X, T_P) == pytest.approx(expected, abs=1e-10)

    def test_half_loop_at_the_motor(self, profile: str | Points, spring: str) -> None:
        """h is the motor torque at which the joint torque is 0."""
        h = sliding(model_of(profile, spring)).motor_half_loop
        assert pair_of(profile, spring).joint_torque(h, 1.0) == pytest.approx(0.0, abs=1e-10)

    def test_pretension_while_sliding(self, profile: str | Points, spring: str) -> None:
        """The level is (T1 + T3)/2 without motor torque, divided by T_p0."""
        t1, t3 = pair_of(profile, spring).motor_tensions(0.0, 1.0)
        assert pretension_level(model_of(profile, spring)) == pytest.approx(0.5 * (t1 + t3) / T_P, rel=1e-10)

    def test_domain_ends_where_a_tendon_is_slack(self, profile: str | Points, spring: str) -> None:
        """At the largest command, one motor-side tension is 0."""
        tau_m = Feedforward(model_of(profile, spring), 1e-3).update(50.0, 1.0, 0.5)
        assert min(pair_of(profile, spring).motor_tensions(tau_m, 1.0)) == pytest.approx(0.0, abs=1e-8)


def test_simplified_model_is_all_bending_at_the_joint() -> None:
    """(3.55) has the slope r_J/r_M cosh x, the friction torque 2 T_p r_J sinh x and the centre at the joint."""
    assert sliding(ACTUATOR) == pytest.approx((R_J / R_M * math.cosh(X), 2.0 * T_P * R_J * math.sinh(X)), rel=1e-14)
    assert sliding(ACTUATOR).motor_half_loop == pytest.approx(2.0 * T_P * R_M * math.tanh(X), rel=1e-14)
    assert bending_centre(ACTUATOR) == 1.0


@pytest.mark.parametrize("sigma", [-1.0, 1.0])
def test_asymmetric_sheaths_differ_by_direction(sigma: float) -> None:
    """The line is exp(sigma k x/2) times (3.55)."""
    factor = math.exp(sigma * 0.3 * X / 2.0)
    found = sliding(with_effect("sheath_asymmetry", relative_difference=0.3), sigma)
    assert found == pytest.approx([factor * value for value in sliding(ACTUATOR, sigma)], rel=1e-13)


def test_tension_dependence_gives_its_tangent() -> None:
    """The tangent has value and slope of the prediction at tau_M = 0."""
    model = with_effect("tension_dependent_friction", exponent=0.3)
    tau_m = np.array([-1e-4, 0.0, 1e-4])
    below, at, above = predict(model, Signals(t=np.arange(3.0), tau_m=tau_m, omega_j=np.ones(3)))
    found = sliding(model)
    assert found.half_loop == pytest.approx(-at, rel=1e-12)
    assert found.slope == pytest.approx((above - below) / 2e-4, rel=1e-6)


def test_angle_and_pretension_may_be_given() -> None:
    """An estimator can replace the file's values."""
    assert sliding(ACTUATOR, 1.0, 0.5, 30.0) == pytest.approx(sliding(ACTUATOR.recalibrated(0.5, 30.0)), rel=1e-14)


@pytest.mark.parametrize("spring", SPRINGS)
def test_stiffness_at_the_motor(spring: str) -> None:
    """The motor turns by 1 mrad with a locked joint and no friction. The elongation of each tendon gives the torque."""
    pair = pair_of("uniform", spring, x=0.0)
    per_newton = pair.along(0.0)[1]  # m/N
    torque = 2.0 * R_M * (R_M * 1e-3 / per_newton)
    assert motor_stiffness(model_of("uniform", spring)) == pytest.approx(torque / 1e-3, rel=1e-10)


@pytest.mark.parametrize(
    ("profile", "spring", "expected"),
    [
        ("uniform", "none", 1e-5),
        ("uniform", "motor", 1e-5),
        ("motor_end", "none", 2e-5),
        ("motor_end", "joint", 7e-5),
        ("joint_end", "joint", 5e-5),
    ],
)
def test_compliance_between_bends_and_joint(profile: str, spring: str, expected: float) -> None:
    """l/EA is 2e-5 m/N, and the spring has 5e-5 m/N."""
    assert joint_side_compliance(model_of(profile, spring)) == pytest.approx(expected, abs=1e-18)
