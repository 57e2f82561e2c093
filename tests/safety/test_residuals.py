"""Residuals of an axis: motor and joint on a simulated spring with a friction play between them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tsa_ctrl.safety.residuals import DOUBT, FRICTION, Elongation, Give, SensorNoise, Standstill, Velocity

PERIOD = 1e-3  # s
STIFFNESS = 40.0  # N*m/rad
WOUND = 0.03  # rad
GIVE = Give(
    stiffness=STIFFNESS,
    wound=WOUND,
    domain=1.8,
    play=0.0,
    doubt=DOUBT,
    free=1.0,
    least_free=1.0,
    friction=FRICTION,
    inertia=0.0,
)


class Tendons:
    """A joint with a prescribed angle, and a motor at the elongation tau/K plus friction that follows the joint."""

    def __init__(self, softer: float = 1.0, friction: float = 1.0, give: Give = GIVE, period: float = PERIOD) -> None:
        self.check = Elongation(give, period)
        self._period = period
        self._compliance = softer / STIFFNESS
        self._half = 0.5 * friction * softer * WOUND
        self._wound = 0.0
        self._last = (0.0, 0.0)  # of joint and motor, rad
        self.time = 0.0

    def step(self, joint: float, torque: float, shown: Callable[[float], float] = lambda joint: joint) -> float | None:
        """Advance by one period and return the finding. Friction follows the joint's travel.

        `shown` maps the true joint angle to the encoder's reading (rad).
        """
        self.time += self._period
        self._wound = min(self._half, max(-self._half, self._wound - joint + self._last[0]))  # the motor lags
        motor = joint + torque * self._compliance + self._wound
        speed = (motor - self._last[1]) / self._period
        self._last = (joint, motor)
        return self.check.update(torque, motor, speed, shown(joint))


def found(tendons: Tendons, seconds: float, joint: Callable[[float], float], torque: Callable[[float], float],
          shown: Callable[[float], float] = lambda joint: joint) -> float | None:  # fmt: skip
    """Return the time until detection (s); None if there is none within `seconds`."""
    start = tendons.time
    while tendons.time < start + seconds:
        t = tendons.time
        if tendons.step(joint(t), torque(t), shown) is not None:
            return tendons.time - start
    return None


def swing(t: float) -> float:
    """Return the angle of the joint (rad)."""
    return 0.6 * math.sin(3.0 * t)


def pull(t: float) -> float:
    """Return the motor torque (N*m)."""
    return 1.5 * math.sin(7.0 * t)


@pytest.mark.parametrize("softer", [0.8, 1.0, 1.25])
@pytest.mark.parametrize("friction", [0.0, 0.5, 1.0, 1.25])
def test_stiffness_and_friction_may_be_a_fifth_off(softer: float, friction: float) -> None:
    tendons = Tendons(softer, friction)
    assert found(tendons, 6.0, swing, pull) is None
    assert found(tendons, 3.0, lambda t: swing(6.0), pull) is None  # held from then on, without any motion


@pytest.mark.parametrize("rate", [125.0, 250.0, 500.0, 1000.0])  # Hz
@pytest.mark.parametrize("acceleration", [10.0, 30.0, 90.0])  # rad/s^2
def test_a_joint_that_turns_quickly_stops_no_slow_loop(rate: float, acceleration: float) -> None:
    """The low-pass of a slow loop is longer than such a reversal."""
    frequency = math.sqrt(acceleration / 0.3)  # rad/s
    tendons = Tendons(period=1.0 / rate)
    assert found(tendons, 6.0, lambda t: 0.3 * math.sin(frequency * t), lambda t: 0.07) is None


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0, 1.5, 3.0, 6.0])  # 1, of WOUND; the file's elongation is 6
@pytest.mark.parametrize("amplitude", [0.1, 0.2, 0.6])  # rad
def test_a_file_without_the_place_of_the_bends_stops_no_rig(friction: float, amplitude: float) -> None:
    """With bends at the joint, the elongation shows little or none of the friction."""
    tendons = Tendons(friction=friction, give=replace(GIVE, wound=6.0 * WOUND, least_free=0.0))
    assert found(tendons, 6.0, lambda t: amplitude * math.sin(3.0 * t), lambda t: 0.07) is None


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
    """The zero of the joint encoder creeps by 0.1 rad in half a minute."""
    tendons = Tendons()
    assert found(tendons, 30.0, swing, pull, lambda joint: joint + 0.1 * tendons.time / 30.0) is None


def test_a_step_of_a_motor_that_rings_on_its_tendons_stops_nothing() -> None:
    """2 N*m act at once on a locked joint at 40 Hz without damping.

    The motor moves to twice the elongation and back.
    """
    check = Elongation(GIVE, PERIOD)
    for n in range(500):
        t = n * PERIOD
        angle = 2.0 / STIFFNESS * (1.0 - math.cos(2.0 * math.pi * 40.0 * t))
        speed = 2.0 / STIFFNESS * 2.0 * math.pi * 40.0 * math.sin(2.0 * math.pi * 40.0 * t)
        assert check.update(2.0 if n else 0.0, angle, speed, 0.3) is None


@pytest.mark.parametrize("friction", [0.4, 0.6, 0.75])
def test_a_torque_that_swings_and_turns_back_on_much_friction_stops_nothing(friction: float) -> None:
    """The torque is like the torque with a human-in-the-loop load at a friction angle of 0.8.

    The motor follows the torque at a distance of `friction` N*m and rests while the torque reverses.
    """
    give = replace(GIVE, stiffness=33.3, wound=0.0864, free=0.55, inertia=1e-4)
    check, slid, last = Elongation(give, PERIOD), 0.0, 0.0
    times, torques = [0.0, 0.3, 0.5, 0.52, 0.55, 0.8], [0.0, 1.04, 1.04, -1.72, -1.29, -1.29]  # s, N*m
    for n in range(800):
        torque = float(np.interp(n * PERIOD, times, torques))
        slid = min(torque + friction, max(torque - friction, slid))
        angle = slid / give.stiffness
        assert check.update(torque, angle, (angle - last) / PERIOD, 0.0) is None, n
        last = angle


def steady(t: float) -> float:
    return 2.0 * t


@pytest.mark.parametrize(
    ("joint", "torque", "shown", "most"),
    [
        (steady, 0.1, lambda joint: 2.0, 0.015),  # 30 mrad
        (lambda t: -2.0 * t, 0.1, lambda joint: -2.0, 0.015),
        (steady, 0.4, lambda joint: 2.0 + 0.5 * (joint - 2.0), 0.05),
        (swing, 0.8, lambda joint: joint - 0.1, 0.01),
    ],
    ids=["sticks", "sticks on the way back", "slips by half", "a tendon gives way"],
)
def test_an_encoder_that_sticks_or_slips_and_a_tendon_that_gives_way_are_found(
    joint: Callable[[float], float], torque: float, shown: Callable[[float], float], most: float
) -> None:
    """The fault begins after a second. The longest time until detection is in s."""
    tendons = Tendons()
    assert found(tendons, 1.0, joint, lambda t: torque) is None
    when = found(tendons, 0.2, joint, lambda t: torque, shown)
    assert when is not None
    assert when < most


@pytest.mark.parametrize("torque", [0.3, 0.8, -0.8])
@pytest.mark.parametrize(("gain", "turned"), [(-1.0, True), (2.0, False)])
def test_a_motor_that_gives_another_torque_than_it_reports_is_found_at_rest(
    torque: float, gain: float, turned: bool
) -> None:
    """A constant torque acts on a locked joint. The true torque changes at once, the reported torque does not."""
    check = Elongation(GIVE, PERIOD)
    assert settled(check, torque, torque / STIFFNESS, 0.0, 0.0) is None
    when = next(n for n in range(1, 100) if check.update(torque, gain * torque / STIFFNESS, 0.0, 0.0) is not None)
    assert when < 15
    assert check.reversed is turned


def test_a_motor_that_turns_the_wrong_way_is_found_as_its_torque_begins() -> None:
    """On a locked joint at 2 N*m/s, it is detected at less than a tenth of the limit of 2.5 N*m."""
    check = Elongation(GIVE, PERIOD)
    when = next(n for n in range(1000) if check.update(2e-3 * n, -2e-3 * n / STIFFNESS, 0.0, 0.0) is not None)
    assert check.reversed
    assert 2e-3 * when < 0.25


def test_beyond_the_domain_one_tendon_gives_twice_as_much() -> None:
    """The pretension is half of the file's value. The part of the torque beyond it acts on half the stiffness."""
    for domain, most in ((0.5, None), (5.0, 1.0)):
        check = Elongation(replace(GIVE, wound=0.0, domain=domain), PERIOD)
        said = None
        for n in range(1000):
            torque = 3.0 * min(1.0, n / 500)
            alone = max(0.0, torque - 0.5)
            said = said or check.update(torque, (torque + alone) / STIFFNESS, 0.0, 1e-5 * n)
        assert (said is None) is (most is None), domain


def test_a_reset_forgets_where_they_were() -> None:
    check = Elongation(GIVE, PERIOD)
    for motor, joint in ((0.0, 0.0), (30.0, 0.0), (-2.0, 0.0), (0.0, 30.0)):
        check.reset()
        assert [check.update(0.0, motor, 0.0, joint) for _ in range(50)] == [None] * 50


def settled(check: Elongation, torque: float, angle: float, speed: float, joint: float) -> float | None:
    """Return the finding of the check after a second of constant input."""
    said = None
    for _ in range(1000):
        said = check.update(torque, angle, speed, joint)
    return said


COUNT = 2.0 * math.pi / 65_536  # rad


def moved(n: int) -> tuple[float, float]:
    """Return the angle in whole counts (rad) and the speed (rad/s) of an oscillating motor at cycle n."""
    t = n * PERIOD
    return COUNT * math.floor(0.5 * math.sin(4.0 * t) / COUNT), 2.0 * math.cos(4.0 * t)


@pytest.mark.parametrize("late", [0.0, 8e-3])
def test_a_velocity_that_is_rounded_filtered_and_a_twentieth_off_is_believed(late: float) -> None:
    check = Velocity(COUNT, PERIOD)
    seen = 2.0
    for n in range(3000):
        angle, speed = moved(n)
        seen += (speed - seen) * (1.0 if late == 0.0 else 1.0 - math.exp(-PERIOD / late))
        assert not check.update(angle, round(1.05 * seen / 0.02) * 0.02)


@pytest.mark.parametrize(
    ("wrong", "most"), [(lambda s: -s, 0.03), (lambda s: 2.0 * s, 0.06), (lambda s: 0.0, 0.06), (lambda s: 2.0, 0.4)]
)
def test_a_velocity_of_another_sign_or_scale_and_one_that_sticks_are_found(
    wrong: Callable[[float], float], most: float
) -> None:
    """The fault begins at the fastest point of the oscillation. A velocity that sticks there is right at first."""
    check = Velocity(COUNT, PERIOD)
    at = round(2.0 * math.pi / 4.0 / PERIOD)  # one full period
    for n in range(at):
        assert not check.update(*moved(n))
    when = next(n for n in range(2000) if check.update(moved(at + n)[0], wrong(moved(at + n)[1])))
    assert when * PERIOD < most


def test_a_joint_that_stops_between_two_samples_is_an_encoder_that_sticks() -> None:
    check = Standstill(COUNT, PERIOD)
    assert not any(check.update(n * PERIOD, moved(n)[0]) for n in range(100))
    when = next(n for n in range(100, 200) if check.update(n * PERIOD, moved(99)[0]))
    assert when < 115


@pytest.mark.parametrize(("deceleration", "every"), [(50.0, 1), (50.0, 4), (5.0, 1)])
def test_a_joint_that_friction_stops_and_a_slow_device_accuse_nothing(deceleration: float, every: int) -> None:
    """The joint decelerates from 2 rad/s to rest. The device updates its position every `every` cycles."""
    check = Standstill(COUNT, PERIOD)
    for n in range(1000):
        t = min(n // every * every * PERIOD, 2.0 / deceleration)
        assert not check.update(n * PERIOD, COUNT * math.floor((2.0 - 0.5 * deceleration * t) * t / COUNT))


def test_a_reset_forgets_velocity_and_standstill() -> None:
    velocity, rests = Velocity(COUNT, PERIOD), Standstill(COUNT, PERIOD)
    for n in range(100):
        velocity.update(0.0, 1.0)
        rests.update(n * PERIOD, moved(n)[0])
    assert velocity.update(0.0, 1.0)
    velocity.reset()
    rests.reset()
    assert not velocity.update(5.0, 0.0)
    assert not any(rests.update(1.0 + n * PERIOD, 5.0) for n in range(50))


@pytest.mark.parametrize("skipped", [1, 3, 17])
def test_periods_without_a_cycle_are_no_contradiction_of_the_velocity(skipped: int) -> None:
    """A quarter of the periods has no cycle. Their travel is ignored, and a wrong scale is still detected."""
    for scale, wrong in ((1.0, False), (0.5, True)):
        check, n, found = Velocity(COUNT, PERIOD), 0, []
        for cycle in range(1000):
            angle = 0.4 * math.sin(2.0 * math.pi * n * PERIOD)
            speed = 0.4 * 2.0 * math.pi * math.cos(2.0 * math.pi * n * PERIOD)
            found.append(check.update(COUNT * math.floor(angle / COUNT), scale * speed))
            n += 1
            if cycle % (4 * skipped) == 0:
                n += skipped
                check.skip_cycles()
        assert any(found) is wrong


def readings(seconds: float, noise: float, digit: float, every: int = 1, torque: float = 0.31) -> list[float]:
    """Return readings of a sensor at a torque held by friction.

    `noise` and `digit` are in N*m. A new value comes every `every` cycles.
    """
    count = round(seconds / PERIOD)
    noises = np.random.default_rng(6).standard_normal(count // every + 1)
    values = torque + noise * np.repeat(noises, every)[:count]
    return list(np.round(values / digit) * digit)


def learned(seconds: float, noise: float, digit: float, every: int, torque: float = 0.31) -> SensorNoise:
    """Return a check that has learned the noise in `seconds`, and then accepts it for 20 s."""
    check = SensorNoise()
    for value in readings(seconds, noise, digit, every, torque):
        check.learn(value)
    check.reset()
    assert not any(check.update(value) for value in readings(20.0, noise, digit, every, torque))
    return check


@pytest.mark.parametrize("every", [1, 2])
@pytest.mark.parametrize("noise", [5e-4, 5e-2])
def test_a_torque_sensor_whose_noise_ends_is_stuck_also_after_a_disable(noise: float, every: int) -> None:
    check = learned(0.3, noise, 1e-4, every)
    for _ in range(2):
        assert [check.update(0.2) for _ in range(200)].index(True) <= SensorNoise.REPEATED
        check.reset()


@pytest.mark.parametrize(
    ("noise", "digit", "every"),
    [(0.0, 1e-4, 1), (1e-3, 1e-2, 1), (5e-3, 1e-4, 5)],
    ids=["no noise", "a tenth of a digit", "slower than the loop"],
)
def test_a_torque_sensor_that_repeats_values_by_itself_is_not_judged(noise: float, digit: float, every: int) -> None:
    check = learned(2.0, noise, digit, every, torque=0.315)  # between two digits
    assert not any(check.update(0.2) for _ in range(5000))
