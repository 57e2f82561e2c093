"""A torque sensor proves friction only while the tendon elongation and the motor torque agree with it.

The joint is simulated as in `test_proven_friction`: an evenly bent sheath with separate equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from tests.observer.test_proven_friction import FRICTION, MODEL, PERIOD
from tsa_ctrl.observer.friction_proof import EVERY, FrictionProof, SensorEvidence
from tsa_ctrl.observer.proven_friction import MEMORY, ProvenFriction
from tsa_ctrl.observer.stretch import StretchObserver

GEARING = 0.8  # r_M/r_J
PER_STRETCH = 0.025 * 4.0 * 60e3 / 1.2  # N*m of joint torque per m of elongation, at a constant motor torque
SPEED = 1.0  # rad/s
Sensor = Callable[[float, float], float]  # joint torque and motor torque (N*m) -> sensor value (N*m)
WRONG: dict[str, Sensor] = {
    "reversed": lambda tau_j, tau_m: -tau_j,
    "reversed half": lambda tau_j, tau_m: -0.5 * tau_j,
    "unplugged": lambda tau_j, tau_m: 0.0,
    "stuck": lambda tau_j, tau_m: 0.2,
}


class Joint:
    """Simulate strokes of a joint whose load varies, with both sensors.

    Attributes: `share`: ratio of true to modelled friction. `varies`: N*m, amplitude of the load.
    """

    def __init__(self, sensor: Sensor | None, elongation: bool = True, varies: float = 0.3, mean: float = 0.0) -> None:
        observer = StretchObserver(MODEL, PERIOD, (1e-4, 1e-6))
        by_sensor = None if sensor is None else ProvenFriction(MODEL, PERIOD, 1e-4, True)
        period = PERIOD if sensor is None else EVERY * PERIOD
        by_elongation = ProvenFriction(MODEL, period, 1e-4, False, observer) if elongation else None
        evidence = SensorEvidence(FRICTION / GEARING, PERIOD, 1.0 / GEARING, (PER_STRETCH * 0.020, PER_STRETCH * 0.025))
        self.proof = FrictionProof(by_sensor, by_elongation, evidence)
        self.observed = 0.85  # of the load, by an observer with an inaccurate file
        self.sensor = sensor or (lambda tau_j, tau_m: math.nan)
        self.share, self.varies, self.mean = 1.0, varies, mean
        self.random = np.random.default_rng(4)
        self.q = 0.0

    def move(self, *ways: float) -> FrictionProof:
        """Move the joint by each of the ways (rad), and return the proof."""
        for way in ways:
            sigma = math.copysign(1.0, way)
            for _ in range(round(abs(way) / SPEED / PERIOD)):
                self.q += sigma * SPEED * PERIOD
                self._cycle(sigma)
        return self.proof

    def _cycle(self, sigma: float) -> None:
        load = self.mean + self.varies * math.sin(3.0 * self.q)
        tau_m = load * GEARING + sigma * self.share * FRICTION
        stretch = (tau_m / 0.020 + load / 0.025) / (4.0 * 60e3 / 1.2) + 2e-6 * self.random.standard_normal()
        q_m = (stretch + 0.025 * self.q) / 0.020
        shown = self.sensor(load, tau_m) + 1e-3 * self.random.standard_normal()
        estimate = self.observed * load + 0.05 + 0.01 * self.random.standard_normal()
        self.proof.compare(shown, estimate, tau_m, q_m, self.q, True, sigma * SPEED)
        self.proof.update(tau_m, sigma * SPEED / GEARING, q_m, self.q, shown, sigma * SPEED, False, FRICTION)


def correct(tau_j: float, tau_m: float) -> float:
    return tau_j


def test_a_correct_sensor_proves_friction_within_the_first_stroke_with_a_load() -> None:
    proof = Joint(correct).move(0.4)
    assert proof.confirms_sensor
    assert not proof.confirms_file  # the friction has been measured once
    assert 0.9 * FRICTION < proof.low < FRICTION < proof.high < 1.1 * FRICTION


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("mean", [0.0, 0.4])
def test_a_wrong_sensor_proves_nothing_in_the_first_direction(wrong: str, mean: float) -> None:
    joint = Joint(WRONG[wrong], mean=mean)
    for _ in range(6):
        proof = joint.move(0.2)
        assert proof.low == 0.0
        assert not proof.confirms_sensor


@pytest.mark.parametrize("sensor", [*WRONG.values(), correct], ids=[*WRONG, "correct"])
def test_without_a_load_one_direction_proves_nothing(sensor: Sensor) -> None:
    """The sensor shows a constant, as a disconnected one does. It then limits the compensation, but proves nothing."""
    assert Joint(sensor, varies=0.0).move(1.0).low == 0.0


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("share", [0.3, 0.6, 1.0])
def test_the_elongation_replaces_a_wrong_sensor_that_shows_more_friction(wrong: str, share: float) -> None:
    """The load resists the last stroke, so that a wrong sensor shows more friction than there is."""
    joint = Joint(WRONG[wrong])
    joint.share = share
    proof = joint.move(0.5, -0.5, 0.5, -0.5, 0.5)
    assert proof.contradicted
    assert not proof.confirms_sensor
    assert 0.8 * share * FRICTION < proof.low < share * FRICTION < proof.high < 1.2 * share * FRICTION


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.2, 2.0])
@pytest.mark.parametrize("share", [0.3, 1.0])
def test_a_sensor_that_follows_the_elongation_counts(gain: float, share: float) -> None:
    joint = Joint(lambda tau_j, tau_m: gain * tau_j)
    joint.share = share
    for _ in range(4):
        proof = joint.move(0.5, -0.5)
        assert proof.confirms_sensor
        assert not proof.contradicted
    assert proof.confirms_file


@pytest.mark.parametrize("observed", [0.0, -0.5])
@pytest.mark.parametrize("sensor", [*WRONG.values(), correct], ids=[*WRONG, "correct"])
def test_the_elongation_itself_decides_if_the_observer_is_wrong(sensor: Sensor, observed: float) -> None:
    """The joint reverses within a second, so that motor torque and joint torque do not change in proportion."""
    joint = Joint(sensor)
    joint.observed = observed
    joint.move(0.3, -0.3, 0.3, -0.3)
    assert joint.proof.evidence.follows is (sensor is correct)


def test_a_sensor_that_is_plugged_in_again_counts_again() -> None:
    joint = Joint(correct)
    assert not joint.move(0.5, -0.5, 0.5, -0.5, 0.5).contradicted
    joint.sensor = WRONG["unplugged"]
    assert joint.move(-0.5, 0.5, -0.5, 0.5).contradicted
    joint.sensor = correct
    assert joint.move(-0.5, 0.5).confirms_sensor


def test_a_long_motion_in_one_direction_ends_the_proof_of_a_sensor_that_shows_no_change() -> None:
    """The zero of the elongation may depend on the angle, and the sensor was last compared long ago."""
    joint = Joint(correct)
    assert joint.move(0.5, -0.5, 0.5, -0.5).low > 0.8 * FRICTION
    joint.sensor, joint.varies = WRONG["unplugged"], 0.0
    assert joint.move(40.0).low == 0.0


def test_a_sensor_without_an_elongation_counts_alone() -> None:
    proof = Joint(correct, elongation=False, varies=0.0).move(0.3)
    assert proof.confirms_sensor
    assert proof.low > 0.9 * FRICTION


def test_an_axis_without_sensors_proves_nothing() -> None:
    proof = Joint(None, elongation=False).move(0.3, -0.3)
    assert not proof.usable
    assert (proof.low, proof.middle, proof.high) == (0.0, math.inf, math.inf)


def test_a_reset_forgets_the_comparison() -> None:
    joint = Joint(correct)
    assert joint.move(0.4).confirms_sensor
    joint.proof.reset()
    assert not joint.proof.confirms_sensor
    assert (joint.proof.low, joint.proof.high) == (0.0, math.inf)


def compared(
    evidence: SensorEvidence, sensor: Sensor, motor: Callable[[float], float], way: float, sliding: int
) -> None:
    """Compare for `way` rad at 1 rad/s while the elongation shows nothing; `motor`: change of its torque by angle."""
    random = np.random.default_rng(8)
    for cycle in range(round(way / SPEED / PERIOD)):
        tau_m = FRICTION + motor(cycle * SPEED * PERIOD)
        shown = sensor((tau_m - FRICTION) / GEARING, tau_m) + 5e-3 * random.standard_normal()
        evidence.update(shown, 0.0, tau_m, 0.0, 0.0, False, SPEED, sliding)


def falls(way: float) -> float:
    """Return the change of the motor torque (N*m) when a third of the friction term fades out within 0.1 rad."""
    return -FRICTION / 3.0 * min(1.0, max(0.0, (way - 0.3) / 0.1))


@pytest.mark.parametrize("sliding", [1, 0])
@pytest.mark.parametrize("sensor", [*WRONG.values(), correct], ids=[*WRONG, "correct"])
def test_only_a_correct_sensor_follows_the_motor_while_the_tendons_slide(sensor: Sensor, sliding: int) -> None:
    """The motor torque does not reach the joint unless the tendons slide, so this is no evidence."""
    evidence = SensorEvidence(FRICTION / GEARING, PERIOD, 1.0 / GEARING)
    compared(evidence, sensor, falls, 0.5, sliding)
    assert evidence.follows is (sensor is correct and sliding != 0)


@pytest.mark.parametrize("wrong", sorted(WRONG))
def test_a_sensor_that_fails_while_the_tendons_slide_stops_counting_before_its_proof_fades(wrong: str) -> None:
    """The proof by earlier changes lasts for 1.5 rad. The step of the failure itself is forgotten earlier."""
    evidence = SensorEvidence(FRICTION / GEARING, PERIOD, 1.0 / GEARING)
    compared(evidence, correct, lambda way: 0.5 * FRICTION * math.sin(6.0 * way), 1.0, 1)
    assert evidence.follows
    compared(evidence, WRONG[wrong], lambda way: 0.5 * FRICTION * math.sin(6.0 * (way + 1.0)), 0.65, 1)
    assert not evidence.follows


@pytest.mark.parametrize("shown", [1.0, 0.0], ids=["correct", "unplugged"])
def test_a_correct_sensor_is_not_contradicted_by_friction_that_grows_with_the_velocity(shown: float) -> None:
    """The motor then needs more torque at a higher velocity, and the joint receives the same."""
    evidence = SensorEvidence(FRICTION / GEARING, PERIOD, 1.0 / GEARING)
    compared(evidence, correct, falls, 1.0, 1)
    random = np.random.default_rng(9)
    for cycle in range(round(1.0 / PERIOD)):
        omega = SPEED * (1.0 + 0.8 * math.sin(10.0 * cycle * PERIOD))
        load = 0.0 if shown == 1.0 else 0.3 * FRICTION * math.sin(23.0 * cycle * PERIOD)
        tau_m = FRICTION * (2.0 / 3.0 + 0.5 * (omega - SPEED)) + load
        evidence.update(5e-3 * random.standard_normal(), 0.0, tau_m, 0.0, 0.0, False, omega, 1)
    assert evidence.follows is (shown == 1.0)


def test_noise_at_the_begin_of_a_stroke_is_no_evidence() -> None:
    """Two samples always have a correlation of 1 or -1."""
    evidence = SensorEvidence(FRICTION / GEARING, PERIOD, 1.0 / GEARING)
    for stroke in range(200):
        compared(
            evidence, WRONG["unplugged"], lambda way: 0.5 * FRICTION * math.sin(50.0 * way), 0.06, 1 - stroke % 2 * 2
        )
        assert not evidence.follows


def test_a_proof_fades_gradually_while_there_is_nothing_to_follow() -> None:
    """A step of the whole friction term would pull the joint, although the sensor is correct."""
    evidence = SensorEvidence(FRICTION / GEARING, PERIOD, 1.0 / GEARING)
    compared(evidence, correct, falls, 0.5, 1)
    weights = []
    for _ in range(20):
        compared(evidence, correct, lambda way: 0.0, 0.1 * MEMORY, 0)
        weights.append(evidence.weight)
    assert weights[:3] == [1.0, 1.0, 1.0]
    assert weights[-1] == 0.0
    assert max(-np.diff(weights)) < 0.11
    assert np.mean(weights) == pytest.approx(0.5, abs=0.1)  # as much as a sudden end after `MEMORY`
