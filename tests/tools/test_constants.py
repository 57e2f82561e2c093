"""bench/constants: which numbers a name stands for, and that a changed one is changed where it is used, and back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.blind import FAMILIES, Case, case
from tools.bench import constants
from tools.bench.results import Row
from tools.bench.thresholds import Constant, asked_for, changed, scaled
from tsa_ctrl.identify.diagnosis.fitting import fit as fitting
from tsa_ctrl.identify.diagnosis.rivals import elsewhere
from tsa_ctrl.identify.diagnosis.selection import entry

FOLDS = Constant("tsa_ctrl.identify.diagnosis.selection.entry", "FOLDS")


def test_a_name_stands_for_one_number_and_a_module_for_all() -> None:
    assert asked_for("diagnosis.selection.entry.FOLDS") == [FOLDS]
    every = {str(each) for each in asked_for("diagnosis.selection.entry")}
    assert {"diagnosis.selection.entry.BLOCK_T", "diagnosis.selection.entry.MOST_LEFT"} <= every
    with pytest.raises(SystemExit, match="no number of that name"):
        asked_for("diagnosis.selection.entry.LATE")


def test_a_changed_number_is_changed_where_it_is_imported_and_is_as_it_was_afterwards() -> None:
    assert entry.FOLDS == elsewhere.FOLDS == 6
    with changed(FOLDS, 2.0):
        assert entry.FOLDS == elsewhere.FOLDS == 12
    with pytest.raises(ZeroDivisionError), changed(FOLDS, 0.5):
        raise ZeroDivisionError
    assert entry.FOLDS == elsewhere.FOLDS == 6


@pytest.mark.parametrize(
    ("value", "factor", "wanted"),
    [(4.0, 0.5, 2.0), (5, 0.5, 2), (1, 0.5, 1), ((2.0, 6), 2.0, (4.0, 12)), (-0.5, 2.0, -1.0)],
)
def test_whole_numbers_stay_whole_and_above_0(value: object, factor: float, wanted: object) -> None:
    assert scaled(value, factor) == wanted


def test_a_default_argument_is_changed_too_and_is_as_it_was_afterwards() -> None:
    with changed(Constant("tsa_ctrl.identify.diagnosis.fitting.fit", "ITERATIONS"), 0.5):
        assert fitting.fit.__defaults__ == (6,)
    assert fitting.fit.__defaults__ == (12,)


def test_every_module_that_decides_is_there_with_its_numbers() -> None:
    assert all(asked_for(text) for text in constants.DECIDING)
    assert sum(constants.COUNTS.values()) == 12
    assert set(constants.COUNTS) == set(FAMILIES)


def test_a_louder_log_has_so_much_more_noise_in_its_torque_and_nothing_else() -> None:
    hidden = case("rigid", "inertia", 7000, True)
    louder = constants.noisier(hidden, 2.0)
    before, after = hidden.logs[0].columns, louder.logs[0].columns
    assert float(np.std(after["tau_m"] - before["tau_m"])) == pytest.approx(np.sqrt(3.0) * hidden.truth.noise, rel=0.05)
    assert [name for name in before if not np.array_equal(before[name], after[name])] == ["tau_m"]
    assert np.array_equal(constants.noisier(hidden, 1.0).logs[0].columns["tau_m"], before["tau_m"])


@pytest.mark.parametrize(("beyond", "steps"), [(False, 2), (True, 3)])
def test_a_log_at_the_edge_is_the_last_that_is_right_or_the_next(
    monkeypatch: pytest.MonkeyPatch, beyond: bool, steps: int
) -> None:
    hidden = case("rigid", "inertia", 7000, True)
    made = {id(hidden): 0}

    def noisier(_: Case, factor: float) -> Case:
        found = dataclasses.replace(hidden)
        made[id(found)] = round(2.0 * np.log2(factor))
        keep.append(found)
        return found

    keep: list[Case] = []
    monkeypatch.setattr(constants, "noisier", noisier)
    monkeypatch.setattr(constants, "answers", lambda cases: [{"right": made[id(cases[0])] <= 2}])
    assert made[id(constants.at_the_edge(hidden, beyond))] == steps


def test_answers_are_compared_log_by_log() -> None:
    told, base = (
        [answer("a", True, "x", 1), answer("b", False, "y", 2)],
        [answer("a", True, "x", 1), answer("b", True, "", 3)],
    )
    found = constants.compared(told, base)
    assert (found["right"], found["lost"], found["won"], found["renamed"], found["touched"]) == (1, ["b"], [], ["b"], 1)


def test_the_table_has_what_renames_first_and_of_the_newest_code_alone() -> None:
    base = {"constant": "", "factor": 1.0, "version": "new", "date": "today", "commit": "abc", "answers": []}
    rows = [
        {**base, "answers": [answer("a", True, "x", 1)]},
        *(changed_row("still.A", factor, 1, [], 0) for factor in (0.5, 2.0)),
        *(changed_row("moves.B", factor, 0, ["a"], 1) for factor in (0.5, 2.0)),
        changed_row("half.C", 0.5, 1, [], 1),
        *({**changed_row("old.D", factor, 1, [], 1), "version": "old"} for factor in (0.5, 2.0)),
    ]
    assert constants.table(rows)[1] == [
        ("`moves.B`", "3", "0, 1, 1", "0, 1, 1", "a"),
        ("`still.A`", "3", "1, 0, 0", "1, 0, 0", ""),
        ("all as they are: 1 logs; 2 numbers; today, abc", "", "1, 0, 0", "1, 0, 0", ""),
    ]


def answer(hidden: str, right: bool, name: str, said: int) -> Row:
    return {"hidden": hidden, "right": right, "named": [[name]], "said": str(said), "seconds": 1.0}


def changed_row(name: str, factor: float, right: int, renamed: list[str], touched: int) -> Row:
    found = {
        "right": right,
        "renamed": renamed,
        "touched": touched,
        "version": "new",
        "value": "3",
        "lost": [],
        "won": [],
    }
    return {"constant": name, "factor": factor, **found}


def test_what_is_no_number_is_not_scaled() -> None:
    with pytest.raises(TypeError):
        scaled({"half": 1.0}, 0.5)
