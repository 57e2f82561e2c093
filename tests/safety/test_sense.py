"""The sense of the motor's torque, on a spring between motor and joint that the test makes itself."""

from __future__ import annotations

import math

import pytest

from tsa_ctrl.safety.sense import PATIENCE, SMALL, Sense

PERIOD = 1e-3  # s
GEARED = 1.25  # r_J/r_M
STIFFNESS = 10.0  # N*m/rad
UNKNOWN = math.nan


def run(
    sense: Sense,
    sign: float = 1.0,
    gain: float = UNKNOWN,
    seconds: float = 0.5,
    rise: float = 1.0,
    omega_j: float = 0.0,
) -> float | str:
    """A torque that rises by `rise` N*m/s; what is found, or when the torque was free to grow, s."""
    free = math.inf
    for n in range(round(seconds / PERIOD)):
        torque = rise * n * PERIOD
        apart = sign * torque / STIFFNESS + 3.0
        wrong = sense.update(n * PERIOD, torque, apart, gain * GEARED * torque, 0.0, omega_j)
        if wrong is not None:
            return wrong
        if sense.ceiling == math.inf:
            free = min(free, n * PERIOD)
    return free


def test_torque_is_small_until_the_stretch_shows_its_sense() -> None:
    sense = Sense(2.0, GEARED, PERIOD)
    assert sense.ceiling == pytest.approx(2.0 * SMALL)
    free = run(sense)
    assert isinstance(free, float)
    assert 0.02 + 0.17 < free < 0.1 + 0.17  # which it grows in from 11 % to all of the limit


def test_a_reversed_motor_is_found_and_the_torque_stays_small() -> None:
    sense = Sense(2.0, GEARED, PERIOD)
    found = run(sense, sign=-1.0)
    assert "the wrong way round" in str(found)
    assert sense.ceiling == pytest.approx(2.0 * SMALL)


def test_on_a_joint_that_something_else_moves_friction_that_looks_reversed_for_a_while_stops_nothing() -> None:
    """A quarter of a second must it look so there; the torque does not grow meanwhile."""
    sense = Sense(2.0, GEARED, PERIOD)
    assert isinstance(run(sense, sign=-1.0, seconds=0.2, omega_j=0.5), float)
    assert sense.ceiling == pytest.approx(2.0 * SMALL)
    sense.reset()
    assert "the wrong way round" in str(run(sense, sign=-1.0, seconds=0.4, omega_j=0.5))
    assert sense.ceiling == pytest.approx(2.0 * SMALL)
    sense.reset()
    assert "the wrong way round" in str(run(sense, sign=-1.0, seconds=0.1, omega_j=0.0))


@pytest.mark.parametrize(("wound", "found"), [(0.0, True), (0.02, False)])
def test_a_tendon_that_friction_winds_up_slowly_is_no_reversed_motor(wound: float, found: bool) -> None:
    """Something moves the joint by 0.04 rad in half a second, and friction stretches the tendon against the torque."""
    sense = Sense(2.0, GEARED, PERIOD, wound)
    said, travel = None, 0.0
    for n in range(1200):
        omega_j = 0.06 if n < 600 else 0.3
        travel += GEARED * omega_j * PERIOD
        torque = 0.4 * n * PERIOD
        apart = torque / STIFFNESS - 2.0 * min(travel, 0.025)
        said = said or sense.update(n * PERIOD, torque, apart, UNKNOWN, 1.0, omega_j)
    assert (said is not None) is found


def test_a_motor_that_turns_round_on_a_joint_that_goes_on_is_found_when_its_tendons_slide() -> None:
    """Half a radian a second: after 30 mrad at the motor the torque's way is seen, a quarter of a second later said."""
    sense = Sense(2.0, GEARED, PERIOD, 0.02)
    found = run(sense, sign=-1.0, seconds=0.5, omega_j=0.5)
    assert "the wrong way round" in str(found)


def test_without_an_encoder_the_joint_s_torque_shows_it() -> None:
    for gain, expected in ((0.5, float), (-0.5, str)):
        assert isinstance(run(Sense(2.0, GEARED, PERIOD), UNKNOWN, gain), expected)


@pytest.mark.parametrize(("gain", "found"), [(1.2, False), (1.4, True), (2.0, True), (3.5, False)])
def test_a_motor_that_gives_more_than_it_reports(gain: float, found: bool) -> None:
    """By more than three times is no torque constant wrong: that is a hand that moves the limb."""
    said = run(Sense(2.0, GEARED, PERIOD), gain=gain)
    assert isinstance(said, str) is found
    if found:
        assert f"follows the motor's torque by {gain * GEARED:.2f}, the pulleys give 1.25" in str(said)


def test_a_joint_that_is_moved_accuses_no_motor_of_giving_more() -> None:
    """There friction turns with the motion, and what it gives back follows the torque."""
    assert isinstance(run(Sense(2.0, GEARED, PERIOD), gain=2.0, omega_j=0.3), float)
    assert isinstance(run(Sense(2.0, GEARED, PERIOD), gain=2.0, omega_j=math.nan), float)


def test_what_shows_nothing_is_not_held_up_for_longer_than_its_patience() -> None:
    free = run(Sense(2.0, GEARED, PERIOD), sign=0.0)
    assert isinstance(free, float)
    assert PATIENCE + 0.17 < free < PATIENCE + 0.27


def test_nothing_known_accuses_nothing_and_a_torque_that_rests_shows_nothing() -> None:
    assert isinstance(run(Sense(2.0, GEARED, PERIOD), UNKNOWN), float)
    assert run(Sense(2.0, GEARED, PERIOD), sign=-1.0, rise=0.0) == math.inf


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_set_point_that_rests_is_let_through_slowly_and_shows_its_sense_on_the_way(sign: float) -> None:
    """2 N*m asked for at once: all of it within two seconds; of a reversed motor not a fifth of the limit."""
    sense, said, most = Sense(2.0, GEARED, PERIOD), None, 0.0
    for n in range(2000):
        torque = min(2.0, sense.ceiling)
        most = max(most, torque)
        said = sense.update(n * PERIOD, torque, sign * torque / STIFFNESS, UNKNOWN, 0.0, 0.0)
        if said is not None:
            break
    assert (said is None) is (sign > 0.0)
    assert most == 2.0 if sign > 0.0 else most < 0.4


def test_each_enable_shows_it_anew() -> None:
    sense = Sense(2.0, GEARED, PERIOD)
    run(sense)
    assert sense.ceiling == math.inf
    sense.reset()
    assert sense.ceiling == pytest.approx(2.0 * SMALL)
    assert "the wrong way round" in str(run(sense, sign=-1.0))


@pytest.mark.parametrize(("changes", "wrong"), [(1, False), (3, True)])
def test_a_count_that_changes_against_the_torque_is_no_answer_but_several_are(changes: int, wrong: bool) -> None:
    count = 2.0 * math.pi / 4096  # rad
    sense = Sense(2.0, GEARED, PERIOD, counts=count)
    found = None
    for n in range(300):
        flipped = sum(n > 100 + 40 * each for each in range(changes))
        found = found or sense.update(n * PERIOD, n * PERIOD, -flipped * count, UNKNOWN, 0.0, 0.0)
    assert (found is not None) is wrong


def test_a_joint_torque_that_only_fluctuates_is_no_answer() -> None:
    """A held joint gets nothing at first, without an encoder of the joint: what its sensor reads then is noise."""
    sense = Sense(2.0, GEARED, PERIOD)
    for n in range(400):
        noise = -0.005 * math.sin(n / 60.0)  # N*m, that falls while the torque rises
        assert sense.update(n * PERIOD, n * PERIOD, UNKNOWN, noise, 0.0, 0.0) is None


def test_what_the_sensor_said_while_the_joint_moved_does_not_count_once_it_is_held() -> None:
    """A joint that comes to rest takes up what friction gave away: its torque jumps by more than the motor's grows."""
    sense = Sense(2.0, GEARED, PERIOD)
    for n in range(1000):
        torque = 0.3 + 0.5 * n * PERIOD
        moves = n < 400
        joint = GEARED * (torque - 0.2 if moves else torque)
        assert sense.update(n * PERIOD, torque, torque / STIFFNESS, joint, 1.0, 0.4 if moves else 0.0) is None
