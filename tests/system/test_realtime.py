"""Test deadlines on a grid, the count of skipped periods, and the rights that the kernel reports."""

from __future__ import annotations

import gc
import os
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.errors import BusError
from tsa_ctrl.system import realtime
from tsa_ctrl.system.realtime import RealtimeSettings, Ticker
from tsa_ctrl.system.sleep import sleep_until

PERIOD = 1_000_000


@given(ended=st.integers(0, 100 * PERIOD))
def test_overrun_skips_whole_periods(ended: int) -> None:
    """A cycle that ends after the next deadline continues at the first future deadline on the grid."""
    ticker = Ticker(PERIOD, 0)
    assert ticker.advance(ended) == ticker.skipped == max(0, -(-ended // PERIOD) - 1)
    assert ticker.deadline == PERIOD * (1 + ticker.skipped) >= ended
    assert ticker.overruns == (ended > PERIOD)


def overran(share: float, took: float, rate: int = 1000, seconds: float = 1.0) -> Ticker:
    """Run a loop in which a share of the cycles takes `took` s. The other cycles take a tenth of a period."""
    period = round(1e9 / rate)
    ticker = Ticker(period, 0)
    due = 0.0
    while ticker.deadline < 1e9 * seconds:
        due += share
        slow, due = due >= 1.0, due % 1.0
        ticker.advance(ticker.deadline + (round(1e9 * took) if slow else period // 10))
    return ticker


def test_the_remedy_names_the_highest_rate_whose_period_the_cycle_fits() -> None:
    for rate, took, reached in (
        (1000, 1.001e-3, 500),
        (1000, 1.99e-3, 500),
        (1000, 2.001e-3, 250),
        (4000, 3e-4, 2000),
        (100, 0.0101, 50),
        (1000, 9.9e-3, 100),
        (1000, 0.099, 10),
    ):
        remedy = overran(1.0, took, rate, 2.0).history.remedy(1.0, rate)
        assert f"set rate = {reached} in [controller], which this machine reaches" in remedy
    assert "reaches no rate of 10 Hz or more" in overran(1.0, 0.12, 1000, 2.0).history.remedy(1.0, 1000)


@pytest.mark.parametrize(("share", "named"), [(0.009, False), (0.02, True)])
def test_a_rate_is_named_where_more_than_one_cycle_in_a_hundred_overruns(share: float, named: bool) -> None:
    remedy = overran(share, 1.4e-3).history.remedy(0.0, 1000)
    assert ("set rate = 500" in remedy) is named
    assert ("held the loop up for 1.4 ms at most" in remedy) is not named


@pytest.mark.parametrize("at", [0.1, 0.9, 0.95, 1.4])
def test_the_worst_second_does_not_depend_on_when_it_is_looked_at(at: float) -> None:
    """40 periods are skipped within 80 ms, partly before and partly after the query at 0.92 s."""
    ticker = Ticker(PERIOD, 0)
    while ticker.deadline < 1.9e9:
        burst = at <= 1e-9 * ticker.deadline < at + 0.08
        ticker.advance(ticker.deadline + (round(1.5 * PERIOD) if burst else 0))
    assert ticker.skipped == 40
    if at + 0.08 > 0.92:
        assert ticker.history.worst_second(0.92)[0] == pytest.approx(40, abs=1)


def test_old_overruns_are_forgotten() -> None:
    ticker = overran(1.0, 1.4e-3, seconds=6.0)
    ticker.history.clear()
    assert (ticker.history.skipped(0.0), ticker.history.worst_second(0.0)[0]) == (0, 0)


def test_sleep_until_is_never_early() -> None:
    """The sleep ends at or after its absolute deadline. A past deadline does not block."""
    sleep_until(time.monotonic_ns() - 1_000_000_000)
    for _ in range(20):
        deadline = time.monotonic_ns() + 300_000
        sleep_until(deadline)
        assert time.monotonic_ns() >= deadline


def refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_missing_rights_are_an_error_or_told_where_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without permission for the scheduler the run is rejected with a remedy.

    If the configuration allows it, missing rights are reported, and the effective rights are read back.
    """
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(BusError, match=r"SCHED_FIFO 80 refused.*rtprio.*allow_without"):
        realtime.acquire(RealtimeSettings(lock_memory=False))
    rights = realtime.acquire(RealtimeSettings(lock_memory=False, allow_without=True))
    assert not rights.fifo
    assert len(rights.missing) == 1
    assert "no real-time scheduling" in str(rights)


def test_garbage_collection_is_frozen_and_given_back() -> None:
    """No garbage collection runs during the loop. Afterwards it is enabled again."""
    realtime.freeze_garbage()
    try:
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    finally:
        realtime.release()
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
