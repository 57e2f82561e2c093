"""Latencies of set-points from what the client changed and what the bus showed."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tools.bench.client import daemon, matched
from tsa_ctrl.errors import BusError


def test_a_change_is_matched_with_the_first_command_that_shows_it_before_the_next_change() -> None:
    changes = [(1.0, 1), (2.0, -1), (3.0, 1), (4.0, -1)]
    seen = [(0.5, 1), (0.9, -1), (1.25, 1), (1.5, 1), (3.5, 1), (4.5, -1)]
    assert list(matched(changes, seen)) == [0.25, math.inf, 0.5]


@pytest.mark.parametrize("changes", [[], [(1.0, 1)]])
def test_a_client_that_changed_nothing_has_no_latency(changes: list[tuple[float, int]]) -> None:
    assert list(matched(changes, [(1.5, 1)])) == []


@pytest.mark.slow
def test_a_daemon_that_does_not_come_up_is_one_line_with_what_it_said(tmp_path: Path) -> None:
    words = r"it did not come up; the daemon said last: .*controller.toml"
    with pytest.raises(BusError, match=words) as found, daemon(tmp_path, str(tmp_path / "tsa.sock")):
        pass
    assert "\n" not in str(found.value)
