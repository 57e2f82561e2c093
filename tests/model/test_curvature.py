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
BENT_MIDDLE: Points = ((0.0, 0.0), (1.0 / 3.0, 0.0), (2.0 / 3.0, 1.0), (1.0, 1.0))


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


@pytest.mark.parametrize("x", [-1.0, -0.26, -1e-9, 0.0, 1e-9, 0.26, 1.0])
@pytest.mark.parametrize("profile", [*NAMED, S_BENT, BENT_MIDDLE])
def test_alpha_and_beta_are_the_integrals(profile: str | Points, x: float) -> None:
    """The reference of (3.36) and (3.39) is the capstan equation, integrated step by step along the tendon."""
    pair = Pair(Profile.of(profile).points, 0.0, axial_stiffness=1.0, length=1.0)
    assert alpha_and_beta(profile, x) == pytest.approx((pair.along(x)[1], pair.along(-x)[1]), rel=1e-10)


@pytest.mark.parametrize("x", [-1.0, -1e-9, 0.0, 1e-9, 0.26])
def test_floats_and_arrays_agree(x: float) -> None:
    """One formula serves scalars and arrays, including the limit x = 0."""
    for profile in (*NAMED, S_BENT):
        by_array = Profile.of(profile).mean_exponential(ARRAYS, np.array([x, x]))
        assert by_array.shape == (2,)
        assert alpha_and_beta(profile, x)[0] == pytest.approx(float(by_array[1]), rel=1e-15)


@pytest.mark.parametrize(
    ("profile", "centre"),
    [
        ("motor_end", 0.0),
        ("uniform", 0.5),
        ("joint_end", 1.0),
        (S_BENT, 0.1 * 0.0 + 0.3 * 0.15 + 0.1 * 0.3 + 0.5 * 0.85),  # share of the wrap angle times its middle
    ],
)
def test_centre_is_the_mean_place_of_the_bends(profile: str | Points, centre: float) -> None:
    assert Profile.of(profile).centre == pytest.approx(centre)


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
