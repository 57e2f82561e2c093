"""Tensions at the motor, and the full model (3.53)-(3.54) compared with its closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.model.curvature import Points, Profile
from tsa_ctrl.model.effects.transmission import Elongating, FourTensions
from tsa_ctrl.model.functions import SCALARS

R_M, R_J, T_P = 0.020, 0.025, 45.0


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
