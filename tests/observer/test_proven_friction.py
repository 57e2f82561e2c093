"""Bounds of the friction torque from the sensors of an axis.

The reference is an evenly bent sheath with separate equations. With even curvature, the mean tension difference is the
mean of both ends: 4 (EA/l) s = tau_M/r_M + tau_J/r_J. While the tendons slide, tau_J = r_J/r_M (tau_M - sigma h)
(stretch.md, to first order in x).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.observer.proven_friction import ProvenFriction
from tsa_ctrl.observer.stretch import StretchObserver

PERIOD = 1e-3
MODEL = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})
FRICTION = 2.0 * 45.0 * 0.020 * 0.26  # N*m, h = 2 T_p0 r_M x


class Joint:
    """Simulate strokes of a joint with a load, and the signals of its sensors."""

    def __init__(
        self,
        model: TendonSheath = MODEL,
        *,
        sensor: bool = False,
        zero: float = 0.0,
        radius: float = 1.0,
        seed: int = 1,
        inertia: float = 1e-4,
    ) -> None:
        observer = StretchObserver(model, PERIOD, (1e-4, 1e-6))
        self.proven = ProvenFriction(model, PERIOD, inertia, sensor, None if sensor else observer)
        self.friction = self.modelled = FRICTION
        self.zero, self.radius, self.sensor = zero, radius, sensor
        self.random = np.random.default_rng(seed)
        self.q = 0.0
        self.bends = False  # True: another joint bends the sheath, and friction changes by up to half within a stroke
        self.share = 1.0  # ratio of true to modelled friction
        self.t = 0.0

    def strokes(self, *ways: float) -> None:
        for way in ways:
            self.move(way)

    def move(self, way: float, speed: float = 1.0, turning: bool = False) -> list[tuple[float, float]]:
        """Move the joint by `way` rad and return the bounds of each cycle."""
        sigma = math.copysign(1.0, way)
        bounds = []
        for _ in range(round(abs(way) / speed / PERIOD)):
            self.q += sigma * speed * PERIOD
            self.t += PERIOD
            if self.bends:
                self.modelled = FRICTION * (1.0 + 0.5 * math.sin(9.0 * self.t))
                self.friction = self.share * self.modelled
            load = 0.3 * math.sin(3.0 * self.q) + 0.1  # N*m at the joint
            tau_m = load * 0.8 + sigma * self.friction
            elongation = (tau_m / 0.020 + load / 0.025) / (4.0 * 60e3 / 1.2) + self.zero
            elongation += 2e-6 * self.random.standard_normal()
            q_m = (elongation + 0.025 * self.radius * self.q) / 0.020
            tau_j = load if self.sensor else math.nan
            self.proven.update(tau_m, speed * sigma / 0.8, q_m, self.q, tau_j, sigma * speed, turning, self.modelled)
            bounds.append((self.proven.low, self.proven.high))
        return bounds


def test_one_direction_of_the_elongation_proves_nothing() -> None:
    """The zero of the elongation is unknown, so any friction torque fits."""
    joint = Joint(zero=3e-4)
    assert all(low == 0.0 and high > 2.0 * FRICTION for low, high in joint.move(0.6))


@pytest.mark.parametrize("zero", [-5e-4, 2e-4])
@pytest.mark.parametrize("radius", [0.99, 1.01])
@pytest.mark.parametrize("stiffness", [0.92, 1.08])
def test_both_directions_bound_the_friction(zero: float, radius: float, stiffness: float) -> None:
    """The zero, the radii and the file's stiffness may be wrong.

    The bounds contain the friction torque and stay close to it.
    """
    model = dataclasses.replace(MODEL, axial_stiffness=60e3 * stiffness)
    joint = Joint(model, zero=zero, radius=radius)
    joint.strokes(0.6, -0.6, 0.6, -0.6, 0.6)
    for low, high in joint.move(-0.6)[-300:]:
        assert 0.7 * FRICTION < low < FRICTION < high < 1.35 * FRICTION


@pytest.mark.parametrize("left", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("first", [0.6, -0.6])
def test_friction_that_is_lost_between_the_first_two_strokes_is_never_proven(left: float, first: float) -> None:
    """One stroke in each direction shows only the sum of two friction torques. The second may be all of it or nearly 0.

    The strokes after the loss agree and prove the remaining friction.
    """
    joint = Joint(zero=3e-4)
    joint.move(first)
    joint.friction = left * FRICTION
    for way in (-first, first, -first, first):
        for low, high in joint.move(way):
            assert low < left * FRICTION < high
    assert high - low < 0.15 * FRICTION


@pytest.mark.parametrize("share", [0.6, 1.0, 1.3])
def test_a_sheath_that_another_joint_bends_proves_the_ratio_of_true_to_modelled_friction(share: float) -> None:
    """The friction torque changes by up to half within each stroke, and the bounds follow it."""
    joint = Joint(zero=3e-4)
    joint.bends, joint.share = True, share
    joint.strokes(0.6, -0.6, 0.6, -0.6, 0.6)
    for way in (-0.6, 0.6):
        low, high = np.transpose(joint.move(way)[-300:])
        true = share * FRICTION * (1.0 + 0.5 * np.sin(9.0 * (joint.t - PERIOD * np.arange(299, -1, -1))))
        assert np.all(low < true)
        assert np.all(true < high)
        assert np.all(high - low < 0.7 * true)


def test_strokes_in_one_direction_do_not_confirm_each_other() -> None:
    """The joint repeats strokes in one direction. The returns between them are too short for a reading."""
    joint = Joint(zero=3e-4)
    joint.move(0.6)
    joint.friction = 0.1 * FRICTION
    for way in (-0.2, 0.01, -0.2, 0.01, -0.2):
        assert all(low < 0.1 * FRICTION for low, _ in joint.move(way))


def test_the_third_stroke_of_a_healthy_joint_proves_what_the_file_left_open() -> None:
    """The file permits 1.25^2 = 1.56 times its friction, so two strokes prove at most 2 - 1.56 = 0.44 of it."""
    joint = Joint()
    joint.move(0.6)
    low, _ = joint.move(-0.6)[-1]
    assert 0.1 * FRICTION < low < 0.44 * FRICTION
    low, _ = joint.move(0.3)[-1]
    assert low > 0.8 * FRICTION


def test_the_interval_of_a_calibration_counts_for_the_joint_that_was_tuned_only() -> None:
    """With the interval of a calibration, two strokes prove more friction.

    If the file may belong to another joint, [uncertainty] applies instead.
    """
    half_loop = abs(sliding(MODEL).half_loop)
    found = {}
    for trusted in (False, True):
        joint = Joint(dataclasses.replace(MODEL, half_loop_low=0.95 * half_loop))
        joint.proven.trusted = trusted
        joint.move(0.6)
        found[trusted], _ = joint.move(-0.6)[-1]
    assert 0.1 * FRICTION < found[False] < 0.44 * FRICTION
    assert 0.65 * FRICTION < found[True] < 0.95 * FRICTION


def test_a_joint_torque_sensor_proves_it_within_the_first_stroke() -> None:
    low, high = Joint(sensor=True).move(0.1)[-1]
    assert 0.93 * FRICTION < low < FRICTION < high < 1.07 * FRICTION


@pytest.mark.parametrize("sensor", [False, True])
@pytest.mark.parametrize("left", [0.1, 0.5])
def test_friction_that_is_lost_within_a_stroke_is_seen_within_it(sensor: bool, left: float) -> None:
    """After 0.05 rad the upper bound is close to the remaining friction.

    The bounds stay correct in the next strokes.
    """
    joint = Joint(sensor=sensor)
    joint.strokes(0.6, -0.6, 0.6, -0.6)
    joint.move(0.3)
    joint.friction = left * FRICTION
    _, high = joint.move(0.05)[-1]
    assert high < (left + 0.15) * FRICTION
    joint.move(0.25)
    for way in (-0.6, 0.6, -0.6):
        low, high = joint.move(way)[-1]
        assert low < left * FRICTION < high < (left + 0.2) * FRICTION


def test_the_swing_of_a_motor_of_unknown_inertia_moves_the_bounds_little() -> None:
    """A torque limit that followed the motor's oscillation would excite it.

    With unknown inertia the upper bound follows less than a seventh of it. A loss of friction is detected within 0.3 s.
    """
    moved = {}
    for inertia in (1e-4, 0.0):
        joint = Joint(sensor=True, inertia=inertia)
        joint.move(0.6, speed=3.0)
        highs = []
        for n in range(600):
            joint.friction = FRICTION + 0.1 * math.sin(2.0 * math.pi * 42.0 * n * PERIOD)
            highs.append(joint.move(0.003, speed=3.0)[-1][1])
        moved[inertia] = max(highs[300:]) - min(highs[300:])
    assert moved[0.0] < 0.2 / 7.0 < moved[1e-4]
    joint.friction = 0.1 * FRICTION
    _, high = joint.move(0.9, speed=3.0)[-1]
    assert high < 0.25 * FRICTION


def test_a_reversal_and_a_turning_term_are_no_reading() -> None:
    """The friction front must first pass through the sheath.

    Until then, and while the friction term turns, the bounds do not change.
    """
    joint = Joint(sensor=True)
    joint.move(0.3)
    before = joint.proven.low, joint.proven.high
    joint.friction = 0.0
    assert joint.move(-0.015) == [before] * 15
    assert not joint.proven.reads
    assert joint.move(-0.1, turning=True) == [before] * 100
    assert joint.move(-0.1)[-1] != before


@pytest.mark.parametrize("more", [0.7, 1.4])
def test_a_reading_holds_at_another_wrap_angle(more: float) -> None:
    """Another joint bends the sheath. Friction and model change by the same ratio, and the bounds follow."""
    joint = Joint(sensor=True)
    joint.move(0.3)
    before = joint.proven.low, joint.proven.high
    joint.friction = joint.modelled = more * FRICTION
    after = joint.move(-0.01)[-1]
    assert not joint.proven.reads
    assert after == pytest.approx((more * before[0], more * before[1]))
    joint.friction = 0.5 * FRICTION  # a loss of friction is still detected
    assert joint.move(-0.2)[-1][1] < 0.6 * FRICTION


def test_a_joint_that_rests_shows_nothing_and_forgets_nothing() -> None:
    joint = Joint(sensor=True)
    joint.move(0.3)
    before = joint.proven.low
    for _ in range(1000):
        joint.proven.update(0.0, 0.0, 0.0, joint.q, 0.0, 0.0, False, FRICTION)
    assert joint.proven.low == before
    assert not joint.proven.reads


def test_the_zero_is_kept_over_a_disable_and_lost_in_a_long_gap() -> None:
    joint = Joint(zero=4e-4)
    joint.strokes(0.6, -0.6, 0.6, -0.6)
    joint.proven.pause()
    assert joint.move(0.1)[-1][0] > 0.7 * FRICTION
    joint.proven.miss(2.0)
    assert joint.move(-0.1)[-1][0] == 0.0


def test_a_tendon_that_slips_on_its_pulley_makes_it_begin_again() -> None:
    """The slip changes the zero of the elongation, so no stroke agrees with the earlier ones."""
    joint = Joint()
    joint.strokes(0.6, -0.6, 0.6, -0.6)
    joint.zero = 4e-3
    joint.strokes(*(0.6, -0.6) * 6)
    low, high = joint.move(0.3)[-1]
    assert low < FRICTION < high < 1.35 * FRICTION


def test_without_a_sensor_at_the_joint_nothing_is_proven() -> None:
    proven = ProvenFriction(MODEL, PERIOD, 0.0, False, None)
    proven.update(0.5, 1.0, 1.0, 1.0, math.nan, 1.0, False, FRICTION)
    assert (proven.usable, proven.low, proven.high) == (False, 0.0, math.inf)
