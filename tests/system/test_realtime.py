"""Real time: deadlines on a grid, skipped periods counted, rights as the kernel reports them."""

from __future__ import annotations

import gc
import os
import time

import pytest

from tsa_ctrl.errors import BusError
from tsa_ctrl.system import realtime
from tsa_ctrl.system.realtime import RealtimeSettings, Ticker
from tsa_ctrl.system.sleep import sleep_until

PERIOD = 1_000_000


@pytest.mark.parametrize(
    ("ended", "skipped", "next_deadline"),
    [
        (0, 0, 1_000_000),
        (999_999, 0, 1_000_000),
        (1_000_000, 0, 1_000_000),
        (1_000_001, 1, 2_000_000),
        (1_999_999, 1, 2_000_000),
        (2_000_001, 2, 3_000_000),
        (10_500_000, 10, 11_000_000),
    ],
)
def test_overrun_skips_whole_periods(ended: int, skipped: int, next_deadline: int) -> None:
    """A cycle that ends after the next deadline skips to the first one that is still ahead, on the grid."""
    ticker = Ticker(PERIOD, 0)
    assert ticker.advance(ended) == skipped
    assert ticker.deadline == next_deadline
    assert ticker.skipped == skipped
    assert ticker.overruns == (skipped > 0)


def test_sleep_until_is_never_early() -> None:
    """The sleep ends at or after its absolute deadline."""
    for _ in range(20):
        deadline = time.monotonic_ns() + 300_000
        sleep_until(deadline)
        assert time.monotonic_ns() >= deadline


def test_sleep_until_the_past_returns() -> None:
    """A deadline that is over does not block."""
    sleep_until(time.monotonic_ns() - 1_000_000_000)


def refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_missing_rights_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the scheduler's permission the run is refused, with what to do."""
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(BusError, match=r"SCHED_FIFO 80 refused.*rtprio.*allow_without"):
        realtime.acquire(RealtimeSettings(lock_memory=False))


def test_missing_rights_are_told_where_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the configuration allows it, what is missing is said, and what is in force read back."""
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    rights = realtime.acquire(RealtimeSettings(lock_memory=False, allow_without=True))
    assert not rights.fifo
    assert len(rights.missing) == 1
    assert "no real-time scheduling" in str(rights)


def test_garbage_collection_is_frozen_and_given_back() -> None:
    """No collection runs during the loop; afterwards it does again."""
    realtime.freeze_garbage()
    try:
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    finally:
        realtime.release()
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
