"""Test the feedforward law: ideal torque, friction term, fade-in, reversals and limits."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.laws import PERIOD
from tests.control.laws import law as make
from tests.control.sliding import actuator
from tests.model.capstan import Pair
from tsa_ctrl.control.law import Law
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.steady_sliding import motor_stiffness, sliding

RATIO = 0.8
SHAPES = {  # profile name or points (share of length, share of wrap angle) for the capstan equation
    "motor_end": ((0.0, 1.0), (1.0, 1.0)),
    "uniform": ((1.0, 1.0),),
    "joint_end": ((1.0, 0.0), (1.0, 1.0)),
    "last tenth": ((0.9, 0.0), (1.0, 1.0)),
}
UNIFORM = actuator().with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})


class Friction:
    """An inverse with constant friction of `size` N*m in the direction of sigma."""

    friction_angle, pretension, clipped = 0.26, 45.0, False
    notes: tuple[str, ...] = ()

    def __init__(self, size: float = 0.5) -> None:
        self.size = size
        self.resets = 0
        self.limit = 5.0, 5.0  # N*m, limits below and above 0

    def update(self, tau_j_des: float, sigma: float, *others: float, t: float = math.nan) -> float:
        return tau_j_des * RATIO + self.size * sigma

    def half_loop(self) -> float:
        return self.size

    def domain(self) -> tuple[float, float]:
        return -self.limit[0], self.limit[1]

    def reset(self) -> None:
        self.resets += 1

    def set(self, friction_angle: float | None = None, pretension: float | None = None, imbalance: float = 0.0) -> None:
        self.size = (friction_angle or 0.0) * (pretension or 0.0)


def law_of(size: float = 0.5, **settings: Any) -> Law:
    return make(actuator(), Friction(size), **{"fade_in": 0.0, "settle": 0.0, **settings})


class Joint:
    """A joint that moves at constant speed and calls the law once per period."""

    def __init__(self, law: Law, speed: float = 1.0) -> None:
        self.law = law
        self.speed = speed
        self.angle = self.t = 0.0

    def step(self, wanted: float = 0.0, back_off: float = 1.0) -> float:
        self.t += PERIOD
        self.angle += self.speed * PERIOD
        self.law.observe(self.angle, math.nan, True, wanted, 0.0)
        return self.law.update(wanted, math.nan, math.nan, self.t, back_off)

    def settled(self, wanted: float = 0.0, back_off: float = 1.0) -> float:
        for _ in range(200):
            found = self.step(wanted, back_off)
        return found


def test_adds_the_compensated_share() -> None:
    """When settled, the command is tau_J* r_M/r_J plus the factor times the friction term."""
    joint = Joint(law_of(compensation=0.9))
    assert joint.settled(1.0) == pytest.approx(0.8 + 0.45)
    assert (joint.law.ideal, joint.law.friction_term) == pytest.approx((0.8, 0.45))
    joint.speed = -1.0
    assert joint.settled(1.0) == pytest.approx(0.8 - 0.45)


def test_without_a_direction_there_is_no_friction_term() -> None:
    """If the joint has not moved and the set-point has not changed, the command is the ideal torque only."""
    law = law_of()
    for _ in range(100):
        law.observe(0.3, math.nan, True, math.nan, 0.0)
        assert law.update(0.4, math.nan, math.nan, 1.0, 1.0) == pytest.approx(0.32)


def test_a_reversal_turns_the_term_within_the_turn() -> None:
    """The reversal of the term is monotonic and takes its configured duration, within one period."""
    law = law_of(compensation=1.0, turn=0.010)
    joint = Joint(law)
    joint.settled()
    joint.speed = -1.0
    terms = [joint.step() for _ in range(40)]
    assert all(after <= before + 1e-12 for before, after in itertools.pairwise(terms))
    turning = [term for term in terms if -0.499 < term < 0.499]
    assert len(turning) in (9, 10, 11)
    assert terms[-1] == pytest.approx(-0.5)


def test_ideal_part_is_not_slewed() -> None:
    """The slew limit applies only to the friction term, so the ideal torque follows the set-point immediately."""
    law = law_of(0.0, slew=1.0)
    law.observe(0.0, math.nan, True, 2.0, 0.0)
    assert law.update(2.0, math.nan, math.nan, 0.0, 1.0) == pytest.approx(1.6)


def test_continues_from_what_was_applied() -> None:
    """A friction term that the limiter has reduced continues from the reduced value, with the slew limit."""
    joint = Joint(law_of(compensation=1.0, slew=50.0))
    joint.settled()
    joint.law.applied(0.2)
    assert joint.step() == pytest.approx(0.25)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.05, 1.2),
    st.sampled_from(sorted(SHAPES)),
    st.sampled_from([1.0, -1.0]),
    st.floats(-0.99, 0.99),
)
def test_inverts_the_capstan_equation_wherever_both_tendons_pull(x: float, shape: str, way: float, load: float) -> None:
    """It holds for any friction angle, profile, direction and load up to the torque at which a tendon goes slack."""
    points = SHAPES[shape]
    pair = Pair(points, x, axial_stiffness=6e3)
    t1, t3 = pair.motor_tensions(0.0, way)
    per_torque = pair.motor_tensions(1.0, way)[1] - t3  # N per N*m; the change of T1 is smaller by 1/r_M
    bound = t1 / (1.0 / pair.motor_radius - per_torque) if load > 0.0 else t3 / per_torque
    wanted = pair.joint_torque(load * bound, way)
    profile = "uniform" if shape == "uniform" else [[0.0, 0.0], *(list(point) for point in points)]
    effects = {"elongation_coupling": {"curvature_profile": profile}}
    model = dataclasses.replace(actuator(), friction_coefficient=x / 2.6).with_effects(effects)
    joint = Joint(make(model, Feedforward(model, PERIOD), fade_in=0.0, settle=0.0, compensation=1.0), way)
    tau_m = joint.settled(wanted)
    assert not joint.law.beyond
    assert pair.joint_torque(tau_m, way) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_reports_a_set_point_whose_exact_inverse_is_clipped(sign: float) -> None:
    """The ideal torque of 1.92 N*m is within the domain of 2.04 N*m, but with the friction term it exceeds the domain.

    The command is limited to the domain, and `beyond` is set.
    """
    joint = Joint(make(UNIFORM, Feedforward(UNIFORM, PERIOD), fade_in=0.0, compensation=1.0), sign)
    tau_m = joint.settled(sign * 2.4)
    assert joint.law.beyond
    assert sign * tau_m == pytest.approx(sign * joint.law.domain[1 if sign > 0.0 else 0])
    joint.settled(sign * 1.0)
    assert not joint.law.beyond


def test_what_is_not_finite_reaches_the_limiter() -> None:
    """For a set-point that is not a number, the law returns nan, which the limiter handles."""
    law = law_of()
    law.observe(0.0, math.nan, True, math.nan, 0.0)
    assert math.isnan(law.update(math.nan, 0.0, 0.0, 0.0, 1.0))


INERTIA = 1e-4


def planned(compensation: float) -> tuple[np.ndarray, Law]:
    """Return the planned torques (60,) of a joint that reverses at constant speed, and the law."""
    law = make(UNIFORM, fade_in=0.0, settle=0.0, compensation=compensation, damping=0.0, motor_inertia=INERTIA)
    joint = Joint(law, 1.0)
    joint.settled()
    joint.speed = -1.0
    found = []
    for _ in range(60):
        joint.step()
        found.append(law.planned)
    return np.array(found), law


def test_a_turn_moves_the_motor_by_its_stretch_and_leaves_it_at_rest() -> None:
    """After a reversal the motor is at rest and has moved by s_c 2 h/K, which is h/K for even curvature.

    h is the friction torque and K the stiffness. The tolerance covers a start of the reversal within a period. Without
    the friction term, the motor is moved with the joint only.
    """
    (turned, law), (carried, _) = planned(1.0), planned(0.0)
    speed = np.cumsum(turned - carried) / INERTIA * PERIOD
    angle = np.cumsum(speed) * PERIOD
    way = -sliding(UNIFORM).motor_half_loop / motor_stiffness(UNIFORM)
    assert speed[-1] == pytest.approx(0.0, abs=0.05 * np.abs(speed).max())
    assert angle[-1] == pytest.approx(way, rel=0.08)
    assert np.count_nonzero(turned - carried) * PERIOD == pytest.approx(law.plan.turn, abs=2.0 * PERIOD)


def test_without_an_encoder_the_motor_stands_in_for_the_joint() -> None:
    """Without a joint encoder, the motor angle replaces the joint angle.

    The motor's additional motion during a reversal causes no second reversal.
    """
    law = make(UNIFORM, encoder=False, fade_in=0.0, compensation=1.0)
    stretch = sliding(UNIFORM).motor_half_loop / motor_stiffness(UNIFORM)
    sigmas = []
    for n in range(600):
        joint = 0.3 - abs(0.3 - n * PERIOD)
        angle = joint / RATIO + 0.5 * stretch * law.reversal.stretch
        law.observe(math.nan, angle, True, 0.0, 0.0)
        law.update(0.0, angle, math.nan, n * PERIOD, 1.0)
        sigmas.append(law.direction.sigma)
    assert np.count_nonzero(np.diff(sigmas)) == 2
    assert sigmas[250] == 1.0
    assert sigmas[-1] == -1.0


@pytest.mark.parametrize("every", [2, 5])
def test_periods_without_a_cycle_change_no_velocity(every: int) -> None:
    """If the law gets the number of skipped periods, its velocity is correct.

    Regression test: if every second cycle was skipped, the velocity was twice its value.
    """
    moving, counting = law_of(), law_of()
    for n in range(0, 600, every):
        q = 0.3 * math.sin(2.0 * math.pi * n * PERIOD)
        for law, told in ((moving, every - 1), (counting, 0)):
            law.observe(q, 1.25 * q, True, math.nan, 0.0)
            law.skip_cycles(told)
    true = 0.3 * 2.0 * math.pi * math.cos(2.0 * math.pi * 600 * PERIOD)
    assert moving.velocity == pytest.approx(true, rel=0.03)
    assert abs(counting.velocity) > 1.5 * abs(true)


@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_a_sensor_that_misses_torque_at_rest_raises_the_term_in_steps(friction: float) -> None:
    """A torque sensor that measures an excess torque at rest changes the friction term in small steps.

    A model without friction has no term, and no division by zero occurs.
    """
    model = actuator()
    model = model.recalibrated(friction * model.friction_angle, model.pretension)
    made = make(model, fade_in=0.0, compensation=1.0, settle=0.0, unsure=0.04)
    terms = []
    for n in range(700):
        wanted = 0.5 - 0.05 * min(1.0, max(0.0, (n - 300) * PERIOD / 0.02))
        made.observe(0.0, 0.0, True, wanted, 0.0)
        if n > 400:
            made.direction.measure(0.3, False)
        made.update(wanted, 0.0, 0.0, n * PERIOD, 1.0)
        terms.append(made.friction_term)
    change = terms[410] - terms[-1]
    assert change >= 0.0
    assert (change > 0.2 * made.half_loop) is (friction > 0.0)
    assert np.abs(np.diff(terms[410:])).max() < 0.05 * made.half_loop + 1e-12
