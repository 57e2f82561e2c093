"""Motor and joint by the torque in use, on a spring with a friction play between them that the test makes itself."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from tsa_ctrl.safety.apart import Apart, Give

PERIOD = 1e-3  # s
STIFFNESS = 40.0  # N*m/rad
WOUND = 0.03  # rad
GIVE = Give(stiffness=STIFFNESS, wound=WOUND, domain=1.8, play=0.0)


class Tendons:
    """A joint that is led, a torque, and the motor between: tau/K, and friction that is dragged along by `share`."""

    def __init__(self, softer: float = 1.0, friction: float = 1.0, give: Give = GIVE) -> None:
        self.check = Apart(give, PERIOD)
        self._compliance = softer / STIFFNESS
        self._half = 0.5 * friction * softer * WOUND
        self._wound = 0.0
        self._last = (0.0, 0.0)  # of joint and motor, rad
        self.time = 0.0

    def step(self, joint: float, torque: float, shown: Callable[[float], float] = lambda joint: joint) -> float | None:
        """Friction follows the joint's way; `shown`: what the encoder makes of the joint's angle."""
        self.time += PERIOD
        self._wound = min(self._half, max(-self._half, self._wound + joint - self._last[0]))
        motor = joint + torque * self._compliance + self._wound
        speed = (motor - self._last[1]) / PERIOD
        self._last = (joint, motor)
        return self.check.update(torque, motor, speed, shown(joint))


def found(tendons: Tendons, seconds: float, joint: Callable[[float], float], torque: Callable[[float], float],
          shown: Callable[[float], float] = lambda joint: joint) -> float | None:  # fmt: skip
    """When something was, s from now."""
    start = tendons.time
    while tendons.time < start + seconds:
        t = tendons.time
        if tendons.step(joint(t), torque(t), shown) is not None:
            return tendons.time - start
    return None


def swing(t: float) -> float:
    """rad of a joint that is led"""
    return 0.6 * math.sin(3.0 * t)


def pull(t: float) -> float:
    """N*m"""
    return 1.5 * math.sin(7.0 * t)


@pytest.mark.parametrize("softer", [0.8, 1.0, 1.25])
@pytest.mark.parametrize("friction", [0.0, 0.5, 1.0, 1.25])
def test_stiffness_and_friction_may_be_a_fifth_off(softer: float, friction: float) -> None:
    tendons = Tendons(softer, friction)
    assert found(tendons, 6.0, swing, pull) is None
    assert found(tendons, 3.0, lambda t: swing(6.0), pull) is None  # held from then on, not a bit of it moves


def test_radii_that_are_a_hundredth_off_and_an_encoder_that_is_late_stop_nothing() -> None:
    tendons = Tendons()
    assert found(tendons, 6.0, swing, pull, lambda joint: 1.01 * joint + 0.004 * math.cos(50.0 * joint)) is None
    late = Tendons()
    before = [0.0]

    def old(joint: float) -> float:
        before.append(joint)
        return before[-2]

    assert found(late, 6.0, lambda t: 2.0 * math.sin(4.0 * t), pull, old) is None


def test_what_tendons_do_slowly_stops_nothing() -> None:
    """A joint encoder whose zero creeps by 0.4 rad in two minutes."""
    tendons = Tendons()
    assert found(tendons, 120.0, swing, pull, lambda joint: joint + 0.4 * tendons.time / 120.0) is None


def test_a_step_of_a_motor_that_rings_on_its_tendons_stops_nothing() -> None:
    """2 N*m at once on a joint that is held, 40 Hz undamped: it goes to twice the stretch and back."""
    check = Apart(GIVE, PERIOD)
    for n in range(500):
        t = n * PERIOD
        angle = 2.0 / STIFFNESS * (1.0 - math.cos(2.0 * math.pi * 40.0 * t))
        speed = 2.0 / STIFFNESS * 2.0 * math.pi * 40.0 * math.sin(2.0 * math.pi * 40.0 * t)
        assert check.update(2.0 if n else 0.0, angle, speed, 0.3) is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_encoder_that_sticks_is_found_within_the_stretch_of_the_torque(sign: float) -> None:
    """At 2 rad/s and 0.1 N*m: 20 mrad and what the torque changed by, not ten times as much."""
    tendons = Tendons()
    assert found(tendons, 1.0, lambda t: 2.0 * sign * t, lambda t: 0.1) is None
    stuck = 2.0 * sign * 1.0
    when = found(tendons, 1.0, lambda t: 2.0 * sign * t, lambda t: 0.1, lambda joint: stuck)
    assert when is not None
    assert 0.01 < when < 0.03


def test_an_encoder_that_slips_by_half_is_found_by_what_friction_winds_up() -> None:
    """At 2 rad/s: 30 mrad of friction, 20 of play, 10 of doubt, seen at half the speed."""
    tendons = Tendons()
    assert found(tendons, 0.5, lambda t: 2.0 * t, lambda t: 0.4) is None
    when = found(tendons, 1.0, lambda t: 2.0 * t, lambda t: 0.4, lambda joint: 1.0 + 0.5 * (joint - 1.0))
    assert when is not None
    assert 0.02 < when < 0.11


def test_a_tendon_that_gives_way_is_found() -> None:
    """Motor and joint are 0.1 rad farther apart from one moment on."""
    tendons = Tendons()
    assert found(tendons, 2.0, swing, pull) is None
    when = found(tendons, 0.2, swing, pull, lambda joint: joint - 0.1)
    assert when is not None
    assert when < 0.03


def test_beyond_the_domain_one_tendon_gives_twice_as_much() -> None:
    """0.9 N*m with a pretension that is half of the file's: the rest at half the stiffness."""
    low = Give(stiffness=STIFFNESS, wound=0.0, domain=0.5, play=0.0)
    for domain, most in ((0.5, None), (5.0, 1.0)):
        check = Apart(Give(low.stiffness, low.wound, domain, low.play), PERIOD)
        said = None
        for n in range(1000):
            torque = 3.0 * min(1.0, n / 500)
            alone = max(0.0, torque - 0.5)
            said = said or check.update(torque, (torque + alone) / STIFFNESS, 0.0, 1e-5 * n)
        assert (said is None) is (most is None), domain


def test_a_reset_forgets_where_they_were() -> None:
    check = Apart(GIVE, PERIOD)
    for place in (0.0, 30.0, -2.0):
        check.reset()
        assert [check.update(0.0, place, 0.0, 0.0) for _ in range(50)] == [None] * 50
    check.reset()
    assert [check.update(0.0, 0.0, 0.0, 30.0) for _ in range(50)] == [None] * 50


WHOLE = Give(stiffness=STIFFNESS, wound=WOUND, domain=1.8, play=0.01)
WAY = 0.03 * 1.25 + 0.01 + 0.02  # rad: wound up and its doubt, counts, pulleys


def settled(check: Apart, torque: float, angle: float, speed: float, joint: float) -> float | None:
    """What it says after a second of the same."""
    said = None
    for _ in range(1000):
        said = check.update(torque, angle, speed, joint)
    return said


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(
    ("before", "after", "beyond"),
    [
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, -1.0), 1.0 - WAY),
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 5.0, -1.0), 1.0 - WAY - 0.01),  # 2 ms of 5 rad/s
        ((0.0, 2.0, 0.0, 2.0), (0.0, 3.0, 0.0, 2.0), 1.0 - WAY - 0.02),  # 2 % of 1 rad since the enable
        ((0.0, 0.0, 0.0, 0.0), (-2.2, 0.0, 0.0, -1.0), 1.055 - WAY - 0.01375 - 0.01),  # a quarter of 2.2 and 0.4 N*m
        ((-2.2, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, -1.0), 0.945 - WAY - 0.01375 - 0.01),
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.05, 0.0, 0.0), 0.05 - 0.03),  # the encoder does not move
        ((0.5, 0.0, 0.0, 0.0), (-0.3, -0.06, 0.0, 0.0), 0.06 - 0.025 - 0.03),  # by 0.8 N*m and a quarter of it
        ((0.4, 0.0, 0.0, 0.0), (2.2, 0.10, 0.0, 0.0), 0.10 - 0.06625 - 0.03),  # of them 0.4 with one tendon
    ],
)  # fmt: skip
def test_by_how_much_they_are_apart_beyond_what_may_be(
    before: tuple[float, ...], after: tuple[float, ...], beyond: float, way: float
) -> None:
    """N*m, rad, rad/s, rad, once all of it rests; what was seen creeps by no more than 0.1 mrad in that time."""
    check = Apart(WHOLE, PERIOD)
    first, second = ([way * value for value in values] for values in (before, after))
    assert settled(check, *first) is None  # type: ignore[call-arg]
    assert settled(check, *second) == pytest.approx(beyond, abs=1e-4)  # type: ignore[call-arg]


def test_in_which_cycle_it_is_told_and_by_how_much() -> None:
    """A jump of 70 mrad through a low-pass of 10 ms; what was seen creeps by a fifth of the way in a second."""
    check = Apart(WHOLE, PERIOD)
    assert settled(check, 0.0, 0.0, 0.0, 0.0) is None
    told = next((n, said) for n in range(1, 500) if (said := check.update(0.0, 0.0, 0.0, -0.07)) is not None)
    due = [(n, 0.07 * (1.0 - math.exp(-0.1 * n)) - 0.2 * WAY * 1e-3 * (n - 1) - WAY) for n in range(1, 500)]
    expected = next((n, beyond) for n, beyond in due if beyond > 0.0)
    assert told == (expected[0], pytest.approx(expected[1], abs=1e-6))
