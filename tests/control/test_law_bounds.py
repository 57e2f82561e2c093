"""Test the terms of the law with prescribed parts, so that the exact output is known."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from tests.control.laws import Told, plan
from tests.control.sliding import actuator
from tests.control.test_law import Friction
from tsa_ctrl.control import law as module
from tsa_ctrl.control.damping import Damping
from tsa_ctrl.control.direction import Direction
from tsa_ctrl.control.law import Law
from tsa_ctrl.control.motion_filter import Motion
from tsa_ctrl.control.reversal import FrictionReversal, ReversalFront, ReversalSlip
from tsa_ctrl.control.settings import DirectionSettings, LawSettings

PERIOD = 1e-3
RADII = (0.02, 0.025)  # m
RATIO = 0.8
FRONT = ReversalFront(((0.0, 0.0), (1.0, 1.0)))  # even curvature: s_c 0.5
RINGING, TURN = 600.0, 0.01  # rad/s, s
PLAN = replace(
    plan(actuator()), delay=0.004, stiffness=25.0, front=FRONT, notes=("a plan's",), ringing=RINGING, turn=TURN
)


class Way(Direction):
    """A prescribed direction that records its inputs."""

    forgot = 0  # calls

    def __init__(self, motion: Motion) -> None:
        super().__init__(DirectionSettings(), motion, 0.0, 1.0, RADII[1], PERIOD)
        self.asked: list[tuple[float, float]] = []
        self.next = 0.0

    @property
    def missing(self) -> float:
        return 0.0

    def update(self, ahead: float, rate: float) -> float:
        self.asked.append((ahead, rate))
        self.sigma = self.next
        return self.sigma

    def forget(self) -> None:
        self.forgot += 1


class Turned(FrictionReversal):
    """A prescribed reversal that records its inputs."""

    def __init__(self) -> None:
        super().__init__(PLAN.front, 0.01, PERIOD)
        self.asked: list[tuple[float, float]] = []
        self.slower: list[float] = []

    def update(self, sigma: float, age: float = 0.0, slower: float = 1.0) -> None:
        self.asked.append((sigma, age))
        self.slower.append(slower)


class Fronts(ReversalSlip):
    """Prescribed slip fronts. The elongation equals the one of sliding tendons."""

    resets = slides = 0  # calls

    def __init__(self) -> None:
        super().__init__(PLAN.front, 0.02, 0.025, PLAN.stiffness, PERIOD)
        self.said = 0.0
        self.asked: list[tuple[float, ...]] = []

    def reset(self, sigma: float) -> None:
        super().reset(sigma)
        self.resets += 1

    def slide(self, sigma: float) -> None:
        super().slide(sigma)
        self.slides += 1

    def begin(self, sigma: float, tau_m: float, x: float, pretension: float) -> None:
        self.asked.append((sigma, tau_m, x, pretension))

    def update(self, tau_j: float, x: float, pretension: float, turn: FrictionReversal) -> None:
        super().update(tau_j, x, pretension, turn)
        self.asked.append((tau_j, x, pretension))
        self.torque += self.said


class Damper(Damping):
    """A prescribed damping torque that records its inputs."""

    resets = passed = 0  # calls

    def __init__(self, gives: float = 0.0) -> None:
        super().__init__(0.0, 0.0, 0.0, 1.25, PERIOD)
        self.gives = gives
        self.asked: list[tuple[float, ...]] = []

    def update(self, planned: float, q_m: float, omega_m: float, q_j: float, omega_j: float) -> float:
        self.asked.append((planned, q_m, omega_m, q_j, omega_j))
        return self.gives

    def reset(self) -> None:
        super().reset()
        self.resets += 1

    def skip_cycles(self) -> None:
        self.passed += 1


class Inverse(Friction):
    """An inverse with constant friction that records its inputs."""

    def __init__(self, size: float = 0.5) -> None:
        super().__init__(size)
        self.asked: list[tuple[float, ...]] = []
        self.sets: list[tuple[float | None, float | None]] = []
        self.notes = ("an inverse's",)

    def update(self, *asked: float, t: float = math.nan) -> float:
        self.asked.append((*asked[:5], t))  # without the temperature
        return super().update(*asked)

    def set(self, friction_angle: float | None = None, pretension: float | None = None, imbalance: float = 0.0) -> None:
        self.sets.append((friction_angle, pretension))


class Parts:
    """A law whose parts are all prescribed."""

    def __init__(self, encoder: bool | None = True, size: float = 0.5, **settings: Any) -> None:
        own = {name: settings.pop(name) for name in ("inertia", "damping") if name in settings}
        chosen = LawSettings(**{"fade_in": 0.0, "settle": 0.0, "compensation": 1.0, **settings})
        self.motion = Told()
        self.way = Way(self.motion)
        self.inverse = Inverse(size)
        more = {} if encoder is None else {"has_encoder": encoder}
        planned = replace(PLAN, **{"inertia": 0.0, "damping": 0.0, **own})
        self.law = Law(self.inverse, RADII, chosen, planned, self.motion, self.way, PERIOD, **more)
        self.law.reversal = self.turn = Turned()
        self.law.damping = self.damper = Damper()
        self.law._slip = self.fronts = Fronts()

    def ask(self, wanted: float = 0.0, q_m: float = 0.0, omega_m: float = 0.0, back_off: float = 1.0) -> float:
        return self.law.update(wanted, q_m, omega_m, 0.25, back_off)


def settled(parts: Parts, cycles: int, rate: float = 0.0, silent: bool = False) -> float:
    """Return the friction term after `cycles` cycles."""
    for _ in range(cycles):
        parts.ask(0.5)
        parts.law.update_backoff(rate, silent)
    parts.ask(0.5)
    return parts.law.friction_term


def test_a_new_law_has_given_nothing() -> None:
    parts = Parts(compensation=0.75, slew=125.0)
    law = parts.law
    assert (law.ideal, law.friction_term, law.planned, law.cut) == (0.0, 0.0, 0.0, 0)
    assert (law.beyond, law.near_slack, law.bound) == (False, False, math.inf)
    assert (law.compensation, law.slew, law.plan.delay) == (0.75, 125.0, 0.004)
    assert law.notes == ("a plan's", "an inverse's")
    assert (law.half_loop, law.domain, law.pretension, law.sigma) == (0.5, (-5.0, 5.0), 45.0, 0.0)
    assert parts.inverse.resets == 1
    assert parts.way.forgot >= 1
    parts.motion.velocity = 0.75
    parts.turn.force = -0.25
    assert (law.velocity, law.sigma) == (0.75, -0.25)
    made = Law(parts.inverse, RADII, LawSettings(), PLAN, parts.motion, parts.way, PERIOD)
    assert (made.reversal.duration, made.damping.gain) == (PLAN.turn, PLAN.damping)


def test_turn_and_damping_are_made_as_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reversal, damping and slip fronts are built with the values of the plan, the radii (m) and the period (s)."""
    seen: dict[str, tuple[object, ...]] = {}

    def keep(name: str, real: type) -> Any:
        def make(*given: object) -> Any:
            seen[name] = given
            return real(*given)

        return make

    for name, real in (("FrictionReversal", FrictionReversal), ("Damping", Damping), ("ReversalSlip", ReversalSlip)):
        monkeypatch.setattr(module, name, keep(name, real))
    motion = Told()
    Law(Inverse(), RADII, LawSettings(), PLAN, motion, Way(motion), PERIOD)
    assert seen["FrictionReversal"] == (PLAN.front, PLAN.turn, PERIOD)
    assert seen["Damping"] == (PLAN.damping, PLAN.ringing, PLAN.delay, 1.25, PERIOD)
    assert seen["ReversalSlip"] == (PLAN.front, 0.02, 0.025, PLAN.stiffness, PERIOD)


def test_the_inverse_is_asked_for_the_joint_when_the_torque_acts() -> None:
    parts = Parts()
    parts.motion.velocity, parts.motion.acceleration, parts.motion.angle = 0.5, 20.0, 0.3
    parts.turn.force = 0.25
    parts.ask(1.5, 0.7, 3.0)
    angles = 0.3 + 0.004 * 0.5, 0.7 + 0.004 * 3.0
    assert parts.inverse.asked[-1] == pytest.approx((1.5, 0.25, 0.5 + 0.004 * 20.0, *angles, 0.25))
    assert parts.ask(1.5, 0.7) == pytest.approx(1.5 * RATIO + 0.125)
    assert parts.law.ideal == pytest.approx(1.2)


@pytest.mark.parametrize(("bound", "share"), [(math.inf, 0.75), (0.75, 0.75), (0.5, 0.5)])
def test_the_share_is_bounded_faded_and_backed_off(bound: float, share: float) -> None:
    parts = Parts(compensation=0.75)
    parts.law.bound = bound
    parts.turn.force = 1.0
    parts.ask(0.4)
    assert parts.law.friction_term == pytest.approx(0.5 * share)
    parts.ask(0.4, back_off=-0.5)
    assert parts.law.friction_term == pytest.approx(-0.25 * share)


def test_the_fade_in_takes_its_time_and_no_more() -> None:
    parts = Parts(fade_in=0.004)
    parts.turn.force = 1.0
    found = []
    for _ in range(6):
        parts.ask()
        found.append(parts.law.friction_term)
    assert found == pytest.approx([0.125, 0.25, 0.375, 0.5, 0.5, 0.5])
    odd = Parts(fade_in=0.0035)
    odd.turn.force = 1.0
    for _ in range(8):
        odd.ask()
    assert odd.law.friction_term == 0.5
    longer = Parts(fade_in=10.0)
    longer.turn.force = 1.0
    longer.ask()
    assert longer.law.friction_term == pytest.approx(0.5e-4)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_term_slews_both_ways(way: float) -> None:
    parts = Parts(slew=100.0)
    parts.turn.force = way
    found = []
    for _ in range(7):
        parts.ask(0.5)
        found.append(parts.law.friction_term)
    assert found == pytest.approx([way * 0.1 * n for n in (1, 2, 3, 4, 5, 5, 5)])


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_ideal_and_term_stay_within_the_domain(way: float) -> None:
    parts = Parts()
    parts.inverse.limit = (0.5, 1.25) if way > 0.0 else (1.25, 0.5)  # the bound of the other direction does not count
    parts.turn.force = way
    assert parts.ask(way * 0.9375) == way * 1.25  # 0.75 and 0.5: exactly at the limit
    assert (parts.law.beyond, parts.law.cut) == (False, 0)
    assert parts.ask(way * 0.95) == way * 1.25
    assert parts.ask(way * 4.0) == way * 1.25
    assert (parts.law.beyond, parts.law.cut) == (True, 2)
    parts.inverse.limit = math.nan, math.nan
    assert parts.ask(way * 4.0) == pytest.approx(way * 3.7)
    assert (parts.law.beyond, parts.law.cut) == (False, 2)
    parts.law.beyond = True
    parts.law.reset()
    assert (parts.law.beyond, parts.law.cut) == (False, 2)


def test_the_torque_of_the_fronts_belongs_to_the_friction_term() -> None:
    parts = Parts()
    parts.turn.force, parts.fronts.said = 0.5, -0.125
    parts.ask(0.4)
    assert parts.law.friction_term == pytest.approx(0.25 - 0.125)
    assert parts.fronts.asked == [(0.4, 0.26, 45.0)]


def test_the_motor_is_moved_by_what_the_tendons_stretch() -> None:
    """The planned motor motion contains the elongation by the ideal torque (1/25 rad per N*m) and by the friction term.

    The back-off factor of the guard scales only the part of the friction term.
    """
    parts = Parts(inertia=2e-4)
    parts.motion.acceleration = 16.0
    parts.turn.force = parts.turn.stretch = 0.5
    parts.turn.bend = 3e4
    parts.ask(1.0)
    stretch, bend = parts.fronts.stretch, parts.fronts.bend
    assert parts.law.planned == pytest.approx(2e-4 * (bend + 16.0 / RATIO))
    assert parts.law._stretch == pytest.approx(stretch)
    parts.ask(1.0, back_off=0.5)
    assert parts.law.planned == pytest.approx(2e-4 * (0.5 * bend + 16.0 / RATIO))
    assert parts.law._stretch == pytest.approx(0.5 * (stretch + 0.8 / 25.0))


def test_without_an_inertia_nothing_is_planned_and_nothing_damped() -> None:
    parts = Parts(damping=0.5)
    parts.motion.acceleration = 16.0
    parts.ask(1.0)
    assert (parts.law.planned, parts.damper.asked) == (0.0, [])


def test_what_differs_from_the_plan_is_damped() -> None:
    parts = Parts(inertia=2e-4, damping=0.5)
    parts.motion.angle, parts.motion.velocity = 0.3, 0.75
    parts.damper.gives = 0.0625
    assert parts.ask(1.0, 0.7, 0.9) == pytest.approx(0.8 + 0.0625)
    assert parts.law.planned == 0.0625
    assert parts.damper.asked == [pytest.approx((parts.fronts.stretch, 0.7, 0.9, 0.3, 0.75))]


def test_a_reset_forgets_all_but_the_joints_motion() -> None:
    parts = Parts(fade_in=0.01, settle=0.5, inertia=2e-4)
    parts.turn.force = parts.turn.stretch = 1.0
    parts.motion.acceleration = 1.0
    settled(parts, 700)
    settled(parts, 200, silent=True)
    forgot, resets, fronts, damped = parts.way.forgot, parts.inverse.resets, parts.fronts.resets, parts.damper.resets
    parts.law.reset()
    assert (parts.law.ideal, parts.law.friction_term, parts.law.planned, parts.law._stretch) == (0.0,) * 4
    assert (parts.way.forgot, parts.inverse.resets) == (forgot + 1, resets + 1)
    assert (parts.fronts.resets, parts.damper.resets) == (fronts + 1, damped + 1)
    parts.ask(0.5)
    # after a tenth of the fade-in, without settling and with an active client
    assert parts.law.friction_term == pytest.approx(0.05)
    parts.inverse.size = 0.25
    parts.law.reset()
    assert parts.law.half_loop == 0.25


def test_other_parameters_count_at_once() -> None:
    parts = Parts()
    parts.inverse.size = 0.75
    assert parts.law.half_loop == 0.5
    parts.law.set_parameters(0.3, 40.0)
    assert parts.inverse.sets == [(0.3, 40.0)]
    assert parts.law.half_loop == 0.75


def test_the_half_loop_is_looked_at_every_64_cycles() -> None:
    parts = Parts()
    for _ in range(2):
        parts.inverse.size += 0.125
        parts.inverse.pretension *= 0.5
        for _ in range(63):
            parts.law.update_backoff(0.0)
        assert parts.law.half_loop == parts.inverse.size - 0.125
        parts.law.update_backoff(0.0)
        assert parts.law.half_loop == parts.inverse.size
    assert parts.law.near_slack  # pretension is a quarter of its initial value


@pytest.mark.parametrize(("share", "near"), [(0.3, False), (0.29, True), (0.31, False)])
def test_three_tenths_of_the_pretension_are_near_slack(share: float, near: bool) -> None:
    parts = Parts()
    parts.inverse.pretension = 45.0 * share if share != 0.3 else 0.3 * 45.0
    for _ in range(64):
        parts.law.update_backoff(0.0)
    assert parts.law.near_slack is near


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_what_settles_a_joint(way: float) -> None:
    """The term is settled only under a nearly constant set-point and almost without motion.

    After n periods the settled share is 1 - (1 - 1/300)^n. During motion it decays by 5/300 per period.
    """
    for velocity, rate, rests in (
        (0.499, 0.0199, True), (0.5, 0.0, False), (0.501, 0.0, False), (0.0, 0.02, False), (0.0, 0.0201, False),
    ):  # fmt: skip
        parts = Parts(settle=0.5)
        parts.turn.force = 1.0
        parts.motion.velocity = way * velocity
        share = 1.0 - (1.0 - 1.0 / 300.0) ** 100 if rests else 0.0
        assert settled(parts, 100, way * rate) == pytest.approx(0.5 * (1.0 - 0.5 * share))
        parts.motion.velocity = 2.0
        share *= (1.0 - 5.0 / 300.0) ** 20
        assert settled(parts, 20) == pytest.approx(0.5 * (1.0 - 0.5 * share))


def test_settling_goes_at_once_where_a_period_is_long() -> None:
    parts = Parts(settle=0.5)
    parts.turn.force = 1.0
    parts.law._period = 0.1
    parts.law.update_backoff(0.0)
    parts.law.update_backoff(1.0)
    parts.law._period = PERIOD
    parts.ask()
    assert parts.law.friction_term == 0.5


def test_what_nobody_wants_goes_within_the_settling_and_comes_back_five_times_as_fast() -> None:
    parts = Parts()
    parts.turn.force = 1.0
    assert settled(parts, 75, silent=True) == pytest.approx(0.375)
    assert settled(parts, 400, silent=True) == 0.0
    assert settled(parts, 30) == pytest.approx(0.25)
    assert settled(parts, 100) == 0.5


def test_a_motor_swings_against_its_joint_while_the_term_turns() -> None:
    parts = Parts(inertia=2e-4)
    parts.motion.velocity = 0.8
    assert parts.law.swing(3.0) == 0.0
    parts.turn.turning = True
    assert parts.law.swing(3.0) == pytest.approx(0.5 * 2e-4 * 4.0)
    without = Parts(encoder=False, inertia=2e-4)
    without.turn.turning = True
    assert without.law.swing(3.0) == 0.0
    default = Parts(encoder=None, inertia=2e-4)
    default.turn.turning = True
    assert default.law.swing(3.0) > 0.0


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_what_is_left_of_a_command_that_was_cut(way: float) -> None:
    """If a limit reduces the command, friction term and elongation are reduced to the remaining values.

    The command consists of 0.8 N*m ideal torque, 0.5 N*m friction term and 0.0625 N*m damping torque. The rows contain
    the applied torque (N*m), the remaining friction term (N*m) and the remaining share of the elongation.
    """
    for applied, term, share in (
        (1.3625, 0.5, 1.0), (1.4, 0.5, 1.0), (1.2625, 0.4, 1.2 / 1.3), (0.8625, 0.0, 0.8 / 1.3),
        (0.5, 0.0, 0.4375 / 1.3), (0.0625, 0.0, 0.0), (-1.0, 0.0, 0.0),
    ):  # fmt: skip
        parts = Parts(inertia=2e-4, damping=0.5)
        parts.damper.gives = way * 0.0625
        parts.turn.force = way
        assert parts.ask(way) == pytest.approx(way * 1.3625)
        parts.law.applied(way * applied)
        assert parts.law.friction_term == pytest.approx(way * term)
        assert parts.law._stretch == pytest.approx(share * parts.fronts.stretch)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_term_against_the_ideal_part_shrinks_by_what_the_limiter_added(way: float) -> None:
    """The command is 0.8 N*m ideal torque minus 0.5 N*m friction term.

    A smaller applied torque reduces the elongation, and a larger one reduces the friction term.
    """
    parts = Parts()
    parts.turn.force = -way
    assert parts.ask(way) == pytest.approx(way * 0.3)
    parts.law.applied(way * 0.25)
    assert parts.law.friction_term == pytest.approx(-way * 0.5)
    assert parts.law._stretch == pytest.approx(parts.fronts.stretch * 0.25 / 0.3)
    parts.ask(way)
    parts.law.applied(way * 0.45)
    assert parts.law.friction_term == pytest.approx(-way * 0.35)
    assert parts.law._stretch == pytest.approx(parts.fronts.stretch)


def test_without_a_term_nothing_is_taken_of_it() -> None:
    parts = Parts()
    parts.ask(1.0)
    for applied in (0.5, 0.9, 0.8):
        parts.law.applied(applied)
        assert parts.law.friction_term == 0.0
    nothing = Parts()
    nothing.ask()
    for applied in (0.25, -0.25):
        nothing.law.applied(applied)
        assert (nothing.law.friction_term, nothing.law._stretch) == (0.0, 0.0)


def test_the_joint_is_followed_by_its_encoder() -> None:
    parts = Parts()
    parts.way.next, parts.way.age = 1.0, 0.25
    parts.law.observe(0.3, 0.7, True, 1.5, 2.5)
    parts.law.observe(0.4, 0.8, False, 1.25, 3.5)
    assert parts.motion.given == [(0.3, True), (0.4, False)]
    assert parts.way.asked == [(1.5, 2.5), (1.25, 3.5)]
    assert parts.turn.asked == [(1.0, 0.25), (1.0, 0.25)]


@pytest.mark.parametrize(
    ("rest", "turning", "ahead", "begins"),
    [(0.11, False, 0.5, True), (0.1, False, 0.5, False), (0.11, True, 0.5, True), (0.11, False, math.nan, False)],
)
def test_fronts_begin_with_the_turn_of_a_joint_that_rested(
    rest: float, turning: bool, ahead: float, begins: bool
) -> None:
    """Slip fronts begin at a reversal if the joint has rested for more than 0.1 s and there is a set-point.

    Otherwise the tendons slide along their whole length.
    """
    parts = Parts()
    parts.way.sigma, parts.way.next, parts.way.rest = -1.0, 1.0, rest
    parts.turn.turning = turning
    parts.law.observe(0.3, 0.7, True, ahead, 0.0)
    assert parts.fronts.asked == ([(1.0, 0.0, 0.26, 45.0)] if begins else [])
    slides = parts.fronts.slides
    two_cycles = pytest.approx(4.0 * math.pi / RINGING / TURN)
    assert parts.turn.slower == [two_cycles if rest > 0.1 else 1.0]
    parts.law.observe(0.3, 0.7, True, ahead, 0.0)  # no reversal
    assert (parts.fronts.slides, len(parts.fronts.asked)) == (slides, begins)


def test_the_motor_stands_in_for_a_joint_without_an_encoder_but_for_its_own_turn() -> None:
    """Without a joint encoder, the joint angle is the motor angle minus the elongation, converted with the radii.

    For 10 ms after a reversal (twice the memory of the motion), the motor angle is ignored.
    """
    parts = Parts(encoder=False, inertia=2e-4)
    parts.ask(1.0)
    stretch = parts.law._stretch
    parts.way.next, parts.way.age = 1.0, 0.25
    parts.law.observe(math.nan, 0.7, True, 1.5, 2.5)
    ((angle, fresh),) = parts.motion.given
    assert fresh
    assert angle == pytest.approx(RATIO * (0.7 - stretch))
    assert (parts.way.asked, parts.turn.asked) == ([(1.5, 2.5)], [(1.0, 0.25)])
    parts.turn.turning = True
    parts.law.observe(math.nan, 0.7, False, 1.5, 2.5)
    assert parts.motion.given[1][1] is False
    parts.turn.turning = False
    parts.way.next = -1.0
    asked = []
    for _ in range(12):
        parts.law.observe(math.nan, 0.7, True, 1.5, 2.5)
        asked.append(len(parts.way.asked))
    assert asked[8:11] in ([1, 2, 3], [1, 1, 2], [2, 3, 4])  # ten periods of 1 ms, within the rounding of their sum
    assert parts.turn.asked[1:10] == [(1.0, 0.0)] * 9  # continues as before


def test_a_motor_without_a_joint_encoder_says_something_again_when_its_time_is_just_over() -> None:
    parts = Parts(encoder=False)
    parts.motion.memory = PERIOD
    parts.turn.turning = True
    parts.law.observe(math.nan, 0.7, True, 0.5, 0.0)
    parts.turn.turning = False
    asked = []
    for _ in range(3):
        parts.law.observe(math.nan, 0.7, True, 0.5, 0.0)
        asked.append(len(parts.way.asked))
    assert asked == [0, 1, 2]


def test_periods_without_a_cycle_go_on_as_expected_fifty_at_most() -> None:
    for gone, told in ((3, 3), (50, 50), (51, 50)):
        parts = Parts()
        parts.way.sigma = -1.0
        parts.law.skip_cycles(gone)
        assert len(parts.motion.given) == parts.damper.passed == told
        assert all(math.isnan(angle) and not fresh for angle, fresh in parts.motion.given)
        assert parts.turn.asked == [(-1.0, 0.0)] * told
