"""Tensions at the motor, and the full model (3.53)-(3.54) compared with its closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.model.curvature import Points, Profile
from tsa_ctrl.model.effects import transmission
from tsa_ctrl.model.effects.transmission import Elongating, FourTensions
from tsa_ctrl.model.functions import ARRAYS, SCALARS

R_M, R_J, T_P = 0.020, 0.025, 45.0


@given(st.floats(-5.0, 5.0))
def test_tensions_keep_pretension_and_torque(tau_m: float) -> None:
    """By (3.40), (T1 + T3)/2 = T_p. By (3.45), r_M (T3 - T1) = tau_M."""
    t1, t3 = transmission.motor_tensions(tau_m, T_P, R_M)
    assert (t1 + t3) / 2.0 == pytest.approx(T_P, abs=1e-12)
    assert R_M * (t3 - t1) == pytest.approx(tau_m, abs=1e-12)


def full(chosen: str | Points, tau_m: float, x: float) -> tuple[float, float]:
    """Return (tau_J, T_p) by the full model at the signed friction angle x."""
    profile = Profile.of(chosen)
    alpha, beta = profile.mean_exponential(SCALARS, x), profile.mean_exponential(SCALARS, -x)
    line = transmission.full_model(SCALARS, (x, x), alpha, beta, T_P, R_M, R_J)
    return line.gain * tau_m - line.loss, line.level + line.coupling * tau_m


@pytest.mark.parametrize("sigma", [-1.0, 1.0])
@pytest.mark.parametrize("tau_m", [-1.0, 0.0, 1.5])
class TestFullModel:
    """Profiles with closed forms, at mu = 0.1 and Theta = 2.6 rad."""

    X = 0.26

    def test_motor_end(self, sigma: float, tau_m: float) -> None:
        """tau_J = r_J (tau_M/(r_M cosh x) - 2 T_p0 tanh x)."""
        x = sigma * self.X
        expected = R_J * (tau_m / (R_M * math.cosh(x)) - 2.0 * T_P * math.tanh(x))
        assert full("motor_end", tau_m, x)[0] == pytest.approx(expected, abs=1e-12)

    def test_uniform(self, sigma: float, tau_m: float) -> None:
        """tau_J = r_J (tau_M/r_M - 2 T_p0 x), with slope r_J/r_M and x in place of sinh x."""
        expected = R_J * (tau_m / R_M - 2.0 * T_P * sigma * self.X)
        assert full("uniform", tau_m, sigma * self.X)[0] == pytest.approx(expected, abs=1e-12)

    def test_joint_end(self, sigma: float, tau_m: float) -> None:
        """The result is exactly (3.55) with T_p = T_p0."""
        x = sigma * self.X
        found, pretension = full("joint_end", tau_m, x)
        expected = R_J * (tau_m / R_M * math.cosh(x) - 2.0 * T_P * math.sinh(x))
        assert found == pytest.approx(expected, abs=1e-12)
        assert pretension == pytest.approx(T_P, rel=1e-14)

    def test_without_friction(self, sigma: float, tau_m: float) -> None:
        """At mu = 0 the transmission has no losses."""
        assert full("uniform", tau_m, 0.0)[0] == pytest.approx(R_J / R_M * tau_m, abs=1e-12)


def test_arrays_and_floats_agree() -> None:
    """The same formulas serve a log and a single instant."""
    x, alpha, beta = np.array([-0.3, 0.1]), np.array([0.9, 1.1]), np.array([1.1, 0.9])
    by_array = transmission.full_model(ARRAYS, (x, x), alpha, beta, np.array(T_P), R_M, R_J)
    by_float = transmission.full_model(SCALARS, (0.1, 0.1), 1.1, 0.9, T_P, R_M, R_J)
    assert [float(np.broadcast_to(column, (2,))[1]) for column in by_array] == pytest.approx(by_float, rel=1e-15)


@pytest.mark.parametrize("course", ["uniform", "motor_end", [(0.0, 0.0), (0.3, 0.7), (1.0, 1.0)]])
@pytest.mark.parametrize("sigma", [-1.0, 1.0])
def test_tendons_of_different_friction_angles(course: str | Points, sigma: float) -> None:
    """The reference uses x_a = 0.36 and x_b = 0.16.

    The total length of both tendons equals its value at the pretension.
    """
    x, imbalance, tau_m = 0.26, 0.1 / 0.26, 0.7
    points = Profile.of(course).points
    found = Elongating((R_M, R_J), Profile.of(course)).torque(SCALARS, tau_m, sigma, x, T_P, imbalance)
    place = np.linspace(0.0, 1.0, 20001)
    bent = np.interp(place, [u for u, _ in points], [b + 1e-9 * k for k, (_, b) in enumerate(points)])
    if course == "motor_end":
        bent = np.ones_like(place)
    way_a, way_b = np.exp(sigma * 0.36 * bent), np.exp(-sigma * 0.16 * bent)
    alpha, beta = np.trapezoid(way_a, place), np.trapezoid(way_b, place)
    t1 = (2.0 * T_P - beta * tau_m / R_M) / (alpha + beta)  # T1 alpha + T3 beta = 2 T_p
    t3 = t1 + tau_m / R_M
    assert found == pytest.approx(R_J * (t3 * math.exp(-sigma * 0.16) - t1 * math.exp(sigma * 0.36)), rel=1e-5)


@given(st.floats(-0.9, 0.9), st.floats(-2.0, 2.0))
def test_the_inverse_knows_the_imbalance(imbalance: float, torque: float) -> None:
    for made in (Elongating((R_M, R_J), Profile.of("uniform")), FourTensions((R_M, R_J))):
        tau_m = made.motor_torque(torque, 1.0, 0.26, T_P, imbalance)
        assert made.torque(SCALARS, tau_m, 1.0, 0.26, T_P, imbalance) == pytest.approx(torque, abs=1e-12)
        slope, loss = made.tangent(1.0, 0.26, T_P, imbalance)
        assert slope * tau_m - loss == pytest.approx(torque, abs=1e-12)
