"""Two runs of pytest that share their tests, as tools/test does on two vcans, and two workers of one run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import CLAIMS, ROOT, claimed

MODULE = """
import pytest

@pytest.fixture(scope="module", autouse=True)
def made():
    yield

def test_one(): pass
def test_two(): pass
def test_three(): assert False
"""


def test_a_test_is_claimed_once(tmp_path: Path) -> None:
    assert claimed(tmp_path, "tests/x.py::y[1]")
    assert not claimed(tmp_path, "tests/x.py::y[1]")
    assert claimed(tmp_path, "tests/x.py::y[2]")


@pytest.mark.xdist_group("one worker")
def test_a_group_of_tests_has_one_worker(request: pytest.FixtureRequest) -> None:
    """pytest-xdist deals by names, to which it adds the group: without it each worker makes a module's fixtures."""
    grouped = bool(getattr(request.config.option, "loadgroup", False))
    assert request.node.nodeid.endswith("@one worker") == grouped


@pytest.fixture(scope="module")
def made() -> object:
    return object()


def test_who_shares_a_fixture_shares_a_worker(made: object, request: pytest.FixtureRequest) -> None:
    grouped = bool(getattr(request.config.option, "loadgroup", False))
    assert request.node.nodeid.endswith("@tests/tools/test_shared_runs.py") == grouped


@pytest.mark.slow
def test_what_the_other_run_has_begun_is_left_to_it(tmp_path: Path) -> None:
    """The rest is run, a module's fixtures are set up and torn down around it, and a failure is one."""
    (tmp_path / "test_it.py").write_text(MODULE)
    claims = tmp_path / "claims"
    claims.mkdir()
    claimed(claims, "test_it.py::test_two")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.conftest", "-p", "no:cacheprovider", "--rootdir=."]
    environment = {**os.environ, CLAIMS: str(claims), "PYTHONPATH": str(ROOT)}
    for said, code in (("1 failed, 1 passed", 1), ("no tests ran", 0)):
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert said in done.stdout
        assert done.returncode == code
