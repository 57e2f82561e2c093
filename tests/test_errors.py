"""Limits in messages."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.errors import rounded_down


@given(st.floats(1e-9, 1e9), st.integers(1, 6))
def test_a_printed_limit_is_permitted_and_close(value: float, digits: int) -> None:
    printed = float(rounded_down(value, digits))
    assert printed <= value * (1.0 + 1e-9)
    assert printed >= value * (1.0 - 10.0 ** (1 - digits)) * (1.0 - 1e-9)


def test_a_limit_of_zero() -> None:
    assert rounded_down(0.0, 2) == "0"
