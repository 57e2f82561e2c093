"""Compare the cases and the fast rows of tools/run pins with the committed digests."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT
from tools import pins


def test_every_case_has_a_digest_or_needs_measured_data() -> None:
    rows = [row for job in pins.jobs() for row in job.rows]
    kept = json.loads(pins.FILE.read_text(encoding="utf-8"))["rows"]
    assert len(set(rows)) == len(rows)
    assert not kept.keys() - set(rows), "the file has digests of cases that are gone; tools/run pins --write"
    missing = set(rows) - kept.keys()
    assert all(row.startswith("a measured ") or "leg" in row for row in missing), missing


@pytest.mark.slow
def test_the_cheap_rows_are_as_committed() -> None:
    """If a change of results is intended, run tools/run pins --write and list the rows in the commit message."""
    kept = json.loads(pins.FILE.read_text(encoding="utf-8"))
    if kept["machine"] != pins.machine():
        pytest.skip("not compared: the digests are of other versions or another processor")
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    call = [sys.executable, str(ROOT / "tools"), "pins", "--quick", "--processes", "1"]
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
