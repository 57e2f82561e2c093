"""alpha and beta: the closed forms are test points of the quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model import curvature
from tsa_ctrl.model.curvature import Curvature
from tsa_ctrl.model.functions import ARRAYS, SCALARS


@pytest.mark.parametrize(("mu", "total", "difference"), [(0.05, 2.00617, 0.15724), (0.01, 2.00025, 0.03142)])
def test_motor_end_extreme_of_the_figure(mu: float, total: float, difference: float) -> None:
    """All curvature at the motor end, Theta = pi/2: the printed values of alpha + beta and abs(alpha - beta)."""
    found = curvature.motor_end(1.0, math.pi / 2).elongation(mu)
    assert round(found.alpha + found.beta, 5) == total
    assert round(abs(found.alpha - found.beta), 5) == difference


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_uniform_curvature(direction: float) -> None:
    """(exp(x) - 1)/x and (1 - exp(-x))/x times the length."""
    length, theta, mu = 1.3, 2.6, 0.1
    x = direction * mu * theta
    found = curvature.uniform(length, theta).elongation(direction * mu)
    assert found.alpha == pytest.approx(length * math.expm1(x) / x, rel=1e-14)
    assert found.beta == pytest.approx(length * -math.expm1(-x) / x, rel=1e-14)
    assert found.bending_angle == pytest.approx(theta, rel=1e-14)


def test_joint_end_curvature_leaves_the_length() -> None:
    """With all curvature at the joint end nothing rubs before the end: alpha = beta = l_us."""
    found = curvature.joint_end(1.2, 2.0).elongation(0.3)
    assert (found.alpha, found.beta) == pytest.approx((1.2, 1.2), rel=1e-14)


def test_without_friction_alpha_and_beta_are_the_length() -> None:
    """mu = 0 for a curvature that varies along the sheath."""
    found = Curvature(1.2, kappa=lambda s: 3.0 + np.sin(4.0 * s)).elongation(0.0)
    assert (found.alpha, found.beta) == pytest.approx((1.2, 1.2), rel=1e-14)


def test_curvature_that_jumps() -> None:
    """Straight, bent, straight: the bent middle is the uniform form, the rest is constant."""
    theta, mu = 1.5, 0.2
    profile = Curvature(3.0, kappa=lambda s: np.where((s > 1.0) & (s < 2.0), theta, 0.0), breaks=(1.0, 2.0))
    x = mu * theta
    assert profile.elongation(mu).alpha == pytest.approx(1.0 + math.expm1(x) / x + math.exp(x), rel=1e-13)


def test_curvature_given_by_a_formula() -> None:
    """kappa = 2 s on unit length: Theta(s) = s^2, alpha = integral of exp(mu s^2), here by its series."""
    mu = 0.4
    series = sum(mu**n / math.factorial(n) / (2 * n + 1) for n in range(30))
    assert Curvature(1.0, kappa=lambda s: 2.0 * s).elongation(mu).alpha == pytest.approx(series, rel=1e-14)


@pytest.mark.parametrize("x", [-1.0, -1e-9, 0.0, 1e-9, 0.26])
def test_closed_forms_agree_for_floats_and_arrays(x: float) -> None:
    """One formula, two kinds of numbers, also where x vanishes."""
    for closed in (curvature.uniform_elongation, curvature.motor_end_elongation):
        assert closed(SCALARS, x) == pytest.approx([float(v) for v in closed(ARRAYS, np.asarray(x))], rel=1e-15)


def test_place_outside_the_sheath_is_refused() -> None:
    """A bend must lie on the sheath."""
    with pytest.raises(UsageError, match="outside the sheath"):
        Curvature(1.0, bends=((1.2, 0.5),))
