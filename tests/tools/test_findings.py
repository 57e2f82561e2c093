"""measured/findings: what a command says is picked from what it prints; one that breaks ends the table."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.measured import findings
from tools.measured.findings import Finding


def test_what_matters_is_picked_and_a_missing_line_is_told(tmp_path: Path) -> None:
    shown = findings.said(Finding(1, "", "simulate missing.csv --model missing.toml", "^tsa: missing"), tmp_path)
    assert shown.startswith("tsa: missing")
    lost = findings.said(Finding(1, "", "simulate missing.csv --model missing.toml", "^RMS"), tmp_path)
    assert lost.startswith("nothing of '^RMS' in: ")


def test_a_command_that_breaks_ends_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(findings, "tsa", lambda: ["sh", "-c", "echo broken >&2; exit 1"])
    with pytest.raises(SystemExit, match="exit status 1: broken"):
        findings.said(Finding(1, "", "simulate", "x"), tmp_path)


def test_the_longest_first_sentence_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = {"diagnose a": "One two three. More of it is not counted.", "diagnose b": "One two.", "simulate": "x " * 50}
    monkeypatch.setattr(findings, "said", lambda finding, place: words[finding.line])
    table = findings.rows(tmp_path, [Finding(1, "", line, "") for line in words])
    assert table[-1][-1] == "at most 3 words"


@pytest.mark.slow
def test_a_measured_log_of_another_rate_is_taken(tmp_path: Path, data_dir: Path) -> None:
    findings.prepare(data_dir, tmp_path)
    slow = next(each for each in findings.FINDINGS if "7.8 Hz" in each.found)
    assert "samples at 7.8125 Hz" in findings.said(slow, tmp_path)
    assert len(list((tmp_path / "twice").iterdir())) == 2 * len(list((tmp_path / "davinci").glob("*.csv.gz")))
