"""Test that a planned reversal is smooth, takes its duration, ends at rest, and can be restarted at any time."""

from __future__ import annotations

import numpy as np
import pytest

from tsa_ctrl.control.reversal import FrictionReversal, ReversalFront
from tsa_ctrl.model.curvature import NAMED

PERIOD, DURATION = 1e-4, 8e-3


def turned(name: str = "uniform", age: float = 0.0) -> np.ndarray:
    """Return `force`, `stretch` and `bend` of a reversal from 1 to -1 for 100 periods, (3, 100)."""
    turn = FrictionReversal(ReversalFront(NAMED[name]), DURATION, PERIOD)
    turn.reset(1.0)
    rows = []
    for n in range(100):
        turn.update(-1.0, age if n == 0 else 0.0)
        rows.append((turn.force, turn.stretch, turn.bend))
    assert not turn.turning
    return np.array(rows).T


@pytest.mark.parametrize("name", NAMED)
def test_takes_its_duration_and_ends_at_rest(name: str) -> None:
    force, stretch, bend = turned(name)
    assert (force[81], stretch[81], bend[81]) == (-1.0, -1.0, 0.0)
    assert force[78] > -1.0
    assert np.all(np.diff(force) <= 0.0)
    assert np.all(np.diff(stretch) <= 1e-12)


@pytest.mark.parametrize("name", NAMED)
def test_bend_is_the_second_derivative_of_the_stretch(name: str) -> None:
    _, stretch, bend = turned(name)
    second = np.diff(stretch, 2) / PERIOD**2
    np.testing.assert_allclose(bend[1:79], second[:78], atol=1e-3 * np.abs(second).max())


def test_evenly_bent_half_of_the_torque_is_a_quarter_of_the_way() -> None:
    """With even curvature, half of the torque has reversed when the motor has moved by a quarter of its travel."""
    force, stretch, _ = turned()
    at_half = np.interp(0.5, (1.0 - force) / 2.0, (1.0 - stretch) / 2.0)
    assert at_half == pytest.approx(0.25, abs=0.01)


def test_an_older_turn_is_as_far_as_if_it_had_begun_earlier() -> None:
    young, old = turned()[0], turned(age=1.0)[0]
    np.testing.assert_allclose(old[:79], young[1:80], atol=1e-12)


@pytest.mark.parametrize("slower", [1.0, 3.0])
def test_a_slower_turn_has_the_same_course_over_a_longer_time(slower: float) -> None:
    turn = FrictionReversal(ReversalFront(NAMED["uniform"]), DURATION, PERIOD)
    turn.reset(1.0)
    rows = []
    for _ in range(260):
        turn.update(-1.0, slower=slower)
        rows.append((turn.force, turn.stretch, turn.bend))
    force, stretch, bend = np.array(rows).T
    assert np.flatnonzero(force > -1.0)[-1] == pytest.approx(slower * DURATION / PERIOD, abs=2)
    np.testing.assert_allclose(force[:: int(slower)][:80], turned()[0][:80], atol=1e-9)
    second = np.diff(stretch, 2) / PERIOD**2
    last = 79 * int(slower)
    np.testing.assert_allclose(bend[1:last], second[: last - 1], atol=1e-2 * np.abs(second).max())


@pytest.mark.parametrize("name", NAMED)
@pytest.mark.parametrize("begun", [10, 90, 200])
def test_a_fast_turn_that_cancels_a_slow_one_stays_within_both_directions(name: str, begun: int) -> None:
    turn = FrictionReversal(ReversalFront(NAMED[name]), DURATION, PERIOD)
    turn.reset(1.0)
    forces = []
    for n in range(400):
        turn.update(-1.0 if n < begun else 1.0, slower=3.0 if n < begun else 1.0)
        forces.append(turn.force)
    assert forces[-1] == 1.0
    assert min(forces) > -1.0 - 1e-9
    assert max(forces) < 1.0 + 1e-9


def test_turns_add_up() -> None:
    """A reversal that is cancelled half way ends at its initial value, without a jump or an overshoot."""
    turn = FrictionReversal(ReversalFront(NAMED["uniform"]), DURATION, PERIOD)
    turn.reset(1.0)
    forces = []
    for n in range(200):
        turn.update(-1.0 if n < 40 else 1.0)
        forces.append(turn.force)
    assert forces[-1] == 1.0
    assert -1.0 < min(forces) < 0.0
    assert max(forces) <= 1.0
    assert np.abs(np.diff(forces)).max() < 0.06


def test_steepest_is_the_largest_step_of_a_turn() -> None:
    turn = FrictionReversal(ReversalFront(NAMED["uniform"]), DURATION, 1e-3)
    coarse = turned()[0][::10]
    assert turn.steepest() == pytest.approx(np.abs(np.diff(coarse)).max() / 2.0, abs=0.01)
