"""Test the limit of the friction compensation by the proven friction and an energy credit."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest

from tsa_ctrl.control.compensation_limit import AGING, OUTDATED, Bound, CompensationLimit, EnergyCredit, Requests
from tsa_ctrl.observer.friction_proof import FrictionProof

PERIOD = 1e-3
FRICTION = 0.5  # N*m at the motor
GEARING = 1.25


class Proof:
    """Bounds of the proven friction, set by the test."""

    def __init__(self, usable: bool = True) -> None:
        self.usable = usable
        self.low, self.high, self.reads = 0.0, math.inf, False
        self.modelled = FRICTION
        self.confirms_file = True

    @property
    def middle(self) -> float:
        return 0.5 * (self.low + self.high)


def limit(proof: Proof, capacity: float = 0.4, seen: float = 0.95) -> CompensationLimit:
    return CompensationLimit(Bound(seen, 0.6), cast(FrictionProof, proof), capacity, GEARING, PERIOD)


def move(
    chosen: CompensationLimit, way: float, *, set_point: float = 0.0, rate: float = 0.0, speed: float = 1.0
) -> float:
    """Move the joint by `way` (rad) with the permitted term, and return the energy that the term supplies (J)."""
    given, sigma = 0.0, math.copysign(1.0, way)
    for _ in range(round(abs(way) / speed / PERIOD)):
        term = chosen.share * FRICTION
        given += GEARING * term * speed * PERIOD
        chosen.update(FRICTION, sigma * term, sigma * speed, set_point, rate, 1.0)
    return given


def rest(chosen: CompensationLimit, seconds: float, set_point: float = 0.0, rate: float = 0.0) -> None:
    for _ in range(round(seconds / PERIOD)):
        chosen.update(FRICTION, 0.0, 0.0, set_point, rate, 1.0)


@pytest.mark.parametrize("capacity", [0.1, 0.4])
def test_an_unproven_term_gives_no_more_than_the_credit(capacity: float) -> None:
    chosen = limit(Proof(), capacity)
    given = sum(move(chosen, way) for way in (0.3, -0.5, 0.2, -0.4, 0.4))
    assert 0.9 * capacity < given < 1.01 * capacity
    assert chosen.share == 0.0
    assert "no sensor confirms" in chosen.words


@pytest.mark.parametrize("sigma", [1.0, -1.0])
def test_a_joint_torque_sensor_measures_what_the_term_gives(sigma: float) -> None:
    """A moving joint that receives less torque than the set-point uses no credit.

    A joint that receives more torque than the set-point spends its credit.
    """
    chosen = limit(Proof(), 0.1)
    for tau_j, withdrawn in ((0.4, False), (0.8, True)):
        for _ in range(3000):
            term = sigma * chosen.share * FRICTION
            chosen.update(FRICTION, term, 0.3 * sigma, 0.5 * sigma, 0.0, 1.0, tau_j * sigma)
        assert chosen.credit.withdrawn is withdrawn


def test_random_motions_never_get_more_than_their_fills() -> None:
    """In random motions, the term never supplies more energy than one credit for each time that it was filled."""
    random = np.random.default_rng(5)
    chosen = limit(Proof(), 0.1)
    given, fills = 0.0, 1
    for _ in range(1000):
        before = chosen.credit.withdrawn
        given += move(chosen, float(random.uniform(-0.05, 0.05)), speed=float(random.uniform(1.0, 3.0)))
        fills += before and not chosen.credit.withdrawn
        if random.random() < 0.05:
            rest(chosen, 0.6)
        assert given < 1.02 * 0.1 * fills
    assert fills > 3


def test_a_joint_that_does_not_move_keeps_its_compensation() -> None:
    chosen = limit(Proof())
    rest(chosen, 10.0)
    assert chosen.share == 0.95


def test_a_proven_friction_is_all_that_is_compensated_and_costs_nothing() -> None:
    proof = Proof()
    proof.low = proof.high = 0.7 * FRICTION
    chosen = limit(proof)
    move(chosen, 5.0)
    assert chosen.share == pytest.approx(0.95 * 0.7)
    proof.low = proof.high = 2.0 * FRICTION
    move(chosen, 0.2)
    assert chosen.share == 0.95


def test_the_share_falls_at_once_and_rises_slowly() -> None:
    proof = Proof()
    proof.low = proof.high = FRICTION
    chosen = limit(proof)
    proof.low = proof.high = 0.2 * FRICTION
    chosen.update(FRICTION, 0.4, 1.0, 0.0, 0.0, 1.0)
    assert chosen.share == pytest.approx(0.19)
    proof.low = proof.high = FRICTION
    chosen.update(FRICTION, 0.1, 1.0, 0.0, 0.0, 1.0)
    assert chosen.share == pytest.approx(0.2)


def empty(set_point: float = 0.0) -> CompensationLimit:
    chosen = limit(Proof())
    move(chosen, 1.6, set_point=set_point)
    assert chosen.share == 0.0
    return chosen


def test_a_withdrawn_term_does_not_come_back_while_the_joint_coasts_or_rests() -> None:
    chosen = limit(Proof())
    move(chosen, 2.5)
    assert chosen.share == 0.0
    rest(chosen, 10.0)
    assert chosen.share == 0.0


def test_a_hand_that_moves_the_resting_joint_brings_it_back() -> None:
    chosen = empty()
    rest(chosen, 0.6)
    move(chosen, 0.25)
    assert chosen.share > 0.9


def test_the_turning_points_of_a_swing_are_no_rest() -> None:
    """At its turning points a pendulum stops for less than half a second, so an empty credit is not filled."""
    chosen = empty()
    for way in (0.3, -0.25, 0.2, -0.15):
        move(chosen, way)
        rest(chosen, 0.3)
    assert chosen.share == 0.0


def test_motion_that_lasts_without_the_term_brings_it_back_twice_as_long() -> None:
    chosen = limit(Proof())
    move(chosen, 1.6)
    assert chosen.share == 0.0
    assert 0.75 < move(chosen, 4.0) < 0.81


def test_motion_that_the_set_point_may_have_caused_proves_nothing() -> None:
    chosen = empty(0.3)
    move(chosen, 10.0, set_point=0.3)
    assert chosen.share == 0.0
    move(chosen, -3.0, set_point=0.3)
    assert chosen.credit.share > 0.0


@pytest.mark.parametrize("way", [0.6, 0.9, -1.6])
def test_a_changed_set_point_has_a_credit_of_its_own(way: float) -> None:
    """A changed set-point fills a spent or partly spent credit, but a rest under a constant set-point does not.

    Otherwise a joint with a small remaining credit could stay at rest, and its friction would stay unproven.
    """
    chosen = limit(Proof())
    set_point = math.copysign(0.3, way)
    move(chosen, way, set_point=set_point)
    left = chosen.credit.share
    assert 0.0 <= left < 0.9
    assert (left > 0.0) is (abs(way) < 1.0)
    rest(chosen, 5.0, set_point)
    assert chosen.credit.share == left
    rest(chosen, 0.2, -set_point)
    assert chosen.credit.share == 1.0
    assert move(chosen, -math.copysign(4.0, way), set_point=-set_point) < 1.01 * 0.4


def test_a_changing_set_point_suspends_the_account_where_nothing_can_be_proven() -> None:
    shares = []
    for chosen in (limit(Proof(usable=False)), limit(Proof())):
        for n in range(20):  # a set-point that moves by twice the least request every half second
            move(chosen, 0.5, set_point=0.3 * (-1) ** n, rate=1.0)
        shares.append(chosen.share)
    assert shares == [0.6, 0.0]


def test_the_peaks_of_a_sine_never_empty_the_credit_of_a_blind_axis() -> None:
    """A hand moves the joint continuously. The share is not reduced by the short times of a constant set-point."""
    blind = limit(Proof(usable=False), 0.1)
    for n in range(30_000):
        phase = math.pi * n * PERIOD
        rate = 0.5 * math.pi * math.cos(phase)
        blind.update(FRICTION, blind.share * FRICTION, 3.0, 0.5 * math.sin(phase), rate, 1.0)
    assert blind.share == 0.6


def test_an_old_upper_bound_does_not_hold_a_joint_that_is_asked_to_move() -> None:
    """An upper bound ages while the set-point changes, because the friction may have increased meanwhile.

    At a constant set-point the bound stays.
    """
    proof = Proof()
    proof.low = proof.high = 0.3 * FRICTION
    chosen = limit(proof)
    rest(chosen, 5.0)
    assert chosen.share == pytest.approx(0.95 * 0.3)
    rest(chosen, OUTDATED, rate=1.0)
    assert chosen.share == pytest.approx(0.95 * 0.3)
    rest(chosen, 1.0, rate=1.0)
    assert chosen.share == pytest.approx(0.95 * (0.3 + 0.5 * AGING), rel=0.01)
    rest(chosen, 1.4 / AGING, rate=1.0)
    assert chosen.share == 0.95


def test_what_the_guard_has_found_holds_until_the_next_reading() -> None:
    """A friction found by the guard ages like an upper bound, and a sensor reading replaces it."""
    proof = Proof()
    chosen = limit(proof)
    rest(chosen, 0.2)
    assert chosen.share == 0.95
    chosen.observe(0.5 * FRICTION)
    rest(chosen, 1.0)
    assert chosen.share == pytest.approx(0.95 * (0.5 + AGING), rel=0.01)
    proof.low, proof.high, proof.reads = 0.8 * FRICTION, 0.8 * FRICTION, True
    rest(chosen, 0.2)
    assert chosen.share == pytest.approx(0.95 * 0.8)


def test_less_friction_than_the_file_has_is_reported_once() -> None:
    proof = Proof()
    proof.low, proof.high, proof.reads = 0.4 * FRICTION, 0.5 * FRICTION, True
    chosen = limit(proof)
    move(chosen, 1.0)
    assert chosen.count == 1
    assert "at most 50 % of the model's" in chosen.words


def test_an_enable_fills_the_credit_again() -> None:
    chosen = empty()
    chosen.reset()
    assert chosen.share == 0.95


def test_a_credit_is_not_filled_beyond_its_size() -> None:
    credit = EnergyCredit(0.4, PERIOD)
    for _ in range(1000):
        credit.update(-1.0, 1.0, 0.0, 0.1, False)
    for _ in range(1000):
        credit.update(0.41, 1.0, 0.0, 0.1, False)
    assert credit.withdrawn


def test_the_desired_share_is_of_the_measured_friction() -> None:
    """If 70 % of the file's friction is measured and c is 0.9, the share is 0.9 * 70 %."""
    proof = Proof()
    proof.low, proof.high = 0.68 * FRICTION, 0.72 * FRICTION
    chosen = limit(proof)
    chosen.update(FRICTION, 0.0, 1.0, 0.0, 0.0, 0.9)
    assert chosen.share == pytest.approx(0.9 * 0.7)


def test_a_credit_that_ends_beside_a_proven_friction_is_no_event() -> None:
    """If the bounds of the proven friction differ by a few per cent, the end of the credit is not reported."""
    proof = Proof()
    proof.low, proof.high = 0.9 * FRICTION, 1.1 * FRICTION
    chosen = limit(proof)
    move(chosen, 40.0)
    assert 0.9 <= chosen.share <= 0.95
    assert chosen.count == 0


@pytest.mark.parametrize(
    ("trusted", "proven", "given"),
    [(True, 0.0, 0.4), (False, 0.0, 0.1), (False, 0.59, 0.1), (False, 0.61, 0.4)],
    ids=["trusted", "unproven", "too-little", "confirmed"],
)
def test_a_file_that_is_not_of_this_joint_has_the_smaller_credit_until_the_friction_confirms_it(
    trusted: bool, proven: float, given: float
) -> None:
    """An unconfirmed file has the small credit of 0.1 J.

    A proven friction above 60 % of the file's value confirms the file, and the credit becomes 0.4 J.
    """
    proof = Proof()
    chosen = CompensationLimit(Bound(1.0, 0.6), cast(FrictionProof, proof), 0.4, GEARING, PERIOD, 0.1)
    chosen.trusted = trusted
    chosen.reset()
    proof.low, proof.reads = proven * FRICTION, proven > 0.0
    chosen.update(FRICTION, 0.0, 1.0, 0.0, 0.0, 1.0)
    proof.low, proof.reads = 0.0, False  # the sensor fails, so no friction is proven from here on
    assert 0.9 * given < move(chosen, 2.0) < 1.05 * given
    assert chosen.credit.withdrawn


def test_a_friction_that_was_measured_only_once_does_not_confirm_the_file() -> None:
    proof = Proof()
    chosen = CompensationLimit(Bound(1.0, 0.6), cast(FrictionProof, proof), 0.4, GEARING, PERIOD, 0.1)
    proof.low, proof.reads, proof.confirms_file = FRICTION, True, False
    chosen.update(FRICTION, 0.0, 1.0, 0.0, 0.0, 1.0)
    assert chosen.credit.capacity == 0.1


def test_a_confirmed_file_is_doubted_again_after_the_next_bring_up() -> None:
    """After a new bring-up the nodes may belong to another joint, so the credit is small again."""
    proof = Proof()
    chosen = CompensationLimit(Bound(1.0, 0.6), cast(FrictionProof, proof), 0.4, GEARING, PERIOD, 0.1)
    proof.low, proof.reads = FRICTION, True
    chosen.update(FRICTION, 0.0, 1.0, 0.0, 0.0, 1.0)
    assert chosen.credit.capacity == 0.4
    chosen.trusted = False
    assert chosen.credit.capacity == 0.1


def test_only_a_change_comparable_with_the_friction_requests_motion() -> None:
    """Noise and a small ripple request none; a sine requests motion at all times, a step for a second."""
    t = PERIOD * np.arange(6000)
    rng = np.random.default_rng(5)
    setpoints = {
        "noise": 0.002 * rng.standard_normal(len(t)),
        "ripple": 0.3 + 0.01 * np.sin(30.0 * t),
        "sine": 0.5 * np.sin(np.pi * t),
        "step": np.where(t < 2.0, 0.0, 0.3),
    }
    asked = {}
    for name, values in setpoints.items():
        requests = Requests(PERIOD)
        asked[name] = np.array([requests.update(value, 0.1) for value in values.tolist()])
    assert not asked["noise"].any()
    assert not asked["ripple"].any()
    assert asked["sine"][500:].all()
    assert asked["step"].nonzero()[0][0] == 2000
    assert 0.5 < PERIOD * asked["step"].sum() < 2.5
