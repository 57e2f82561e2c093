"""Check the diagnosis on a small blind benchmark. `tools/run bench/diagnose` runs the large one.

The random trials are fixed, so that a count changes only with the code. The limits follow from the targets and the
number of cases.

Each change of the code is tested on the cases of `EACH_CHANGE`: one case of each effect, a third of the causes outside
the catalogue, two logs of each kind without an effect, and three pairs.

In the table, the share of right answers falls from the target to the second figure. The last column contains the
probability in per cent that the test then fails (calculated by `test_a_diagnosis_that_got_worse_fails`):

    one effect named alone          0.95 -> 0.7    97
    within two alternatives         0.99 -> 0.8    97
    noticed outside the catalogue   0.80 -> 0.4    68
    not explained away              0.95 -> 0.6    66
    both of two effects             0.90 -> 0.5    50
    no structure without an effect  0.95 -> 0.8    79

`tools/test -m soak` has two to four times as many cases (`WHOLE`).
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

SEED = 5000  # seed of the first random trial; these seeds were not used in development
UNLIKELY = 0.02  # a count fails if its probability under the target share is smaller


class Sample(NamedTuple):
    """Number of random trials of each family."""

    none: int
    single: int
    outside: tuple[str, ...]
    pairs: int
    # threshold of the probability; the trials are fixed, so each version always passes or always fails
    unlikely: float

    @property
    def singles(self) -> int:
        return self.single * len(FAMILIES["single"])


EACH_CHANGE = Sample(20, 1, FAMILIES["outside"][::3], 3, 0.08)
WHOLE = Sample(40, 2, FAMILIES["outside"], 8, UNLIKELY)
sampled = pytest.mark.parametrize(
    "of", [pytest.param(EACH_CHANGE, id="each change"), pytest.param(WHOLE, id="whole", marks=pytest.mark.soak)]
)
none = pytest.mark.xdist_group("gate none")
single = pytest.mark.xdist_group("gate single")
others = pytest.mark.xdist_group("gate none")


def ask(hidden: Case) -> dict[str, Any]:
    """Diagnose the logs of a case and return the contents of diagnosis.json."""
    logs = {log.name: log.columns for log in hidden.logs}
    report: dict[str, Any] = json.loads(diagnose(logs, model_from(tomllib.loads(hidden.model), "nominal")).to_json())
    return report


class Answer(NamedTuple):
    """A case with its report and marks."""

    key: str
    effects: dict[str, Any]  # hidden effects
    report: dict[str, Any]
    marks: Mark


@cache
def asked(family: str, name: str, seed: int) -> Answer:
    """Return the answer to a case. The answer is cached, so that each case is diagnosed only once."""
    hidden = case(family, name, seed, short=True)
    report = ask(hidden)
    experiment = None if hidden.experiment is None else ask(hidden.experiment)
    return Answer(hidden.key, hidden.truth.effects, report, mark(hidden, report, experiment))


def answers(family: str, count: int, names: tuple[str, ...] = ()) -> list[tuple[str, Mark, str]]:
    """Return key, marks and verdict for `count` cases of a family, using its names or the given ones in turn."""
    names = names or FAMILIES[family]
    found = [asked(family, names[i % len(names)], SEED + i // len(names)) for i in range(count)]
    return [(each.key, each.marks, each.report["verdict"]) for each in found]


def likely(count: int, total: int, share: float, unlikely: float = UNLIKELY) -> bool:
    """Return True if `count` of `total` is consistent with a share of at least `share`."""
    return bool(binom.cdf(count, total, share) > unlikely)


@pytest.mark.slow
@none
@sampled
def test_nothing_is_named_where_nothing_is_hidden(of: Sample) -> None:
    assert [key for key, marks, _ in answers("none", of.none) if marks.named] == []


@pytest.mark.slow
@none
@sampled
def test_no_structure_is_claimed_where_nothing_is_hidden(of: Sample) -> None:
    claimed = [key for key, _, verdict in answers("none", of.none) if verdict not in ("consistent", "insufficient")]
    assert likely(of.none - len(claimed), of.none, 0.95, of.unlikely), claimed


@pytest.mark.slow
@none
@sampled
@pytest.mark.parametrize("number", ["slope", "half_loop_torque"])
def test_what_logs_know_of_the_base_has_an_interval_that_holds_it(of: Sample, number: str) -> None:
    """The intervals of slope and friction torque contain the true values with the required frequency.

    Logs of one configuration determine these two numbers independently of the file's x, but they do not determine x
    or T_p.
    """
    held = [marks.covered[number] for _, marks, _ in answers("none", of.none) if number in marks.covered]
    assert len(held) >= of.none // 2
    assert likely(sum(held), len(held), 0.95, of.unlikely)


@pytest.mark.slow
@single
@sampled
@pytest.mark.parametrize(
    ("well", "target"),
    [
        pytest.param(lambda marks: marks.unique, 0.95, id="named alone"),
        pytest.param(lambda marks: marks.within, 0.99, id="within the name and two alternatives"),
        pytest.param(lambda marks: not marks.wrong, 0.99, id="hardly a wrong name is sure"),
    ],
)
def test_one_effect_is_named(well: Callable[[Mark], bool], target: float, of: Sample) -> None:
    found = answers("single", of.singles)
    missed = [key for key, marks, _ in found if not well(marks)]
    assert likely(len(found) - len(missed), len(found), target, of.unlikely), missed


@pytest.mark.slow
@single
@sampled
def test_intervals_cover(of: Sample) -> None:
    found = [inside for _, marks, _ in answers("single", of.singles) for inside in marks.covered.values()]
    assert len(found) >= of.singles
    assert likely(sum(found), len(found), 0.93, of.unlikely), f"{sum(found)} of {len(found)}"


@pytest.mark.slow
@others
@sampled
def test_a_cause_outside_the_catalogue_is_noticed(of: Sample) -> None:
    found = answers("outside", len(of.outside), of.outside)
    missed = [key for key, marks, _ in found if not marks.flagged]
    assert likely(len(found) - len(missed), len(found), 0.80, of.unlikely), missed


@pytest.mark.slow
@others
@sampled
def test_a_cause_outside_the_catalogue_is_not_explained_away(of: Sample) -> None:
    found = answers("outside", len(of.outside), of.outside)
    explained = [key for key, marks, _ in found if marks.falsely_explained]
    assert likely(len(found) - len(explained), len(found), 0.95, of.unlikely), explained


@pytest.mark.slow
@others
def test_a_rival_that_needs_a_column_which_was_not_recorded_is_no_error() -> None:
    assert ask(case("outside", "sensor_dead_zone", 7001, short=True))["verdict"] in ("partly_explained", "unexplained")


@pytest.mark.slow
@others
@sampled
def test_two_effects_are_both_named(of: Sample) -> None:
    found = answers("pair", of.pairs)
    missed = [key for key, marks, _ in found if not marks.both]
    assert likely(len(found) - len(missed), len(found), 0.90, of.unlikely), missed


@pytest.mark.slow
@others
@pytest.mark.parametrize(
    "row",
    [
        "weight_or_spring",
        "relaxation_or_warmth",
        "gain_or_parameters",
        # tests/identify/diagnosis/test_pipeline.py covers it as well
        pytest.param("elongation_or_gain", marks=pytest.mark.soak),
        pytest.param("load_or_asymmetry", marks=pytest.mark.soak),
    ],
)
def test_twins_are_a_group_and_an_experiment_is_named(row: str) -> None:
    hidden = case("confounded", row, SEED, short=True)
    marks = mark(hidden, ask(hidden))
    assert (marks.grouped, marks.advised) == (True, True)


@pytest.mark.slow
@pytest.mark.soak  # tests the gate and not the diagnosis
def test_a_strategy_that_always_names_something_does_not_pass() -> None:
    """On logs without an effect, the BIC baseline strategy reports an effect, so it would fail the gate."""
    drawn = [case("none", name, SEED, short=True) for name in FAMILIES["none"][:4]]
    assert any(name_effects(hidden.logs, hidden.model)["bic"] for hidden in drawn)


@pytest.mark.parametrize(("count", "share"), [(38, 0.95), (7, 0.80)])
def test_too_few_right_answers_are_a_failure(count: int, share: float) -> None:
    total = {0.95: 46, 0.80: 14}[share]
    assert not likely(count, total, share)
    assert likely(int(np.ceil(share * total)), total, share)


@pytest.mark.parametrize(
    ("total", "target", "worse", "told"),
    [
        pytest.param(EACH_CHANGE.singles, 0.95, 0.7, 0.97, id="one effect named alone"),
        pytest.param(EACH_CHANGE.singles, 0.99, 0.8, 0.97, id="within two alternatives"),
        pytest.param(len(EACH_CHANGE.outside), 0.80, 0.4, 0.68, id="noticed outside the catalogue"),
        pytest.param(len(EACH_CHANGE.outside), 0.95, 0.6, 0.66, id="not explained away"),
        pytest.param(EACH_CHANGE.pairs, 0.90, 0.5, 0.50, id="both of two effects"),
        pytest.param(EACH_CHANGE.none, 0.95, 0.8, 0.79, id="no structure without an effect"),
    ],
)
def test_a_diagnosis_that_got_worse_fails(total: int, target: float, worse: float, told: float) -> None:
    """The probability that the gate detects a worse diagnosis equals the value in the table of this module."""
    failures = [count for count in range(total + 1) if not likely(count, total, target, EACH_CHANGE.unlikely)]
    assert int(100.0 * float(np.sum(binom.pmf(failures, total, worse)))) == round(100.0 * told)
