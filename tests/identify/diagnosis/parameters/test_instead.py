"""A formula in the place of a name: who does better, and what is told in the end is no worse than the name was."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tsa_ctrl.identify.diagnosis.parameters import claims as claimed
from tsa_ctrl.identify.diagnosis.parameters import instead
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import Elsewhere
from tsa_ctrl.model.parameters import RigidDrive

STEADY = np.full(24, 1.0)  # mean square in each block of time


def formula(expression: str, terms: int = 1) -> Formula:
    return Formula(expression, {}, RigidDrive(), gain=0.5, rms=(2.0, 1.0), better=1, logs=1, terms=terms)


@pytest.mark.parametrize(
    ("expression", "times", "better"),
    [
        ("a*sin(q_j)", 1.4, False),  # visibly more is half as much again
        ("a*sin(q_j)", 1.6, True),
        ("a*(1 + tanh((t - b)/0.05))*tau", 1.6, False),  # the clock of a program, no law
        ("a*(1 + tanh((t - b)/0.05))*tau", 3.9, False),
        ("a*(1 + tanh((t - b)/0.05))*tau", 4.1, True),
    ],
)
def test_a_name_gives_way_to_a_law_that_is_visibly_better_and_to_a_clock_that_is_far_better(
    expression: str, times: float, better: bool
) -> None:
    error, named = Elsewhere(STEADY), Elsewhere(times * STEADY)
    assert instead._does_better(formula(expression), error, 1, named) == better


def test_fewer_terms_that_do_nearly_as_well_take_the_place_of_a_name_with_a_formula() -> None:
    error = Elsewhere(STEADY)
    assert instead._does_better(formula("a*tau"), error, 2, Elsewhere(0.95 * STEADY))
    assert not instead._does_better(formula("a*tau"), error, 2, Elsewhere(0.85 * STEADY))
    assert not instead._does_better(formula("a*tau", 2), error, 2, Elsewhere(0.95 * STEADY))


@pytest.mark.parametrize(("left", "kept"), [(0.2, True), (1.05, True), (1.2, False), (6.0, False)])
def test_what_is_told_in_the_end_leaves_no_more_than_the_name_did(
    left: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without it another cause may fall, and the formula that is found then may be a poor one: the name stays."""
    chosen: Any = SimpleNamespace(problem=None, fitted="with")
    errors: Any = SimpleNamespace(worthless=None)
    squares = {"with": STEADY, "without": left * STEADY}
    for name, value in {
        "held_out": lambda *_: errors,
        "transfer": lambda *_: (),
        "local": lambda _: None,
        "formula_of_what_is_left": lambda *_: None,
        "stand_in": lambda _, found, *__: 0 if found == "with" else None,
        "without_causes": lambda *_: SimpleNamespace(problem=None, fitted="without"),
    }.items():
        monkeypatch.setattr(claimed, name, value)
    monkeypatch.setattr(instead, "with_direction", lambda *_: np.ones(24, dtype=bool))
    monkeypatch.setattr(instead, "_described", lambda _, found, *__: found)
    monkeypatch.setattr(instead, "_squares", lambda _, model, __: Elsewhere(squares[model]))
    groups: Any = ("the name's",)
    split: Any = SimpleNamespace(held=None, fit=None)
    base: Any = None
    found = claimed.claims(chosen, groups, base, split, share=0.5)
    assert (found.selection.fitted, found.groups) == (("without", ()) if kept else ("with", groups))
