"""The command that takes a folder of logs through an interruption, on a small folder."""

from __future__ import annotations

import subprocess

import pytest

from tests.conftest import ROOT


@pytest.mark.slow
@pytest.mark.soak  # an interruption, what is gone on with and the table: tests/identify/test_fleet.py
def test_every_log_is_answered_once_though_it_was_interrupted() -> None:
    told = subprocess.run(
        [ROOT / "tools" / "run", "bench/fleet", "--logs", "2", "--jobs", "1"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stdout + told.stderr
    assert "2 questions for 2 logs" in told.stdout
    assert "then Ctrl-C: exit code 1" in told.stdout
    assert told.stdout.splitlines()[-1].split() == ["all", "2", "2", "2", "0", "0"]
