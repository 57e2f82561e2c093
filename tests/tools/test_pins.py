"""tools/run pins: kinds of differences, rows that are not compared, the cheap rows against the committed digests."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT
from tools import pins

ROW = {"rms": 0.25, "tau": [1.0, -2.0, 1e-3], "effect": "backlash", "notes": ["two words"], "sha256": "ab"}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"sha256": "cd"}, "equal"),
        ({"rms": 0.25 * (1.0 + 1e-12)}, "equal"),
        ({"tau": [1.0, -2.0, 1e-3 + 1e-9]}, "values differ"),
        ({"effect": "inertia"}, "values differ"),
        ({"notes": ["two other words"]}, "text differs"),
        ({"more": None}, "values differ"),
    ],
)
def test_a_row_is_equal_or_its_values_or_only_its_sentences_differ(change: dict[str, object], expected: str) -> None:
    assert pins.outcome({**ROW, **change}, pins.digest(ROW), True) == expected
    assert pins.compared(ROW, {**ROW, **change}).partition(":")[0] == expected


def test_an_absent_data_set_another_machine_and_a_new_row_are_not_compared() -> None:
    found = [
        pins.outcome(None, pins.digest(ROW), True),
        pins.outcome(ROW, pins.digest(ROW), False),
        pins.outcome(ROW, None, True),
        pins.compared(None, ROW),
        pins.compared(ROW, None),
    ]
    assert all(each.startswith("not compared: ") for each in found)


def test_the_change_of_a_sample_is_relative_to_the_largest_one_of_its_column() -> None:
    result = pins.compared(ROW, {**ROW, "rms": 0.3, "tau": [1.0, -2.0, 1.001]})
    assert "2 of 6; largest relative change 0.5 at .tau[2]" in result


def test_a_changed_name_is_printed_with_both_values() -> None:
    assert "; .effect: backlash -> inertia" in pins.compared(ROW, {**ROW, "effect": "inertia"})


def test_every_case_has_a_digest_or_needs_measured_data() -> None:
    rows = [row for job in pins.jobs() for row in job.rows]
    kept = json.loads(pins.FILE.read_text(encoding="utf-8"))["rows"]
    assert len(set(rows)) == len(rows)
    assert not kept.keys() - set(rows), "the file has digests of cases that are gone; tools/run pins --write"
    missing = set(rows) - kept.keys()
    assert all(row.startswith("a measured ") or "leg" in row for row in missing), missing


@pytest.mark.slow
@pytest.mark.soak  # the digests of this commit are not written yet: tools/run pins --write
def test_the_cheap_rows_are_as_committed() -> None:
    """After a change of results on purpose: tools/run pins --write, and the commit names the rows."""
    kept = json.loads(pins.FILE.read_text(encoding="utf-8"))
    if kept["machine"] != pins.machine():
        pytest.skip("not compared: the digests are of other versions or another processor")
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    call = [sys.executable, str(ROOT / "tools"), "pins", "--quick", "--processes", "1"]
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
