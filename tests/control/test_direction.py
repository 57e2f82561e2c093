"""Test the slip direction of the tendon, determined from joint speed, elongation or the last direction."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.control.laws import Told
from tsa_ctrl.control.direction import NOISE, QUICK, TREMOR, UNSURE, Direction
from tsa_ctrl.control.motion_filter import Motion
from tsa_ctrl.control.settings import DirectionSettings

PERIOD = 1e-3
COUNT = 2.0 * math.pi / (1 << 20)  # rad
LEAD = 6e-3  # s
REACH = 2e-4  # m of elongation per N*m for 1.2 m, 60 kN and even curvature
R_J = 0.025


class Joint:
    """A joint with a prescribed motion, and the direction determined for it."""

    def __init__(self, bits: int = 20, give: float | None = None, way: float = 0.0, **settings: float) -> None:
        self.count = 2.0 * math.pi / (1 << bits)
        self.motion = Motion(PERIOD, self.count, LEAD)
        self.direction = Direction(DirectionSettings(**settings), self.motion, LEAD, REACH, R_J, PERIOD, give, way)

    def step(self, angle: float, wanted: float = math.nan, rate: float = 0.0) -> float:
        self.motion.update(self.count * math.floor(angle / self.count))
        return self.direction.update(wanted, rate)


def brought_to_rest(joint: Joint, sign: float, seconds: float = 1.0) -> float:
    """Move the joint by 0.8 rad with a raised-cosine velocity. Return its final angle (rad), the edge of a count."""
    end = joint.count * math.ceil(0.8 / joint.count)
    for n in range(round(seconds / PERIOD) + 1):
        y = n * PERIOD / seconds
        joint.step(sign * end * (y - math.sin(2.0 * math.pi * y) / (2.0 * math.pi)))
    return sign * end


def test_nothing_slips_before_anything_has_moved() -> None:
    joint = Joint()
    assert {joint.step(0.3) for _ in range(1000)} == {0.0}
    assert {joint.step(0.3, 0.9 * DirectionSettings().play / REACH) for _ in range(1000)} == {0.0}


@pytest.mark.parametrize("way", [0.0, 0.02])
def test_a_stop_at_once_is_taken_for_a_reversal_for_a_moment(way: float) -> None:
    """At first a sudden stop looks like a reversal. If the reversal travel is known, sigma returns."""
    joint = Joint(way=way)
    for n in range(300):
        joint.step(1.0 * n * PERIOD)
    sigmas = [joint.step(0.299) for _ in range(2000)]
    assert -1.0 in sigmas
    assert np.count_nonzero(np.diff(sigmas)) <= 2
    assert set(sigmas[100:]) == ({1.0} if way else {-1.0})


def test_what_is_wanted_before_the_tendons_have_turned_has_not_arrived() -> None:
    """The joint trembles when a torque is first requested. sigma ends in the direction of this torque."""
    joint = Joint(way=0.02)
    for n in range(30):
        joint.step(0.3 + 2e-4 * math.sin(0.2 * n))
    found = [joint.step(0.3 + 2e-4 * math.sin(0.2 * min(n, 70)), 0.5) for n in range(30, 1000)]
    assert -1.0 in found
    assert set(found[200:]) == {1.0}


def test_a_reversal_is_led() -> None:
    """sigma reverses before the joint by the lead, and the age of the reversal is reported."""
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


@pytest.mark.parametrize("bits", [12, 14, 17, 20, 22])
def test_no_chatter_at_standstill_for_any_encoder(bits: int) -> None:
    """A joint that trembles about the edge of a count causes no reversal, with or without torque."""
    joint = Joint(bits)
    random = np.random.default_rng(bits)
    at = brought_to_rest(joint, 1.0)
    trembling = at + joint.count * random.uniform(-0.5, 0.5, 8_000)
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
    assert Direction(DirectionSettings(), Told(0.02), LEAD, REACH, R_J, PERIOD).zone == pytest.approx(1.5 * 0.02)


def test_without_torque_the_direction_stays_and_the_next_torque_starts_anew() -> None:
    joint = Joint()
    for n in range(200):
        joint.step(0.0, 0.5 * n / 200)
    joint.direction.forget()
    assert {joint.step(0.0) for _ in range(10)} == {1.0}
    assert joint.step(0.0, 0.5) == 1.0
    joint.direction.forget()
    assert joint.step(0.0, -0.4) == -1.0  # counted from zero and not from the previous 0.5
    assert joint.step(0.0, -0.3) == 1.0


PLAY = 2.0**-20  # m; all of these are powers of two, so that calculations are exact
TO_M = 2.0**-12  # m per N*m
RADIUS = 2.0**-5  # m
TURN = PLAY / TO_M  # N*m that change the elongation by the play


class By:
    """The direction of a joint with prescribed speed, acceleration and angle. The zone is 0.0625 rad/s."""

    def __init__(self, lead: float = 0.0, give: float | None = None, **more: float) -> None:
        self.motion = Told()
        settings = DirectionSettings(zone=0.0625, play=PLAY)
        self.direction = Direction(settings, self.motion, lead, TO_M, RADIUS, PERIOD, give, **more)

    def __call__(
        self, speed: float, ahead: float = math.nan, rate: float = 0.0, angle: float = 0.0, turning: float = 0.0
    ) -> float:
        self.motion.velocity, self.motion.angle, self.motion.acceleration = speed, angle, turning
        return self.direction.update(ahead, rate)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_at_the_edge_of_the_zone_the_joint_stands(way: float) -> None:
    by = By()
    assert by(way * 0.0625) == 0.0
    assert not by.direction.moving
    assert by(way * 0.0626) == way
    assert (by.direction.moving, by.direction.rest) == (True, 0.0)
    by(0.0)
    by.direction.reset()
    assert (by.direction.sigma, by.direction.age, by.direction.rest, by.direction.moving) == (0.0, 0.0, math.inf, False)


@pytest.mark.parametrize(
    ("speed", "turning", "age"), [(0.25, 500.0, 0.5), (0.25, -500.0, 0.5), (0.25, 0.0, 0.0), (2.0, 500.0, 1.0)]
)
def test_the_age_of_a_turn_is_the_time_since_the_speed_was_zero(speed: float, turning: float, age: float) -> None:
    by = By()
    by(-1.0)
    by(speed, turning=turning)
    assert by.direction.age == pytest.approx(age)
    by(speed, turning=turning)
    assert by.direction.age == 0.0  # the age applies to this reversal only
    by(-speed, turning=-turning)
    by.direction.reset()
    assert by.direction.age == 0.0


@pytest.mark.parametrize(
    ("angle", "ahead", "stood", "turns"),
    [
        (0.9, 0.0, True, False),  # within the backlash, with little torque
        (1.1, 0.0, True, True),  # farther
        (0.9, 0.3, True, True),  # with torque
        (0.9, math.nan, True, True),  # without a set-point
        (0.9, 0.0, False, True),  # a leg that swings
    ],
)
@pytest.mark.parametrize(("way", "backlash"), [(0.02, 0.002), (1.0, 0.003)])
def test_a_standing_joint_that_crosses_its_backlash_turns_nothing(
    angle: float, ahead: float, stood: bool, turns: bool, way: float, backlash: float
) -> None:
    """The limit is 3 mrad or a tenth of the travel that reverses the tendons, and a tenth of the friction torque."""
    angle *= backlash
    by = By(way=way, friction=2.0)
    by(-1.0, angle=-2.0)
    for _ in range(100 if stood else 20):
        by(0.0)
    assert by(0.25, ahead=ahead, angle=angle) == (1.0 if turns else -1.0)
    assert by.direction.moving is turns


def test_what_exactly_cancels_turns_nothing() -> None:
    by = By(give=TO_M)
    assert by(0.5) == 1.0
    assert by(0.5, ahead=0.0, rate=-RADIUS * 0.5 / TO_M) == 1.0
    assert by(0.5, ahead=0.0, rate=-2.0 * RADIUS * 0.5 / TO_M) == -1.0


def test_what_stretches_while_the_joint_moves_is_what_does_so_at_rest_unless_it_is_said() -> None:
    assert By()(0.125, 0.0, -RADIUS * 0.25 / TO_M) == -1.0
    assert By(give=0.0)(0.125, 0.0, -RADIUS * 0.25 / TO_M) == 1.0


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_torque_turns_the_tendon_by_more_than_the_play_from_where_it_was(way: float) -> None:
    by = By()
    assert by(way, way * 1.0) == way
    assert by(0.0, way * (1.0 - TURN)) == way  # reduced by exactly the play since the joint moved
    assert by(0.0, way * (1.0 - 1.5 * TURN)) == -way
    assert by(0.0, way * (1.0 + 0.5 * TURN)) == -way  # beyond the play in the other direction
    assert by(0.0, way * (1.0 + 0.75 * TURN)) == way
    rested = By()
    assert rested(0.0, way * TURN) == 0.0
    assert rested(0.0, way * 1.5 * TURN) == way
    assert rested(0.0, way * -0.5 * TURN) == way
    assert rested(0.0, way * -0.75 * TURN) == -way


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_joint_that_turned_by_a_twentieth_of_the_way_has_turned_nothing(way: float) -> None:
    """With a reversal travel of 0.4 rad, a motion of less than a twentieth (20 mrad) is not a reversal after a rest."""
    for gone, back in ((0.0199, True), (0.02, False), (0.0201, False)):
        by = By(way=0.4)
        by(way)
        by(way, angle=0.1)
        assert by(-way, angle=0.1) == -way
        assert by(-way, angle=0.1 - gone if gone != 0.02 else 0.1) == -way
        by.motion.angle = 0.1
        sigmas = [by(0.0, angle=0.1 - gone) for _ in range(10)]
        told = sigmas.index(way) if way in sigmas else None
        assert told == (5 if back else None), gone
    alone = By()  # without a known reversal travel
    alone(way)
    alone(way, angle=1.0)
    alone(-way, angle=1.0)
    assert {alone(0.0, angle=1.0) for _ in range(10)} == {-way}


def test_after_one_that_went_back_again_the_next_turn_counts_from_where_it_is() -> None:
    by = By(way=0.4)
    by(1.0)
    for speed, angle in ((-1.0, 0.1), (1.0, 0.095), (-1.0, 0.096)):
        by(speed, angle=angle)
    assert [by(0.0, angle=0.078) for _ in range(10)][-1] == 1.0  # 18 mrad after this reversal, 22 mrad after the first


def test_the_first_motion_however_little_has_nothing_before_it() -> None:
    by = By(way=0.4)
    by(1.0)
    assert {by(0.0, angle=0.001) for _ in range(10)} == {1.0}


def test_a_joint_that_trembles_keeps_the_direction_before_and_the_torques_place() -> None:
    """After a motion back and forth within the reversal travel, the previous direction remains.

    The torque that was desired meanwhile does not count as delivered, and the next reversal counts from the new angle.
    """
    by = By(way=0.4)
    by(1.0, 1.0)
    by(-1.0, 1.0, angle=0.1)
    by(-1.0, 1.0 + 8.0 * TURN, angle=0.09)  # part of a possible reversal
    by(1.0, 1.0 + 8.0 * TURN, angle=0.095)  # moves in the first direction again
    assert {by(0.0, 1.0 + 8.0 * TURN, angle=0.096) for _ in range(10)} == {1.0}
    assert by(-1.0, 1.0, angle=0.0961) == -1.0
    assert {by(0.0, angle=0.0961) for _ in range(10)} == {-1.0, 1.0}


def turns_of(frequency: float, amplitude: float, seconds: float = 2.0) -> list[tuple[float, bool]]:
    """Return the time (s) of each reversal of an oscillating joint, and True if it follows the joint's motion."""
    joint, found, last = Joint(way=9.4e-3), [], 0.0
    for n in range(round(seconds / PERIOD)):
        sigma = joint.step(0.3 + amplitude * math.sin(2.0 * math.pi * frequency * n * PERIOD))
        if sigma * last < 0.0:
            found.append((n * PERIOD, joint.direction.follows))
        last = sigma
    return found


@pytest.mark.parametrize(
    ("frequency", "follows"), [(4.0, True), (8.0, True), (12.0, True), (14.0, False), (30.0, False)]
)
def test_turns_no_faster_than_a_hand_trembles_are_said_to_follow_the_joint(frequency: float, follows: bool) -> None:
    found = turns_of(frequency, 2e-3)
    assert {told for _, told in found[1:]} == {follows}
    if follows:
        assert len(found) >= 4.0 * frequency - 3.0


def test_turns_faster_than_a_tremor_are_the_joints_play() -> None:
    """Fast small oscillations count as backlash, so that the friction term does not excite them.

    Slower and wider motions still cause reversals.
    """
    assert len(turns_of(30.0, 2e-3)) <= QUICK + 1
    assert len(turns_of(4.0, 2e-3)) >= 13
    joint = Joint()
    for n in range(1000):
        joint.step(0.3 + 2e-3 * math.sin(2.0 * math.pi * 30.0 * n * PERIOD))
    turns, last = 0, joint.direction.sigma
    for n in range(2000):
        sigma = joint.step(0.3 + 0.1 * math.sin(2.0 * math.pi * n * PERIOD))
        turns, last = turns + (sigma != last), sigma
    assert 3 <= turns <= 5


def test_a_turn_follows_the_joint_from_a_tremors_time_after_the_last_and_for_as_long() -> None:
    """A reversal follows the joint if no other one came within the tremor time before it.

    `follows` then stays True for the tremor time. The period is half of this time, so that the limit is met exactly.
    """
    motion = Told()
    direction = Direction(DirectionSettings(), motion, 0.0, TO_M, RADIUS, 0.5 * TREMOR)
    told = []
    for speed in (1.0, 1.0, -1.0, -1.0, -1.0, 1.0, -1.0):
        motion.velocity = speed
        direction.update(math.nan, 0.0)
        told.append(direction.follows)
    assert told == [True, True, True, True, False, True, False]
    direction.reset()
    assert not direction.follows


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_torques_turn_follows_no_joint_and_one_that_turns_nothing_is_no_turn(way: float) -> None:
    by = By()
    by(way, 0.0)
    assert by.direction.follows
    assert by(0.0, way * 8.0 * TURN) == way  # further in the same direction
    assert by.direction.follows
    assert by(0.0, 0.0) == -way
    assert not by.direction.follows
    assert by(way, 0.0) == way  # 1 ms after that
    assert not by.direction.follows


def at_rest_by(by_sensor: bool, way: float = 1.0) -> By:
    """Return a joint at rest after a motion in direction `way`.

    During the motion, the torque sensor agreed with the law.
    """
    by = By(give=0.0, unsure=UNSURE if by_sensor else math.inf)
    for _ in range(1000):
        by(way * 0.25)
        by.direction.measure(0.0, False)
    by(0.0)
    return by


def measured(by: By, excess: float, cycles: int = 100, turning: bool = False) -> float:
    """Return the direction after `cycles` at rest with a sensor torque `excess` N*m above the desired torque."""
    sigma = math.nan
    for _ in range(cycles):
        by.direction.measure(excess, turning)
        sigma = by(0.0, 0.0)
    return sigma


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_torque_sensor_decides_at_rest_if_all_bends_are_at_the_joint(way: float) -> None:
    """A measured torque above the desired one reverses sigma if the excess is larger than the uncertainty.

    A torque below the desired one and a missing value have no effect.
    """
    assert measured(at_rest_by(True, way), 0.1 * way) == -way
    assert measured(at_rest_by(True, way), 0.03 * way) == way
    assert measured(at_rest_by(True, way), -0.1 * way) == way
    assert measured(at_rest_by(True, way), math.nan) == way


def test_the_torque_sensor_does_not_decide_where_the_elongation_does_or_a_reversal_runs() -> None:
    assert measured(at_rest_by(False), 0.1) == 1.0
    assert measured(at_rest_by(True), 0.1, turning=True) == 1.0


def test_a_sensor_that_was_wrong_while_the_joint_moved_decides_only_beyond_that_error() -> None:
    by = By(give=0.0, unsure=UNSURE)
    for _ in range(2000):
        by(0.25)
        by.direction.measure(0.1, False)
    assert measured(by, 0.11) == 1.0
    assert measured(by, 0.2) == -1.0


def test_the_joints_motion_overrules_the_torque_sensor() -> None:
    by = at_rest_by(True)
    measured(by, 0.1)
    assert by(0.25) == 1.0


def test_the_sensor_reverses_a_joint_within_its_play() -> None:
    """A slow motion back counts as backlash until the sensor shows an excess torque."""
    joint = Joint()
    joint.direction = Direction(DirectionSettings(), joint.motion, LEAD, REACH, R_J, PERIOD, unsure=UNSURE)
    for n in range(1000):
        joint.step(0.3 + 2e-3 * math.sin(2.0 * math.pi * 30.0 * n * PERIOD))
    before = joint.direction.sigma
    angle, found = joint.motion.angle, []
    for n in range(100):
        joint.direction.measure(0.2 * before if n >= 50 else 0.0, False)
        angle -= before * 0.02 * PERIOD
        found.append(joint.step(angle))
    assert set(found[20:50]) == {before}
    assert found[-1] == -before


def ramped(excess: float, speed: float = 0.0) -> float:
    """Return the direction after the desired torque has grown for 0.2 s while the joint moves at `speed` (rad/s)."""
    by = By(give=1.0, unsure=UNSURE + 1.0)
    for _ in range(1000):
        by(-0.25)
        by.direction.measure(0.0, False)
    sigma = math.nan
    for n in range(300):
        by.direction.measure(excess, False)
        sigma = by(speed, 0.01 * (n - 100), 10.0) if n >= 100 else by(speed)
    return sigma


@pytest.mark.parametrize("speed", [0.0, -0.125])
def test_a_growing_torque_reverses_nothing_while_the_sensor_shows_enough(speed: float) -> None:
    """A growing torque changes sigma unless the sensor already measures an excess torque.

    This holds at rest and while the joint moves back more slowly than the tendon elongates.
    """
    assert ramped(0.0, speed) == 1.0
    assert ramped(-0.2, speed) == 1.0
    assert ramped(0.2, speed) == -1.0


def test_the_missing_torque_is_what_the_sensor_shows_while_the_tendons_stick() -> None:
    by = at_rest_by(True)
    measured(by, -0.2)
    assert by.direction.missing == pytest.approx(0.2, rel=1e-3)
    measured(by, 0.0)
    assert by.direction.missing == 0.0
