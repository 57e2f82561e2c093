"""A formula is parsed, is bounded, and has the same value for scalars and arrays. Invalid formulas are rejected."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.expression import LONGEST, parse

NAMES = ("omega_j", "q_j", "tau")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.1*sin(2*q_j) + k*abs(omega_j)", 0.1 * math.sin(1.0) + 0.3 * 2.0),
        ("-q_j**2", -0.25),
        ("tau/(1 + exp(-omega_j))", 1.5 / (1.0 + math.exp(2.0))),
        ("sign(omega_j)*sqrt(abs(tau))*tanh(q_j)", -math.sqrt(1.5) * math.tanh(0.5)),
        ("cos(0) - +1", 0.0),
        ("2*inside(q_j, 0, 1)", 1.0 + math.tanh(15.0)),  # in the middle of the range
    ],
)
def test_a_formula_has_its_value(text: str, value: float) -> None:
    program = parse(text, NAMES, {"k": 0.3}, "x")
    assert program.value((-2.0, 0.5, 1.5)) == pytest.approx(value, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("__import__('os').system('true')", "is not allowed"),
        ("(lambda: 1)()", "is not allowed"),
        ("sin(q_j, 1)", "is not allowed"),
        ("q_j if q_j else 1", "is not allowed"),
        ("True", "is not allowed"),
        ("q_i", "did you mean 'q_j'"),
        ("lag(tau)", r"'lag\(tau\)': found 1 argument\(s\); write lag\(x, T\)"),
        ("lag(tau, T=1)", "is not allowed"),
        ("lag(tau, -1)", "T = -1; allowed is 1e-06 to 1e"),
        ("lag(tau, 1e999)", "T = inf; allowed"),
        ("ring(tau, 5, 1.5)", "d = 1.5; allowed is 1e-06 to 1"),
        ("lag(tau, omega_j)", "T is not a constant"),
        ("inside(q_j, 1, 0)", "two constants, low < high"),
        ("inside(q_j, tau, 2)", "two constants"),
        ("lag(1 + dahl(tau, 1), 1)", "dahl within lag"),
        ("lag", "is neither a signal nor a parameter"),
        ("+".join(["lag(tau, 1)"] * 5), "more than 4 functions with a memory"),
        ("q_j +", "is not a formula"),
        ("", "is not a formula"),
        ("1e999", "not a finite number"),
        ("9" * 400, "too large"),
        ("1+" * LONGEST + "1", "characters"),
        ("(" * 300, "is not a formula"),
        ("+".join(["q_j"] * 100), "steps|levels"),
        ("-" * 200 + "1", "levels"),
    ],
)
def test_what_is_no_formula_is_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said) as caught:
        parse(text, NAMES, {}, "x.toml: [effects.custom]")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["1/q_j", "sqrt(0 - 1 - abs(q_j))", "q_j**(0-1)", "(0-1)**0.5"])
def test_where_a_formula_has_no_value_it_is_nan_on_both_machines(text: str) -> None:
    program = parse(text, NAMES, {}, "x")
    assert math.isnan(program.value((0.0, 0.0, 0.0)))
    assert np.isnan(program.array([np.zeros(2)] * 3)).all()


def test_a_formula_is_kept_in_its_range_and_fades_out_beyond() -> None:
    """At a quarter of the range beyond either end, less than 0.3 % of it remains."""
    program = parse("q_j*inside(q_j, -0.2, 0.6)", NAMES, {}, "x")
    for q in (-0.2, 0.0, 0.2, 0.6):
        assert program.value((0.0, q, 0.0)) == pytest.approx(q, rel=0.003, abs=1e-9)
    for q in (-0.4, 0.8, 5.0):
        assert abs(program.value((0.0, q, 0.0))) < 0.003 * abs(q)


FORMULAS = st.recursive(
    st.sampled_from(["q_j", "omega_j", "tau", "0.5", "2", "k"]),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*/"), inner).map(lambda part: f"({part[0]}{part[1]}{part[2]})"),
        st.tuples(st.sampled_from(["sin", "cos", "tanh", "abs", "sign", "sqrt", "exp"]), inner).map(
            lambda part: f"{part[0]}({part[1]})"
        ),
    ),
    max_leaves=8,
)
SIZES = st.floats(-3.0, 3.0)


@settings(max_examples=200, deadline=None)
@given(FORMULAS, st.tuples(SIZES, SIZES, SIZES))
def test_both_machines_agree(text: str, values: tuple[float, float, float]) -> None:
    program = parse(text, NAMES, {"k": -0.7}, "x")
    one = program.value(values)
    many = program.array([np.full(2, value) for value in values]) * np.ones(2)
    np.testing.assert_allclose(many, [one, one], rtol=1e-12, atol=1e-300)


def test_a_program_knows_what_it_depends_on() -> None:
    program = parse("sin(q_j) + k", NAMES, {"k": 1.0}, "x")
    assert (program.uses("q_j"), program.uses("tau")) == (True, False)


def test_exp_saturates_instead_of_overflowing() -> None:
    program = parse("exp(q_j)", NAMES, {}, "x")
    assert program.value((0.0, 1e9, 0.0)) == math.exp(700.0)
