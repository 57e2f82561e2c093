"""Curvature profiles: alpha and beta by closed forms and by integration, the centre, and invalid profiles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.model.capstan import Pair
from tsa_ctrl.model.curvature import NAMED, Points, Profile, as_points
from tsa_ctrl.model.functions import ARRAYS, SCALARS

S_BENT: Points = ((0.0, 0.1), (0.3, 0.4), (0.3, 0.5), (0.7, 0.5), (1.0, 1.0))


def alpha_and_beta(profile: str | Points, x: float) -> tuple[float, float]:
    """Return alpha and beta over l_us at the signed friction angle x."""
    chosen = Profile.of(profile)
    return chosen.mean_exponential(SCALARS, x), chosen.mean_exponential(SCALARS, -x)


@pytest.mark.parametrize(("mu", "total", "difference"), [(0.05, 2.00617, 0.15724), (0.01, 2.00025, 0.03142)])
def test_motor_end_extreme_of_the_figure(mu: float, total: float, difference: float) -> None:
    """For Theta = pi/2 at the motor end, alpha + beta and abs(alpha - beta) have the printed values."""
    alpha, beta = alpha_and_beta("motor_end", mu * math.pi / 2)
    assert round(alpha + beta, 5) == total
    assert round(abs(alpha - beta), 5) == difference


@pytest.mark.parametrize("x", [-0.26, 0.26])
def test_uniform_curvature(x: float) -> None:
    """alpha and beta are (exp(x) - 1)/x and (1 - exp(-x))/x."""
    assert alpha_and_beta("uniform", x) == pytest.approx((math.expm1(x) / x, -math.expm1(-x) / x), rel=1e-15)


def test_joint_end_curvature_leaves_the_length() -> None:
    """With all curvature at the joint end, the tendon has no friction before the end: alpha = beta = l_us."""
    assert alpha_and_beta("joint_end", 0.6) == (1.0, 1.0)


@pytest.mark.parametrize("profile", [*NAMED, S_BENT])
def test_without_friction_alpha_and_beta_are_the_length(profile: str | Points) -> None:
    """It holds at mu = 0 for any profile."""
    assert alpha_and_beta(profile, 0.0) == pytest.approx((1.0, 1.0), rel=1e-15)


def test_straight_bent_straight() -> None:
    """The bent middle has the uniform form, and the remaining integrand is constant."""
    x = 0.3
    alpha, _ = alpha_and_beta(((0.0, 0.0), (1.0 / 3.0, 0.0), (2.0 / 3.0, 1.0), (1.0, 1.0)), x)
    assert 3.0 * alpha == pytest.approx(1.0 + math.expm1(x) / x + math.exp(x), rel=1e-14)


@pytest.mark.parametrize("x", [-1.0, -0.26, 0.26, 1.0])
@pytest.mark.parametrize("profile", [*NAMED, S_BENT])
def test_alpha_and_beta_are_the_integrals(profile: str | Points, x: float) -> None:
    """The reference of (3.36) and (3.39) is the capstan equation, integrated step by step along the tendon."""
    pair = Pair(Profile.of(profile).points, 0.0, axial_stiffness=1.0, length=1.0)
    assert alpha_and_beta(profile, x) == pytest.approx((pair.along(x)[1], pair.along(-x)[1]), rel=1e-10)


def test_curve_by_points_comes_near_a_formula() -> None:
    """For kappa = 2 s on unit length, Theta(s) = s^2.

    The reference of alpha, the integral of exp(x s^2), is its series.
    """
    x = 0.4
    series = sum(x**n / math.factorial(n) / (2 * n + 1) for n in range(30))
    points = tuple((k / 200, (k / 200) ** 2) for k in range(201))
    assert alpha_and_beta(points, x)[0] == pytest.approx(series, rel=1e-5)


@pytest.mark.parametrize("x", [-1.0, -1e-9, 0.0, 1e-9, 0.26])
def test_floats_and_arrays_agree(x: float) -> None:
    """One formula serves scalars and arrays, including the limit x = 0."""
    for profile in (*NAMED, S_BENT):
        by_array = Profile.of(profile).mean_exponential(ARRAYS, np.array([x, x]))
        assert by_array.shape == (2,)
        assert alpha_and_beta(profile, x)[0] == pytest.approx(float(by_array[1]), rel=1e-15)


@pytest.mark.parametrize(("profile", "centre"), [("motor_end", 0.0), ("uniform", 0.5), ("joint_end", 1.0)])
def test_centre_of_the_named_profiles(profile: str, centre: float) -> None:
    """The reference is the known s_c of each profile."""
    assert Profile.of(profile).centre == pytest.approx(centre)


def test_centre_is_the_mean_place_of_the_bends() -> None:
    """A tenth of the wrap angle is at 0, 0.3 of it around 0.15, a tenth at 0.3, and half around 0.85."""
    assert Profile.of(S_BENT).centre == pytest.approx(0.1 * 0.0 + 0.3 * 0.15 + 0.1 * 0.3 + 0.5 * 0.85)


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), max_size=6))
def test_any_rising_points_are_a_profile(inner: list[tuple[float, float]]) -> None:
    """Any sorted points between the ends are valid, and the centre lies on the sheath."""
    lengths, shares = sorted(u for u, _ in inner), sorted(b for _, b in inner)
    points = as_points([[0.0, 0.0], *map(list, zip(lengths, shares, strict=True)), [1.0, 1.0]])
    assert points is not None
    assert -1e-12 <= Profile(points).centre <= 1.0 + 1e-12


@pytest.mark.parametrize(
    "value",
    [
        "flat",
        [],
        [[1.0, 1.0]],
        [[0.0, 0.0], [0.5, 0.9]],
        [[0.1, 0.0], [1.0, 1.0]],
        [[0.0, -0.1], [1.0, 1.0]],
        [[0.0, 0.0], [0.6, 0.5], [0.5, 0.6], [1.0, 1.0]],
        [[0.0, 0.0], [0.5, 0.6], [0.6, 0.5], [1.0, 1.0]],
        [[0.0, 0.0], [math.nan, 0.5], [1.0, 1.0]],
        [[0.0, 0.0, 0.0], [1.0, 1.0]],
        [0.0, 1.0],
        [[0.0, "0"], [1.0, 1.0]],
        [[False, 0.0], [1.0, True]],
        3.0,
        None,
    ],
)
def test_what_is_no_profile(value: object) -> None:
    """There are too few points, falling points, wrong ends or values that are not numbers."""
    assert as_points(value) is None
