"""Decimal text to doubles: exact, and honest about what it cannot do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.log import numbers


def read(text: str) -> tuple[float, bool]:
    data = np.frombuffer(text.encode(), dtype=np.uint8)
    return numbers.number(data, 0, len(data))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_shortest_text_reads_back_to_the_same_double(value: float) -> None:
    found, sure = read(repr(value))
    assert not sure or found == value


@given(st.integers(0, 2**64), st.integers(-250, 250), st.sampled_from(["", "-", "+"]))
def test_mantissa_and_exponent_round_as_float_does(mantissa: int, exponent: int, sign: str) -> None:
    text = f"{sign}{mantissa}e{exponent}"
    found, sure = read(text)
    assert not sure or found == float(text)


@given(st.floats(-1e9, 1e9), st.integers(0, 18), st.sampled_from("fe"))
def test_fixed_numbers_of_digits_round_as_float_does(value: float, digits: int, kind: str) -> None:
    text = format(value, f".{digits}{kind}")
    found, sure = read(text)
    assert not sure or found == float(text)


@given(st.integers(-(10**9), 10**9).map(lambda value: format(value / 997.0, ".18e")))
def test_the_format_of_savetxt_needs_no_help(text: str) -> None:
    assert read(text) == (float(text), True)


def test_halfway_between_two_doubles_is_left_to_float() -> None:
    assert read("9007199254740993") == (pytest.approx(9007199254740992.0), False)


@pytest.mark.parametrize(
    "text", ["", "-", ".", "e5", "1e", "1e+", "nan", "inf", "1_0", "1,5", "0x10", "1.2.3", "1 2", "--1"]
)
def test_what_is_no_plain_number_is_said_to_be_none(text: str) -> None:
    assert read(text)[1] is False


def test_minus_zero_keeps_its_sign() -> None:
    assert math.copysign(1.0, read("-0.0")[0]) == -1.0


def test_parse_skips_unwanted_fields_and_lists_odd_ones() -> None:
    text = np.frombuffer(b'1,"a,b",2\n3,x,nan\n', dtype=np.uint8)
    out, odd = np.empty((2, 4)), np.empty((8, 4), dtype=np.int64)
    rows, position, odds, outcome, _ = numbers.parse(text, 0, len(text), ord(","), np.array([0, -1, 1]), out, odd)
    assert (rows, position, odds, outcome) == (2, len(text), 1, numbers.OK)
    assert out[:, :2].tolist()[0] == [1.0, 3.0]
    assert odd[0].tolist() == [1, 1, 14, 17]
