"""bench/constants: which numbers a name stands for, and that a changed one is changed where it is used, and back."""

from __future__ import annotations

import pytest

from tools.bench.constants import Constant, asked_for, changed, scaled
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


def test_what_is_no_number_is_not_scaled() -> None:
    with pytest.raises(TypeError):
        scaled({"half": 1.0}, 0.5)
