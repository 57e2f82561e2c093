"""The friction term of the law compared with a small model of it, for any sequence of motion, requests and limits.

The model has the equations of the module's docstring. It knows the law only by its inputs, direction and velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.laws import COUNT, PERIOD
from tests.control.laws import law as make
from tests.control.sliding import actuator
from tests.control.test_law import RATIO, Friction
from tsa_ctrl.control.law import Law
from tsa_ctrl.control.motion_filter import Motion


@dataclass
class Model:
    """The friction term (N*m at the motor), the fade-in, the settled share and the share that a client wants."""

    compensation: float
    fade_in: float
    settle: float
    slew: float
    term: float = 0.0
    fade: float = 0.0
    settled: float = 0.0
    wanted: float = 1.0

    def update(self, friction: float, bound: float, back_off: float) -> float:
        """Return the term for a friction of `friction` N*m with its sign."""
        self.fade = min(1.0, self.fade + (PERIOD / self.fade_in if self.fade_in else 1.0))
        share = min(self.compensation, bound) * self.fade * back_off * (1.0 - self.settle * self.settled) * self.wanted
        step = self.slew * PERIOD if back_off == 1.0 else math.inf  # the guard's action is never delayed
        self.term += min(step, max(-step, share * friction - self.term))
        return self.term

    def rest(self, rate: float, velocity: float, silent: bool) -> None:
        """Settle within 0.3 s at a constant set-point and almost no motion, and return five times as fast."""
        step = PERIOD / 0.3
        calm = abs(rate) < 0.02 and abs(velocity) < 0.5
        self.settled += step * (1.0 - self.settled) if calm else -5.0 * step * self.settled
        self.wanted = max(0.0, self.wanted - step) if silent else min(1.0, self.wanted + 5.0 * step)

    def applied(self, left: float) -> None:
        """Continue from the term that a limit has cut. A limit never changes its sign and never increases it."""
        self.term = math.copysign(min(abs(self.term), max(0.0, left * math.copysign(1.0, self.term))), self.term)


PIECES = st.fixed_dictionaries(
    {
        "cycles": st.integers(1, 40),
        "speed": st.sampled_from([-1.5, -0.45, 0.45, 1.5]),  # rad/s
        "wanted": st.sampled_from([-2.0, -0.4, 0.0, 0.3, 1.0]),  # N*m
        "back_off": st.sampled_from([1.0, 1.0, 0.5, -0.5]),
        "bound": st.sampled_from([math.inf, 0.75, 0.3, 0.0]),
        "rate": st.sampled_from([0.0, 0.0199, -0.0201, 3.0]),  # N*m/s
        "silent": st.sampled_from([False, False, True]),
        "cut": st.sampled_from([None, None, 0.9, 0.5, 0.0, -0.3]),  # share of the command that a limit leaves
        "reset": st.sampled_from([False, False, False, True]),
    }
)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(PIECES, min_size=1, max_size=12),
    st.sampled_from([0.75, 1.0, 1.2]),
    st.sampled_from([0.0, 0.0035, 0.05]),
    st.sampled_from([0.0, 0.5]),
    st.sampled_from([20.0, 100.0, 1e4]),
    st.sampled_from([(5.0, 5.0), (0.5, 1.25), (math.inf, math.inf)]),
    st.sampled_from([None, 1e-4]),
)
def test_the_law_and_its_model_agree(
    pieces: list[dict[str, Any]],
    compensation: float,
    fade_in: float,
    settle: float,
    slew: float,
    limit: tuple[float, float],
    inertia: float | None,
) -> None:
    """The command is the sum of ideal torque and term, within the torques at which both tendons pull.

    The planned torque of the motor's inertia comes on top.
    """
    friction = Friction(0.5)
    friction.limit = limit
    given = {"compensation": compensation, "fade_in": fade_in, "settle": settle, "slew": slew}
    law = make(actuator(), friction, motor_inertia=inertia, damping=0.0, **given)
    model, angle, cut = Model(compensation, fade_in, settle, slew), 0.0, 0
    for piece in pieces:
        if piece["reset"]:
            law.reset()
            model = Model(compensation, fade_in, settle, slew)
            assert (law.ideal, law.friction_term, law.planned, law.beyond) == (0.0, 0.0, 0.0, False)
        law.bound = piece["bound"]
        for _ in range(piece["cycles"]):
            angle += piece["speed"] * PERIOD
            law.observe(angle, math.nan, True, math.nan, 0.0)
            found = law.update(piece["wanted"], math.nan, math.nan, 0.0, piece["back_off"])
            term = model.update(0.5 * law.sigma, piece["bound"], piece["back_off"])
            ideal = RATIO * piece["wanted"]
            assert (law.ideal, law.friction_term) == pytest.approx((ideal, term), abs=1e-12)
            within = min(limit[1], max(-limit[0], ideal + term))
            assert found == pytest.approx(within + law.planned, abs=1e-12)
            if abs(within) < min(limit) - 1e-9:
                assert not law.beyond
            cut += law.beyond
            assert law.cut == cut
            if piece["cut"] is not None:
                law.applied(piece["cut"] * found)
                model.applied(piece["cut"] * found - ideal - law.planned)
            law.update_backoff(piece["rate"], piece["silent"])
            model.rest(piece["rate"], law.velocity, piece["silent"])


def test_the_friction_torque_is_refreshed_within_64_cycles_and_with_new_parameters_at_once() -> None:
    friction = Friction(0.5)
    law = make(actuator(), friction)
    assert (law.half_loop, law.near_slack, law.notes) == (0.5, False, law.plan.notes)
    friction.size, friction.pretension = 0.75, 0.29 * friction.pretension
    for cycles, known in ((63, 0.5), (1, 0.75)):
        for _ in range(cycles):
            law.update_backoff(0.0)
        assert (law.half_loop, law.near_slack) == (known, known == 0.75)
    law.set_parameters(0.3, 4.0)
    assert law.half_loop == pytest.approx(1.2)


def test_a_motor_swings_against_its_joint_while_the_term_turns() -> None:
    law = make(actuator(), Friction(), motor_inertia=2e-4, turn=0.01)
    angle = 0.0
    for n in range(400):
        angle += (0.8 if n < 300 else -0.8) * PERIOD
        law.observe(angle, math.nan, True, math.nan, 0.0)
        turning = law.swing(3.0) > 0.0
        assert turning is law.reversal.turning
        if turning:
            assert law.swing(3.0) == pytest.approx(0.5 * 2e-4 * (3.0 - law.velocity / RATIO) ** 2)
    assert angle < 0.3


def test_without_an_encoder_the_elongation_of_the_tendons_is_no_motion_of_the_joint() -> None:
    """The joint is locked. The motor follows the ideal torque, that torque cut by a limit, and the next enable."""
    law = make(actuator(), Friction(), encoder=False, fade_in=0.0, compensation=0.0)
    left, speeds = 1.0, []
    for n in range(400):
        law.observe(math.nan, left * law.ideal / law.plan.stiffness, True, math.nan, 0.0)
        speeds.append(abs(law.velocity))
        left = 1.0 if n < 200 else 0.5
        law.applied(left * law.update(min(1.0, 0.01 * n), math.nan, math.nan, 0.0, 1.0))
        if n == 300:
            law.reset()
    assert max(speeds) < 1e-9


def test_the_damping_opposes_what_differs_from_the_plan() -> None:
    found = {}
    for damping in (None, 0.0):
        law = make(actuator(), Friction(), motor_inertia=1e-4, damping=damping, compensation=0.0)
        for _ in range(10):
            law.observe(0.0, 0.0, True, math.nan, 0.0)
            law.update(0.0, 0.0, 1.0, 0.0, 1.0)
        found[damping] = law.planned
    assert found[None] < 0.0 == found[0.0]


@pytest.mark.parametrize(("inertia", "damped"), [(1e-4, True), (1e-5, False)])
def test_a_resting_joint_is_damped_unless_the_motor_would_swing_on_tendons_that_friction_locks(
    inertia: float, damped: bool
) -> None:
    for rests in (0.0, 0.3):  # s
        planned = []
        for gain in (None, 0.0):
            law = make(actuator(), Friction(), motor_inertia=inertia, delay=4e-3, damping=gain, compensation=0.0)
            for n in range(round((0.3 + rests) / PERIOD)):
                angle = min(n * PERIOD, 0.3)
                law.observe(angle, RATIO * angle, True, math.nan, 0.0)
                law.update(0.0, RATIO * angle, 1.0, 0.0, 1.0)
            planned.append(law.planned)
        assert (planned[0] != planned[1]) is (damped or rests == 0.0)


def moved(**more: Any) -> Law:
    """Return the law of a joint that has moved for 0.3 s and stopped, at a set-point of 0.5 N*m."""
    law = make(actuator(), Friction(), fade_in=0.0, **more)
    for n in range(330):
        angle = min(n, 300) * PERIOD
        law.observe(angle, 1.25 * angle, True, 0.5, 0.0)
    return law


@pytest.mark.parametrize("ringing", [60.0, None])  # Hz
@pytest.mark.parametrize(("rests", "rested"), [(0.09, False), (0.105, True)])  # s
def test_a_reversal_at_rest_takes_two_cycles_of_the_motor_on_its_tendons(
    ringing: float | None, rests: float, rested: bool
) -> None:
    """The joint counts as resting after 0.1 s."""
    law = moved(ringing=ringing, motor_inertia=1e-4 if ringing else None, turn=0.01)
    while law.direction.rest < rests:
        law.observe(0.3, 0.375, True, 0.5, 0.0)
    opposite, cycles = 0.5 - law.direction.sigma, 0
    while (law.reversal.turning or not cycles) and cycles < 100:
        law.observe(0.3, 0.375, True, opposite, 0.0)
        cycles += 1
    seconds = 2.0 / ringing if ringing and rested else law.plan.turn
    assert cycles * PERIOD == pytest.approx(seconds, abs=1.5 * PERIOD)


def test_without_an_encoder_the_direction_waits_for_two_memories_of_the_motion_after_a_reversal() -> None:
    law = moved(encoder=False, turn=0.01)
    law.observe(math.nan, 0.375, True, 0.5 - law.direction.sigma, 0.0)
    assert law.reversal.turning
    sigma, waited = law.direction.sigma, 0
    while law.direction.sigma == sigma and waited < 100:
        waited += not law.reversal.turning
        law.observe(math.nan, 0.375, True, 0.5 - 2.0 * sigma, 0.0)
    memory = Motion(PERIOD, COUNT, law.plan.lead).memory
    assert waited * PERIOD == pytest.approx(2.0 * memory, abs=1.5 * PERIOD)
