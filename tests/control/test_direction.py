"""Direction of sliding: continuous, saturating, quiet at standstill."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.control.direction import Direction, DirectionSettings

SETTINGS = DirectionSettings(zone=0.05, hysteresis=0.01, release=0.2)
PERIOD = 1e-3


@pytest.fixture
def direction() -> Direction:
    return Direction(SETTINGS, PERIOD)


@pytest.mark.parametrize("omega", [0.05, 0.051, 1.0, math.inf])
def test_is_one_from_the_zone_on(direction: Direction, omega: float) -> None:
    """At +-zone and beyond sigma is exactly +-1."""
    assert direction.update(omega) == pytest.approx(1.0)
    assert direction.update(-omega) == pytest.approx(-1.0)


def test_noise_within_the_hysteresis_moves_nothing(direction: Direction) -> None:
    """At standstill noise smaller than the hysteresis leaves sigma at exactly 0."""
    noise = np.random.default_rng(1).uniform(-0.0099, 0.0099, 5000)
    assert {direction.update(float(omega)) for omega in noise} == {0.0}


def test_noise_during_slow_motion_is_smaller_in_sigma(direction: Direction) -> None:
    """Inside the linear zone, noise of less than the hysteresis settles to a constant sigma."""
    noise = np.random.default_rng(2).uniform(-0.009, 0.009, 5000)
    sigmas = [direction.update(0.03 + float(n)) for n in noise]
    assert np.ptp(sigmas[2500:]) < 0.02


def test_stop_releases_to_zero(direction: Direction) -> None:
    """After motion, sigma leaves for 0 within some release times."""
    direction.update(1.0)
    sigmas = [direction.update(0.0) for _ in range(4000)]
    assert sigmas[-1] == 0.0
    assert sigmas == sorted(sigmas, reverse=True)


def test_missing_velocity_counts_as_standstill(direction: Direction) -> None:
    """nan neither raises nor sticks in sigma."""
    direction.update(1.0)
    for _ in range(4000):
        direction.update(math.nan)
    assert direction.sigma == 0.0
    assert direction.update(1.0) == 1.0


@given(st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=50))
def test_stays_in_range_and_is_no_steeper_than_its_gain(velocities: list[float]) -> None:
    """|sigma| <= 1, and a change of velocity changes sigma by at most the gain plus the leak."""
    direction = Direction(SETTINGS, PERIOD)
    gain = 1.0 / (SETTINGS.zone - SETTINGS.hysteresis)
    before, sigma_before = velocities[0], direction.update(velocities[0])
    for omega in velocities[1:]:
        sigma = direction.update(omega)
        assert -1.0 <= sigma <= 1.0
        assert abs(sigma - sigma_before) <= abs(omega - before) * gain + 2.0 * PERIOD / SETTINGS.release + 1e-6
        before, sigma_before = omega, sigma


def test_is_odd(direction: Direction) -> None:
    """The mirrored motion gives the mirrored direction."""
    mirrored = Direction(SETTINGS, PERIOD)
    for omega in np.random.default_rng(3).normal(0.0, 0.05, 500):
        assert direction.update(float(omega)) == -mirrored.update(-float(omega))


def test_zone_moves_with_its_hysteresis(direction: Direction) -> None:
    """A wider zone set while running keeps the shape: 1 at the zone, quiet within the scaled hysteresis."""
    direction.zone = 0.1
    assert direction.update(0.019) == 0.0
    assert direction.update(0.099) < 1.0
    assert direction.update(0.1) == pytest.approx(1.0)


@pytest.mark.parametrize(("zone", "hysteresis"), [(0.05, 0.05), (0.05, 0.026)])
def test_refuses_a_hysteresis_that_fills_the_zone(zone: float, hysteresis: float) -> None:
    """More than half of the zone leaves no linear part."""
    with pytest.raises(ValueError, match="at most half of the zone"):
        DirectionSettings(zone=zone, hysteresis=hysteresis)


class TestLead:
    """A velocity that is known to be late is taken ahead of its reversals, and only of those."""

    LEAD = 7e-3  # s

    def crossings(self, lead: float) -> list[float]:
        """Times (s) at which sigma changes its sign while the joint swings at 1 Hz and up to 3 rad/s."""
        direction = Direction(SETTINGS, PERIOD, lead)
        t = np.arange(0.0, 4.0, PERIOD)
        sigma = np.array([direction.update(3.0 * math.cos(2.0 * math.pi * s)) for s in t])
        return [float(t[i]) for i in np.flatnonzero(np.diff(np.sign(sigma)))]

    def test_reversals_come_earlier_by_the_lead(self) -> None:
        """To a millisecond, at each of them."""
        shifts = np.subtract(self.crossings(0.0), self.crossings(self.LEAD))
        assert shifts.size == 8
        np.testing.assert_allclose(shifts, self.LEAD, atol=PERIOD * 1.01)

    def test_at_standstill_noise_moves_nothing(self) -> None:
        """The derivative of noise is no direction."""
        direction = Direction(SETTINGS, PERIOD, self.LEAD)
        noise = np.random.default_rng(1).uniform(-0.0099, 0.0099, 5000)
        assert {direction.update(float(omega)) for omega in noise} == {0.0}

    def test_trembling_is_not_led(self) -> None:
        """Up to 4 zones nothing differs from a direction without a lead."""
        plain, led = Direction(SETTINGS, PERIOD), Direction(SETTINGS, PERIOD, self.LEAD)
        for n in range(2000):
            omega = 3.9 * SETTINGS.zone * math.sin(2.0 * math.pi * 12.0 * n * PERIOD)
            assert led.update(omega) == plain.update(omega)

    def test_a_stop_releases_to_zero(self) -> None:
        """After fast motion, braked within 50 ms, sigma leaves for 0 and stays."""
        direction = Direction(SETTINGS, PERIOD, self.LEAD)
        for n in range(3000):
            direction.update(3.0 * max(0.0, 1.0 - n * PERIOD / 0.05))
        assert direction.sigma == 0.0

    def test_a_missing_velocity_counts_as_standstill(self) -> None:
        """nan neither raises nor leaves a derivative behind."""
        direction = Direction(SETTINGS, PERIOD, self.LEAD)
        for omega in (1.0, 0.5, math.nan, math.nan):
            direction.update(omega)
        for _ in range(4000):
            direction.update(math.nan)
        assert direction.sigma == 0.0
        assert direction.update(1.0) == 1.0
