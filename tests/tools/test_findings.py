"""Tables of what once went wrong: what a command says is picked from what it prints; one that breaks ends the table."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import answers
from tools.answers import Case
from tools.manual import tables
from tools.measured import findings


def test_what_matters_is_picked_once_and_a_missing_line_is_told(tmp_path: Path) -> None:
    line = "echo one; echo two; echo one >&2; exit 2"
    assert answers.said(Case(1, "", line, "^one"), tmp_path) == "one"
    with pytest.raises(SystemExit, match=r"nothing of '\^three' in what it printed: one"):
        answers.said(Case(1, "", line, "^three"), tmp_path)


@pytest.mark.parametrize("line", ["echo broken >&2; exit 3", "echo Traceback, broken >&2"])
def test_a_command_that_breaks_ends_the_table(tmp_path: Path, line: str) -> None:
    with pytest.raises(SystemExit, match="broken"):
        answers.said(Case(1, "", line, "x"), tmp_path)


def test_a_row_shows_the_command_as_it_was_run(tmp_path: Path) -> None:
    assert answers.rows(tmp_path, [Case(3, "was wrong", "tsa stat", "^tsa")]) == [
        ("3", "was wrong", "`tsa stat`", "tsa: No such command 'stat'; did you mean 'status'? (see 'tsa --help')")
    ]


def test_the_longest_first_sentence_is_counted() -> None:
    lines = [
        ("1", "", "`tsa diagnose a`", "One two three. More of it is not counted."),
        ("2", "", "`tsa diagnose b`", "One two."),
        ("3", "", "`tsa simulate`", "x " * 50),
    ]
    assert findings.longest(lines)[-1] == "at most 3 words"


def test_the_manual_reads_the_table_that_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    answers.show([("1", "units in a head", "`tsa x`", "Zeit [s] | deg │ 3.0  │")])
    assert tables.cells(capsys.readouterr().out)[1] == ["1", "units in a head", "`tsa x`", "Zeit [s] ¦ deg 3.0"]


@pytest.mark.slow
def test_a_measured_log_of_another_rate_is_taken(tmp_path: Path, data_dir: Path) -> None:
    findings.prepare(data_dir, tmp_path)
    slow = next(each for each in findings.CASES if "7.8 Hz" in each.found)
    assert "samples at 7.8125 Hz" in answers.said(slow, tmp_path)
    assert len(list((tmp_path / "twice").iterdir())) == 2 * len(list((tmp_path / "davinci").glob("*.csv.gz")))
