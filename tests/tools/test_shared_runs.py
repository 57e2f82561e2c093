"""Two runs of pytest that share their tests, as tools/test does on two vcans, and two workers of one run."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import claimed


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
