"""Test the marks for causes, groups and rejections."""

from __future__ import annotations

from typing import Any

import pytest

from .cases import Case, Truth
from .score import FURTHER, TARGETS, counted, interval, mark


def hidden(family: str, *effects: str, **truth: Any) -> Case:
    numbers = {"friction_angle": 0.3, "slope": 1.2}
    return Case(
        family, "name", 0, [], "", Truth({name: {"coefficient": 0.5} for name in effects}, numbers=numbers, **truth)
    )


def said(
    *causes: tuple[str, tuple[str, ...]], verdict: str = "explained", experiment: str = "", **more: Any
) -> dict[str, Any]:
    listed = [{"effect": name, "alternatives": list(others), "parameters": {}} for name, others in causes]
    return {"verdict": verdict, "causes": listed, "experiment": experiment, "parameter_errors": {}, **more}


def test_the_name_alone_is_unique() -> None:
    marks = mark(hidden("single", "inertia"), said(("inertia", ())))
    assert (marks.unique, marks.within, marks.wrong) == (True, True, False)


def test_the_name_among_two_alternatives_is_within() -> None:
    marks = mark(hidden("single", "inertia"), said(("joint_stiffness", ("inertia", "gravity_load"))))
    assert (marks.unique, marks.within, marks.wrong) == (False, True, False)


def test_three_alternatives_are_too_many() -> None:
    marks = mark(hidden("single", "inertia"), said(("inertia", ("a", "b", "c"))))
    assert (marks.unique, marks.within) == (False, False)


def test_another_name_without_alternatives_is_confidently_wrong() -> None:
    marks = mark(hidden("single", "inertia"), said(("torque_offset", ())))
    assert (marks.unique, marks.within, marks.wrong) == (False, False, True)


def test_a_second_name_spoils_the_first() -> None:
    marks = mark(hidden("single", "inertia"), said(("inertia", ()), ("torque_offset", ())))
    assert (marks.unique, marks.wrong) == (False, True)


def test_any_name_on_a_log_without_effect_is_false() -> None:
    assert mark(hidden("none"), said(("inertia", ("joint_stiffness",)))).named
    assert not mark(hidden("none"), said(verdict="insufficient")).named


def test_a_pair_needs_both_names_and_nothing_else() -> None:
    pair = hidden("pair", "inertia", "backlash")
    assert mark(pair, said(("backlash", ()), ("inertia", ()))).both
    assert not mark(pair, said(("backlash", ()))).both
    assert not mark(pair, said(("backlash", ()), ("inertia", ()), ("torque_offset", ()))).both


def test_a_pair_named_with_many_doubts_is_not_named() -> None:
    pair = hidden("pair", "inertia", "backlash")
    assert mark(pair, said(("backlash", ("a", "b")), ("inertia", ()))).both
    assert not mark(pair, said(("backlash", ("a", "b", "c")), ("inertia", ()))).both


def test_a_second_group_is_no_answer_to_twins() -> None:
    twins = hidden("confounded", "gravity_load", twins=("gravity_load", "joint_stiffness"))
    assert not mark(twins, said(("joint_stiffness", ("gravity_load",)), ("inertia", ("backlash",)))).grouped


def test_a_stranger_is_noticed_or_explained_away() -> None:
    stranger = hidden("outside", outside="sheath_kink")
    assert mark(stranger, said(verdict="unexplained")).flagged
    assert mark(stranger, said(("inertia", ()), verdict="partly_explained")).flagged
    assert mark(stranger, said(("inertia", ()))).falsely_explained
    quiet = mark(stranger, said(verdict="consistent"))
    assert (quiet.flagged, quiet.falsely_explained) == (False, False)


@pytest.mark.parametrize(("after", "described"), [(0.35, True), (0.7, False)])
def test_a_formula_describes_a_stranger_when_it_takes_most_of_what_is_left(after: float, described: bool) -> None:
    """A formula describes a cause if it explains at least 70 % of the residual above the noise.

    The mean square is 1, of which 0.04 is noise. The formula explains 91 or 53 % of the rest.
    """
    stranger = hidden("outside", outside="sheath_kink", noise=0.2)
    formula = {"rms": {"before": 1.0, "after": after, "unit": "N*m", "held_out": True}}
    assert mark(stranger, said(verdict="unexplained", formula=formula)).described is described
    assert mark(stranger, said(verdict="unexplained", formula=None)).described is False


def test_twins_ask_for_a_group_and_an_experiment() -> None:
    twins = hidden("confounded", "gravity_load", twins=("gravity_load", "joint_stiffness"))
    group = mark(twins, said(("joint_stiffness", ("gravity_load",)), experiment="move further"))
    assert (group.grouped, group.advised, group.wrong) == (True, True, False)
    name = mark(twins, said(("gravity_load", ())))
    assert (name.grouped, name.advised, name.wrong) == (False, False, True)
    assert mark(twins, said(verdict="insufficient")).grouped
    assert not mark(twins, said(verdict="consistent")).grouped


def test_what_recalibration_takes_up_may_be_called_consistent() -> None:
    twins = hidden("confounded", "motor_side_friction", twins=("motor_side_friction", "parameter_error"))
    assert mark(twins, said(verdict="consistent")).grouped
    assert mark(twins, said(("motor_side_friction", ("parameter_error",)))).grouped
    assert not mark(twins, said(("motor_side_friction", ()))).grouped


def test_twins_that_differ_a_little_may_be_named() -> None:
    twins = hidden("confounded", "transport_delay", twins=("transport_delay", "backlash"), exact=False)
    assert mark(twins, said(("transport_delay", ()))).grouped
    assert mark(twins, said(("backlash", ()))).wrong


def test_the_experiment_resolves_when_it_names_the_truth_alone() -> None:
    twins = hidden("confounded", "gravity_load", twins=("gravity_load", "joint_stiffness"))
    first = said(("gravity_load", ("joint_stiffness",)), experiment="move further")
    assert mark(twins, first, said(("gravity_load", ()))).resolved
    assert not mark(twins, first, said(("gravity_load", ("joint_stiffness",)))).resolved


def test_intervals_are_checked_against_the_hidden_parameter() -> None:
    report = said(("viscous_friction", ()))
    report["causes"][0]["parameters"] = {"coefficient": {"value": 0.45, "low": 0.4, "high": 0.49, "unit": "N*m*s/rad"}}
    assert mark(hidden("single", "viscous_friction"), report).covered == {"viscous_friction.coefficient": False}


def test_base_numbers_are_checked_on_logs_without_effect() -> None:
    errors = {"friction_angle": {"nominal": 0.25, "value": 0.3, "low": 0.29, "high": 0.31, "unit": "1"}}
    report = said(verdict="consistent", parameter_errors=errors)
    assert mark(hidden("none"), report).covered == {"friction_angle": True}


@pytest.mark.parametrize(("count", "total", "low", "high"), [(0, 400, 0.0, 0.00918), (95, 100, 0.8872, 0.9836)])
def test_binomial_intervals_are_exact(count: int, total: int, low: float, high: float) -> None:
    """The intervals agree with the tabulated limits of Clopper and Pearson."""
    assert interval(count, total) == pytest.approx((low, high), abs=2e-4)


def test_only_the_family_of_a_target_counts() -> None:
    wrong = {"family": "none", "name": "rich", "mark": {"named": True}, "error": ""}
    other = {"family": "single", "name": "inertia", "mark": {"named": True}, "error": ""}
    assert counted(TARGETS[0], [wrong, other]) == (1, 1)


@pytest.mark.parametrize(
    ("begins", "counts"),
    [("a function of an instant", (1, 2)), ("with a filter's memory", (1, 1)), ("by a clock", (0, 1))],
)
def test_a_line_of_some_kinds_counts_these_alone(begins: str, counts: tuple[int, int]) -> None:
    target = next(target for target in FURTHER if target.text.startswith(f"of these, {begins}"))
    marks = [
        ("bridge_asymmetry", True),
        ("oval_pulley", False),
        ("sensor_resonance", True),
        ("zero_drift", False),
        ("anchor_slip", False),
    ]
    rows = [{"family": "outside", "name": name, "mark": {"described": told}} for name, told in marks]
    assert counted(target, rows) == counts
