"""Test that each warning of a drive becomes one event and does not stop the loop."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.virtual.joints import play
from tsa_ctrl.daemon.notices import AGAIN, AxisNotices, Events
from tsa_ctrl.virtual.script import Change


def said(words: list[tuple[float, int]]) -> list[tuple[float, str]]:
    """Return the times and texts of the events for a sequence of (time, statusword).

    The loop checks the statusword fifty times per second.
    """
    axis: Any = SimpleNamespace(name="knee", image=SimpleNamespace(statusword=0, nodes=["drive node 1"]))
    events = Events()
    notices = AxisNotices(axis, events)
    for t, word in words:
        axis.image.statusword = word
        notices.update_statusword(t)
    assert not events.faults
    assert {event.axis for event in events.all} <= {"knee"}
    return [(event.t, event.text) for event in events.all]


def test_a_warning_and_a_limit_of_the_drive_are_told_when_each_begins() -> None:
    found = said([(0.0, 0x1237), (0.5, 0x1A37), (0.52, 0x1A37), (1.0, 0x1AB7), (21.0, 0x1237)])
    assert [t for t, _ in found] == [0.5, 1.0]
    assert "is at an internal limit (bit 11 of statusword 0x1a37)" in found[0][1]
    assert found[1][1].startswith("drive node 1 warns (bit 7 of statusword 0x1ab7)")


def test_a_bit_that_flaps_is_told_every_ten_seconds() -> None:
    flapping = [(0.02 * n, 0x1A37 if n % 2 else 0x1237) for n in range(1500)]
    times = [t for t, _ in said(flapping)]
    assert len(times) == 3
    assert all(after - before >= AGAIN for before, after in itertools.pairwise(times))


@pytest.mark.slow
def test_a_drive_that_gives_less_says_so_and_a_healthy_one_nothing(tmp_path: Path) -> None:
    constant = {"kind": "constant", "offset": 0.8}
    for faults, told in (((), 0), (("derating value=0.5@0.8",), 1)):
        result = play(tmp_path, "held", constant, 1.2, faults=list(faults))
        texts = [event.text for event in result.summary.events if "bit 11" in event.text]
        assert len(texts) == told


@pytest.mark.parametrize("asked", [1.31, 1.42, 1.55])
def test_losses_before_a_recovery_are_not_counted_after_it(tmp_path: Path, asked: float) -> None:
    """The nodes have no power for 0.4 s. The loop counts losses once a second, and each recovery ends within one."""
    faults, changes = ["power_cycle duration=0.4@0.8"], [Change("recover", 1.0, asked)]
    result = play(tmp_path, "held", {"kind": "constant", "offset": 0.8}, 3.5, faults=faults, changes=changes)
    texts = [event.text for event in result.summary.events]
    assert any("recovery number 1" in text for text in texts)
    assert result.axes[0].until > 3.0
    assert not any("cycles were without all answers" in text for text in texts)
