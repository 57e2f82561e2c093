"""Direction of the tendon's slip: the joint by speed, the stretch by travel, the last one where nothing slips."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsa_ctrl.control.direction import NOISE, Direction, DirectionSettings
from tsa_ctrl.control.motion import Motion

PERIOD = 1e-3
COUNT = 2.0 * math.pi / (1 << 20)  # rad
LEAD = 6e-3  # s
REACH = 2e-4  # m of tendon per N*m: 1.2 m, 60 kN, evenly bent
R_J = 0.025


class Joint:
    """A joint that moves as told, and the direction found."""

    def __init__(self, bits: int = 20, give: float | None = None, way: float = 0.0, **settings: float) -> None:
        self.count = 2.0 * math.pi / (1 << bits)
        self.motion = Motion(PERIOD, self.count, LEAD)
        self.direction = Direction(DirectionSettings(**settings), self.motion, LEAD, REACH, R_J, PERIOD, give, way)

    def step(self, angle: float, wanted: float = math.nan, rate: float = 0.0) -> float:
        self.motion.update(self.count * math.floor(angle / self.count))
        return self.direction.update(wanted, rate)


def brought_to_rest(joint: Joint, sign: float, seconds: float = 1.0) -> float:
    """The joint moves by 0.8 rad, its velocity a raised cosine; returns where it stands, on the edge of a count."""
    end = joint.count * math.ceil(0.8 / joint.count)
    for n in range(round(seconds / PERIOD) + 1):
        y = n * PERIOD / seconds
        joint.step(sign * end * (y - math.sin(2.0 * math.pi * y) / (2.0 * math.pi)))
    return sign * end


def test_nothing_slips_before_anything_has_moved() -> None:
    joint = Joint()
    assert {joint.step(0.3) for _ in range(1000)} == {0.0}
    assert {joint.step(0.3, 0.9 * DirectionSettings().play / REACH) for _ in range(1000)} == {0.0}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_torque_that_is_all_ahead_when_it_is_first_seen_has_a_direction(sign: float) -> None:
    """A set-point that is constant before a turn would be over: nothing changes any more, but it began from 0."""
    joint = Joint()
    assert {joint.step(0.3, sign * 0.5) for _ in range(1000)} == {sign}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_joints_motion_decides_and_is_kept_at_rest(sign: float) -> None:
    """While it moves sigma is its sign; after it has come to rest it stays, for as long as nothing else happens."""
    joint = Joint()
    angle = brought_to_rest(joint, sign)
    assert {joint.step(angle) for _ in range(5000)} == {sign}


@pytest.mark.parametrize(("give", "turned_at"), [(0.0, 0.5), (REACH, 0.516)])
def test_a_torque_that_grows_puts_off_the_turn_by_what_stretches_behind_the_bends(
    give: float, turned_at: float
) -> None:
    """A joint that turns round at 0.5 s, slowly; 10 N*m/s stretch the tendon by 80 mrad/s of the joint."""
    joint = Joint(give=give)
    sigmas = [joint.step(2.5 * (0.25 - (n * PERIOD - 0.5) ** 2), 0.01 * n, 10.0) for n in range(1000)]
    assert PERIOD * sigmas.index(-1.0) == pytest.approx(turned_at - LEAD, abs=2.5e-3)


@pytest.mark.parametrize("way", [0.0, 0.02])
def test_a_stop_at_once_is_taken_for_a_reversal_for_a_moment(way: float) -> None:
    """It cannot be told from one when it must be known; where the way of a turn is known, all is soon as before."""
    joint = Joint(way=way)
    for n in range(300):
        joint.step(1.0 * n * PERIOD)
    sigmas = [joint.step(0.299) for _ in range(2000)]
    assert -1.0 in sigmas
    assert np.count_nonzero(np.diff(sigmas)) <= 2
    assert set(sigmas[100:]) == ({1.0} if way else {-1.0})


@pytest.mark.parametrize(("share", "turns"), [(0.02, False), (0.5, True)])
def test_a_joint_that_trembles_at_rest_has_turned_nothing(share: float, turns: bool) -> None:
    """A hand pushes it back by a share of the way in which its tendons turn round, and holds it there."""
    way = 0.02  # rad
    joint = Joint(way=way)
    for _ in range(50):
        joint.step(0.3, 0.5)  # a torque that begins, all of it wanted
    found = [joint.step(0.3 - share * way * min(n / 25, 1.0), 0.5) for n in range(1000)]
    assert -1.0 in found
    assert set(found[200:]) == {-1.0 if turns else 1.0}


def test_what_is_wanted_before_the_tendons_have_turned_has_not_arrived() -> None:
    """The joint trembles back and forth when the torque is first wanted: that begins from none all the same."""
    joint = Joint(way=0.02)
    for n in range(30):
        joint.step(0.3 + 2e-4 * math.sin(0.2 * n))
    found = [joint.step(0.3 + 2e-4 * math.sin(0.2 * min(n, 70)), 0.5) for n in range(30, 1000)]
    assert -1.0 in found
    assert set(found[200:]) == {1.0}


def test_a_reversal_is_led() -> None:
    """sigma turns by the lead before the joint does, and says how old the reversal is."""
    joint = Joint()
    found = {}
    for n in range(2000):
        t = n * PERIOD
        sigma = joint.step(math.sin(2.0 * math.pi * t))
        if n > 100 and sigma not in found:
            found[sigma] = t, joint.direction.age
    t, age = found[-1.0]
    assert t - age * PERIOD == pytest.approx(0.25 - LEAD, abs=1e-3)
    assert 0.0 <= age <= 1.0


@pytest.mark.parametrize("frequency", [2.0, 0.5, 0.05, 0.005])
@pytest.mark.parametrize("amplitude", [0.5, 0.05])
def test_a_held_joint_turns_with_the_torque_however_slow_and_small(frequency: float, amplitude: float) -> None:
    """By travel, not by rate: within the play beyond each extreme of the torque wanted."""
    joint = Joint()
    steps = round(2.0 / frequency / PERIOD)
    play = DirectionSettings().play / (REACH * amplitude)
    for n in range(0, steps, max(1, steps // 4000)):
        wanted = math.sin(2.0 * math.pi * n / (0.5 * steps))
        sigma = joint.step(0.0, amplitude * wanted)
        rising = math.cos(2.0 * math.pi * n / (0.5 * steps)) > 0.0
        if abs(wanted) < 1.0 - 2.0 * play - 0.01 and n > 0.1 * steps:
            assert sigma == (1.0 if rising else -1.0)


def test_a_wanted_torque_that_trembles_within_the_play_turns_nothing() -> None:
    joint = Joint()
    for n in range(200):
        joint.step(0.0, 0.5 * n / 200)
    trembling = 0.5 + 0.9 * DirectionSettings().play / REACH * np.random.default_rng(1).uniform(-1.0, 0.0, 2000)
    assert {joint.step(0.0, float(wanted)) for wanted in trembling} == {1.0}


def test_a_slow_joint_and_a_fast_torque_slip_as_their_sum_says() -> None:
    """At 0.02 rad/s forward and -4 N*m/s the tendon goes back: 0.5 mm/s against -0.8 mm/s."""
    joint = Joint()
    for n in range(400):
        sigma = joint.step(0.02 * n * PERIOD, 0.5 - 4.0 * n * PERIOD, -4.0)
    assert sigma == -1.0
    for n in range(400, 800):
        sigma = joint.step(0.02 * n * PERIOD, -1.1, 0.0)
    assert sigma == 1.0


@pytest.mark.parametrize("bits", [12, 13, 14, 16, 17, 20, 22])
def test_no_chatter_at_standstill_for_any_encoder(bits: int) -> None:
    """A joint that trembles about the edge of a count turns nothing, with a torque or without."""
    joint = Joint(bits)
    random = np.random.default_rng(bits)
    at = brought_to_rest(joint, 1.0)
    trembling = at + joint.count * random.uniform(-0.5, 0.5, 20_000)
    before = joint.direction.sigma
    assert {joint.step(float(angle)) for angle in trembling} == {before} != {0.0}
    assert {joint.step(float(angle), 0.5) for angle in trembling} == {1.0}


def test_the_zone_follows_the_encoder_and_cannot_be_set_below_its_noise() -> None:
    coarse = Joint(12).direction
    assert coarse.zone > 0.05
    coarse.zone = 0.01
    assert coarse.zone > 0.05
    fine = Joint(20)
    assert fine.direction.zone == DirectionSettings().zone > NOISE * fine.motion.noise
    fine.direction.zone = 0.2
    assert fine.direction.zone == 0.2


def test_without_torque_the_direction_stays_and_the_next_torque_starts_anew() -> None:
    joint = Joint()
    for n in range(200):
        joint.step(0.0, 0.5 * n / 200)
    joint.direction.forget()
    assert {joint.step(0.0) for _ in range(10)} == {1.0}
    assert joint.step(0.0, 0.5) == 1.0
    joint.direction.forget()
    assert joint.step(0.0, -0.4) == -1.0  # from none, not from the 0.5 before
    assert joint.step(0.0, -0.3) == 1.0


def test_is_odd() -> None:
    """The mirrored motion and torque give the mirrored direction."""
    one, other = Joint(), Joint()
    random = np.random.default_rng(3)
    for angle, wanted in zip(random.normal(0.0, 0.01, 500), random.normal(0.0, 0.1, 500), strict=True):
        angle = COUNT * round(float(angle) / COUNT)
        one.motion.update(angle)
        other.motion.update(-angle)
        assert one.direction.update(float(wanted), 0.0) == -other.direction.update(-float(wanted), 0.0)
