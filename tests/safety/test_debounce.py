"""Test the timer that counts up while a condition holds, and down at a quarter of the speed while it does not."""

from __future__ import annotations

import pytest

from tsa_ctrl.safety.debounce import Debounce, Often


def test_without_a_break_it_is_the_time_since_it_began() -> None:
    clock = Debounce(0.5)
    assert [clock.update(t, True) for t in (8.0, 8.25, 8.4999, 8.5, 9.0)] == [False, False, False, True, True]


def test_agreement_takes_back_a_quarter_of_its_time() -> None:
    clock = Debounce(0.5)
    assert not any(clock.update(t, wrong) for t, wrong in ((0.0, True), (0.375, True), (0.875, False), (1.0, True)))
    assert not clock.update(1.124, True)
    assert clock.update(1.125, True)


def test_agreement_in_pieces_takes_back_as_much() -> None:
    clock = Debounce(0.5)
    clock.update(0.0, True)
    clock.update(0.375, True)
    assert not any(clock.update(t, False) for t in (0.5, 0.625, 0.875))
    assert [clock.update(t, True) for t in (1.0, 1.124, 1.125)] == [False, False, True]


def test_what_has_run_out_begins_anew_and_owes_nothing() -> None:
    clock = Debounce(0.5)
    clock.update(0.0, True)
    clock.update(0.25, True)
    assert [clock.update(t, False) for t in (1.25, 50.0)] == [False, False]
    assert [clock.update(t, True) for t in (60.0, 60.499, 60.5)] == [False, False, True]


def test_a_reset_forgets() -> None:
    clock = Debounce(0.5)
    clock.update(0.0, True)
    clock.reset()
    assert [clock.update(t, True) for t in (0.6, 1.0, 1.1)] == [False, False, True]


@pytest.mark.parametrize(("share", "found"), [(0.19, False), (0.22, True)])
def test_wrong_more_than_a_fifth_of_the_time_is_found_in_the_end(share: float, found: bool) -> None:
    clock = Debounce(0.1)
    assert any(clock.update(0.001 * n, n % 100 < 100 * share) for n in range(10_000)) is found


def test_often_is_so_many_times_within_a_second() -> None:
    counter = Often(3)
    assert [counter.happened(t) for t in (0.0, 0.5, 1.0001, 1.5, 2.5)] == [False, False, False, True, False]
    assert [counter.happened(t) for t in (2.6, 2.7)] == [False, True]
    counter.reset()
    assert [counter.happened(t) for t in (2.8, 2.9, 3.0)] == [False, False, True]
