"""(3.55), its inverse, the four tensions and the full model (3.53)-(3.54) against their closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.model import curvature, transmission
from tsa_ctrl.model.functions import ARRAYS, SCALARS, Array

R_M, R_J, T_P = 0.020, 0.025, 45.0
torques = st.floats(-5.0, 5.0)
angles = st.floats(-2.0, 2.0)


@given(torques, angles)
def test_inverse_delivers_the_wanted_torque(tau_j: float, x: float) -> None:
    """(3.55) of its inverse is the identity."""
    tau_m = transmission.motor_torque(tau_j, x, T_P, R_M, R_J)
    assert transmission.joint_torque(tau_m, x, T_P, R_M, R_J) == pytest.approx(tau_j, abs=1e-12)


@given(torques, angles)
def test_four_tensions_give_the_simplified_model(tau_m: float, x: float) -> None:
    """(3.37), (3.45) and (3.46) together are (3.55)."""
    t1, t3 = transmission.motor_tensions(tau_m, T_P, R_M)
    found = transmission.tensions(SCALARS, t1, t3, x, x)
    tau_j = transmission.torque_between(found.t2, found.t4, R_J)
    assert tau_j == pytest.approx(transmission.joint_torque(tau_m, x, T_P, R_M, R_J), abs=1e-11)


@given(torques, angles)
def test_tensions_keep_pretension_and_torque(tau_m: float, x: float) -> None:
    """(3.40): (T1 + T3)/2 = T_p; (3.45): r_M (T3 - T1) = tau_M."""
    t1, t3 = transmission.motor_tensions(tau_m, T_P, R_M)
    assert (t1 + t3) / 2.0 == pytest.approx(T_P, abs=1e-12)
    assert R_M * (t3 - t1) == pytest.approx(tau_m, abs=1e-12)


def full(profile: curvature.Curvature, tau_m: float, sigma: float, mu: float) -> tuple[float, float]:
    """(tau_J, T_p) by the full model with alpha and beta from quadrature."""
    found = profile.elongation(sigma * mu)
    strain_force = T_P * profile.length  # EA Delta l
    x = sigma * mu * found.bending_angle
    line = transmission.full_model(SCALARS, x, found.alpha, found.beta, strain_force, R_M, R_J)
    return line.gain * tau_m - line.loss, line.level + line.coupling * tau_m


@pytest.mark.parametrize("sigma", [-1.0, 1.0])
@pytest.mark.parametrize("tau_m", [-1.0, 0.0, 1.5])
class TestFullModel:
    """The four profiles that have closed forms, at mu = 0.1, Theta = 2.6 rad."""

    X = 0.26

    def test_motor_end(self, sigma: float, tau_m: float) -> None:
        """tau_J = r_J (tau_M/(r_M cosh x) - 2 T_p0 tanh x)."""
        x = sigma * self.X
        expected = R_J * (tau_m / (R_M * math.cosh(x)) - 2.0 * T_P * math.tanh(x))
        found, _ = full(curvature.motor_end(1.2, 2.6), tau_m, sigma, 0.1)
        assert found == pytest.approx(expected, abs=1e-12)

    def test_uniform(self, sigma: float, tau_m: float) -> None:
        """tau_J = r_J (tau_M/r_M - 2 T_p0 x): slope 1, and x in place of sinh x."""
        expected = R_J * (tau_m / R_M - 2.0 * T_P * sigma * self.X)
        found, _ = full(curvature.uniform(1.2, 2.6), tau_m, sigma, 0.1)
        assert found == pytest.approx(expected, abs=1e-12)

    def test_joint_end(self, sigma: float, tau_m: float) -> None:
        """Exactly (3.55), with T_p = T_p0."""
        found, pretension = full(curvature.joint_end(1.2, 2.6), tau_m, sigma, 0.1)
        assert found == pytest.approx(transmission.joint_torque(tau_m, sigma * self.X, T_P, R_M, R_J), abs=1e-12)
        assert pretension == pytest.approx(T_P, rel=1e-14)

    def test_without_friction(self, sigma: float, tau_m: float) -> None:
        """mu = 0 is lossless."""
        assert full(curvature.uniform(1.2, 2.6), tau_m, sigma, 0.0)[0] == pytest.approx(R_J / R_M * tau_m, abs=1e-12)

    def test_elongations_satisfy_the_path(self, sigma: float, tau_m: float) -> None:
        """(3.41): delta_a + delta_b = 2 Delta l with T1 and T3 at the pretension of (3.54)."""
        profile = curvature.Curvature(1.2, kappa=lambda s: 1.0 + 2.0 * s)
        found = profile.elongation(sigma * 0.1)
        _, pretension = full(profile, tau_m, sigma, 0.1)
        t1, t3 = transmission.motor_tensions(tau_m, pretension, R_M)
        assert t1 * found.alpha + t3 * found.beta == pytest.approx(2.0 * T_P * 1.2, rel=1e-13)


def test_soft_series_element_leads_back_to_the_simplified_model() -> None:
    """EA/k_s much longer than the tendon holds the pretension, which is what (3.55) assumes."""
    length, series = 1.2, 1.2e9
    x = np.asarray(0.5)
    alpha, beta = (value * length + series for value in curvature.uniform_elongation(ARRAYS, x))
    line = transmission.full_model(ARRAYS, x, alpha, beta, np.asarray(T_P * (length + series)), R_M, R_J)
    assert float(line.gain) == pytest.approx(R_J / R_M * math.cosh(0.5), rel=1e-8)
    assert float(line.loss) == pytest.approx(2.0 * T_P * R_J * math.sinh(0.5), rel=1e-8)


def test_arrays_and_floats_agree() -> None:
    """The same formulas for a log and for one instant."""
    x: Array = np.array([-0.3, 0.1])
    by_array = transmission.tensions(ARRAYS, np.array([40.0, 41.0]), np.array([50.0, 49.0]), x, x)
    by_float = transmission.tensions(SCALARS, 41.0, 49.0, 0.1, 0.1)
    assert by_float == pytest.approx([float(column[1]) for column in by_array], rel=1e-15)
