"""The runaway campaign: slices of a healthy hour are kept and added up, and cells of the scan are drawn and judged."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from tools.campaign import runaway
from tools.campaign.passive import changes, scan, tracking
from tools.campaign.passive.cases import Case
from tools.campaign.passive.experiment import INERTIA
from tools.campaign.passive.healthy import LOADS
from tools.campaign.passive.judge import windows
from tools.manual.tables import cells
from tsa_ctrl.errors import UsageError

TWO_MINUTES = ("runaway", "healthy", "--seconds", "120", "--sensors", "encoder", "--rows")


def _rows(path: Path, said: dict[str, list[str]]) -> Path:
    """Two slices of a minute on each load; what was said in the second."""
    slices = [(load, number) for load in LOADS for number in (1, 2)]
    rows = [
        {
            "sensors": "encoder",
            "healthy": load,
            "slice": number,
            "seconds": 60.0,
            "compensation": 0.95,
            "said": said.get(load, []) if number == 2 else [],
        }
        for load, number in slices
    ]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    return path


def test_what_was_run_is_not_run_again_and_adds_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = _rows(tmp_path / "rows.jsonl", {})
    before = rows.read_bytes()
    monkeypatch.setattr(sys, "argv", [*TWO_MINUTES, str(rows), "--loads", *LOADS])
    assert runaway.main() == 0
    table = cells(capsys.readouterr().out.partition("\n")[2])
    assert [line[1] for line in table[1:]] == list(LOADS)
    assert {(line[0], *line[2:]) for line in table[1:]} == {("encoder", "120", "2", "nothing")}
    assert rows.read_bytes() == before


def test_one_word_on_one_load_is_a_goal_missed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = _rows(tmp_path / "rows.jsonl", {"limb": ["passivity: 80 % of what the model file says"]})
    monkeypatch.setattr(sys, "argv", [*TWO_MINUTES, str(rows)])
    assert runaway.main() == 1
    table = {line[1]: line[-1] for line in cells(capsys.readouterr().out.partition("\n")[2])[1:]}
    assert table["limb"] == "passivity: 80 % of what the model file says"
    assert table["weight"] == "nothing"


def test_a_cell_of_the_scan_without_compensation_comes_to_rest_and_is_given_no_work() -> None:
    fixed = {"centre": 0.5, "delay": 1, "motor_bits": 16, "joint_bits": 20}
    (cell,) = scan.cells(1, ["encoder"], ["free"], ["zero"], ["friction"], [0.3], fixed)
    row = scan.Judge(0.0, "bench", 0.2, {}, {})(cell)
    assert row["speed"] == 0.0
    assert row["work"] < 1e-3
    assert row["peak"] > 0.5
    assert scan.good(row)


def test_the_same_seed_draws_the_same_rig_for_a_cell_whatever_other_cells_there_are() -> None:
    chosen = (["zero"], ["friction"])
    one = scan.cells(5, ["encoder"], ["limb"], *chosen, [0.3], {})
    many = scan.cells(5, scan.SENSORS, tuple(INERTIA), *chosen, scan.SHARES, {})
    assert one[0] in many
    assert one != scan.cells(6, ["encoder"], ["limb"], *chosen, [0.3], {})


def test_work_counts_in_the_window_that_makes_it_largest() -> None:
    assert windows(np.array([-5.0, 2.0, 1.0, -4.0, 2.5, -0.5])).tolist() == [-5.0, 2.0, 3.0, -1.0, 2.5, 2.0]


@pytest.mark.parametrize(
    ("case", "most"),
    [
        (Case("sensor", "weight", "zero", "friction", 0.5, 1, 1.2), 10e-3),
        (Case("encoder", "free", "sine", "friction", 0.1, 1, 3.0), 60e-3),
        (Case("encoder", "limb", "sine", "pretension", 0.5, 1, 3.0), 30e-3),
        (Case("encoder", "limb", "sine", "pretension", 0.5, 1, 1.0), None),
        (Case("encoder", "limb", "sine", "torque_gain", 2.0, 1, 3.0), None),
        (Case("motor", "limb", "sine", "friction", 0.1, 1, 3.0), None),
    ],
)
def test_work_has_a_goal_where_sensors_can_show_a_loss(case: Case, most: float | None) -> None:
    assert case.most == most


def test_an_error_that_grows_against_another_revision_is_a_goal_missed() -> None:
    before = {"first": 90.0, "confirmed": 50.0, "again": 50.0}
    assert tracking.missed({"first": 200.0, "confirmed": 59.0, "again": 64.0}, before) == []
    assert tracking.missed({"first": 200.0, "confirmed": 61.0, "again": 66.0}, before) == ["confirmed", "again"]
    assert tracking.missed({"loss": 6.0}, {"loss": 0.0}) == ["loss"]
    assert tracking.missed({"confirmed": float("nan"), "again": 50.0}, before) == ["confirmed"]


@pytest.mark.parametrize("text", ["friction", "friction=0", "nonsense=1", "bending=x"])
def test_a_change_that_is_none_is_one_clear_line(text: str) -> None:
    with pytest.raises(UsageError, match=f"--changes {text}: allowed are"):
        changes.change_of(text)
