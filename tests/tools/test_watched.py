"""A number that is watched: what it is told as, which other values would change a comparison, and where it may be."""

from __future__ import annotations

import ast

import numpy as np
import pytest

from tools.bench.watched import Watched, only_compared

HALF, DOUBLE = ("a", 0.5), ("a", 2.0)


def watch(value: float) -> tuple[Watched, set[tuple[str, float]]]:
    found: set[tuple[str, float]] = set()
    return Watched(value, {HALF: 0.5 * value, DOUBLE: 2.0 * value}, found), found


@pytest.mark.parametrize(("other", "differs"), [(9.0, set()), (5.0, {DOUBLE}), (3.0, {HALF}), (1.0, set())])
def test_a_comparison_is_as_with_the_number_and_says_which_others_differ(other: float, differs: set[object]) -> None:
    number, found = watch(4.0)
    assert (other > number) is (other > 4.0)
    assert found == differs
    for turned in (number < other, np.float64(other) > number):
        assert bool(turned) is (other > 4.0)
    assert found == differs


def test_arithmetic_before_the_comparison_is_followed_from_both_sides() -> None:
    number, found = watch(4.0)
    assert 2.0 * number + 1.0 < 10.0  # 5 and 17 with the others
    assert found == {DOUBLE}
    number, found = watch(4.0)
    assert not 1.0 - number**2 / np.float64(4.0) > -2.5  # 0 and -15
    assert found == {HALF}
    number, found = watch(4.0)
    assert -number < 0
    assert found == set()


def test_of_an_array_any_element_counts() -> None:
    number, found = watch(4.0)
    assert (np.array([1.0, 3.0, 9.0]) > number).tolist() == [False, False, True]
    assert found == {HALF}
    number, found = watch(4.0)
    assert (np.array([1.0, 20.0]) > np.array([1.0, 2.0]) * number).tolist() == [False, True]
    assert found == set()


def test_two_numbers_in_one_comparison_are_each_asked_alone() -> None:
    found: set[tuple[str, float]] = set()
    first = Watched(2.0, {("a", 2.0): 4.0}, found)
    second = Watched(3, {("b", 2.0): 6}, found)
    assert first**second < 10.0  # 8; 64 with the other of either
    assert found == {("a", 2.0), ("b", 2.0)}


@pytest.mark.parametrize(
    ("text", "alone"),
    [
        ("C = 2.0\ndef f(x): return x > C and -3 * C < x", True),
        ("C = 2.0\ndef f(x): return [y for y in x if y > C * sum(x)]", True),
        ("C = 2.0\ndef f(x): return x * C", False),
        ("C = 2.0\ndef f(x): return x > max(1.0, C)", False),
        ("C = 2.0\ndef f(x, y=C): return x > y", False),
        ("import m\ndef f(x): return x > m.C", False),
    ],
)
def test_only_a_number_that_ends_in_comparisons_can_be_watched(text: str, alone: bool) -> None:
    assert only_compared([ast.parse(text)], "C") is alone
