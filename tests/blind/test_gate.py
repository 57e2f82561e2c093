"""The small blind benchmark: what the diagnosis must hold on every change; `tools/run bench/diagnose` is the large one.

Draws are fixed, so a count can only change with the code. The limits are those of the targets for so few cases.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import binom

from tsa_ctrl.identify import diagnose
from tsa_ctrl.model.parameters import model_from

from . import FAMILIES, case
from .cases import Case
from .naive import name_effects
from .score import Mark, mark

SEED = 5000  # first of the draws; nothing was tuned on them
NONE, SINGLE, OUTSIDE, PAIRS = 40, 2, 1, 8  # of none and pairs in all, else per name
UNLIKELY = 0.02  # a count that the target share explains with less than this chance is a failure
none = pytest.mark.xdist_group("gate none")
single = pytest.mark.xdist_group("gate single")
others = pytest.mark.xdist_group("gate none")


def ask(hidden: Case) -> dict[str, Any]:
    """The contents of diagnosis.json."""
    logs = {log.name: log.columns for log in hidden.logs}
    report: dict[str, Any] = json.loads(diagnose(logs, model_from(tomllib.loads(hidden.model), "nominal")).to_json())
    return report


class Answer(NamedTuple):
    """A case with what was said of it."""

    key: str
    effects: dict[str, Any]  # that were hidden
    report: dict[str, Any]
    marks: Mark


@cache
def asked(family: str, name: str, seed: int) -> Answer:
    """A case is drawn and asked once, whoever marks it; its logs are not kept."""
    hidden = case(family, name, seed, short=True)
    report = ask(hidden)
    experiment = None if hidden.experiment is None else ask(hidden.experiment)
    return Answer(hidden.key, hidden.truth.effects, report, mark(hidden, report, experiment))


def answers(family: str, count: int) -> list[tuple[str, Mark, str]]:
    """Case, mark and verdict of `count` cases of a family, its names in turn."""
    names = FAMILIES[family]
    found = [asked(family, names[i % len(names)], SEED + i // len(names)) for i in range(count)]
    return [(each.key, each.marks, each.report["verdict"]) for each in found]


def likely(count: int, total: int, share: float) -> bool:
    """May `count` of `total` come from a share of at least `share`?"""
    return bool(binom.cdf(count, total, share) > UNLIKELY)


@pytest.mark.slow
@none
def test_nothing_is_named_where_nothing_is_hidden() -> None:
    assert [key for key, marks, _ in answers("none", NONE) if marks.named] == []


@pytest.mark.slow
@none
def test_no_structure_is_claimed_where_nothing_is_hidden() -> None:
    claimed = [key for key, _, verdict in answers("none", NONE) if verdict not in ("consistent", "insufficient")]
    assert likely(NONE - len(claimed), NONE, 0.95), claimed


def singles() -> list[tuple[str, Mark, str]]:
    return answers("single", SINGLE * len(FAMILIES["single"]))


@pytest.mark.slow
@single
@pytest.mark.parametrize(
    ("well", "target"),
    [
        pytest.param(lambda marks: marks.unique, 0.95, id="named alone"),
        pytest.param(lambda marks: marks.within, 0.99, id="within the name and two alternatives"),
        pytest.param(lambda marks: not marks.wrong, 0.99, id="hardly a wrong name is sure"),
    ],
)
def test_one_effect_is_named(well: Callable[[Mark], bool], target: float) -> None:
    found = singles()
    missed = [key for key, marks, _ in found if not well(marks)]
    assert likely(len(found) - len(missed), len(found), target), missed


@pytest.mark.slow
@single
def test_intervals_cover() -> None:
    found = [inside for _, marks, _ in singles() for inside in marks.covered.values()]
    assert likely(sum(found), len(found), 0.93), f"{sum(found)} of {len(found)}"


@pytest.mark.slow
@others
def test_a_cause_outside_the_catalogue_is_noticed() -> None:
    found = answers("outside", OUTSIDE * len(FAMILIES["outside"]))
    missed = [key for key, marks, _ in found if not marks.flagged]
    assert likely(len(found) - len(missed), len(found), 0.80), missed


@pytest.mark.slow
@others
def test_a_cause_outside_the_catalogue_is_not_explained_away() -> None:
    found = answers("outside", OUTSIDE * len(FAMILIES["outside"]))
    explained = [key for key, marks, _ in found if marks.falsely_explained]
    assert likely(len(found) - len(explained), len(found), 0.95), explained


@pytest.mark.slow
@others
def test_a_rival_that_needs_a_column_which_was_not_recorded_is_no_error() -> None:
    assert ask(case("outside", "sensor_dead_zone", 7001, short=True))["verdict"] in ("partly_explained", "unexplained")


@pytest.mark.slow
@others
def test_two_effects_are_both_named() -> None:
    found = answers("pair", PAIRS)
    missed = [key for key, marks, _ in found if not marks.both]
    assert likely(len(found) - len(missed), len(found), 0.90), missed


@pytest.mark.slow
@others
@pytest.mark.parametrize(
    "row", ["elongation_or_gain", "weight_or_spring", "relaxation_or_warmth", "load_or_asymmetry", "gain_or_parameters"]
)
def test_twins_are_a_group_and_an_experiment_is_named(row: str) -> None:
    hidden = case("confounded", row, SEED, short=True)
    marks = mark(hidden, ask(hidden))
    assert (marks.grouped, marks.advised) == (True, True)


@pytest.mark.slow
def test_a_strategy_that_always_names_something_does_not_pass() -> None:
    """The gate's first demand, put to a naive strategy on the same logs."""
    drawn = [case("none", name, SEED, short=True) for name in FAMILIES["none"][:4]]
    assert any(name_effects(hidden.logs, hidden.model)["bic"] for hidden in drawn)


@pytest.mark.parametrize(("count", "share"), [(38, 0.95), (7, 0.80)])
def test_too_few_right_answers_are_a_failure(count: int, share: float) -> None:
    total = {0.95: 46, 0.80: 14}[share]
    assert not likely(count, total, share)
    assert likely(int(np.ceil(share * total)), total, share)
