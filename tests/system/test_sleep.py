from __future__ import annotations

import os
import time
from collections.abc import Iterator
from select import select

import pytest

from tsa_ctrl.system.sleep import Alarm, Lead


@pytest.fixture
def alarm() -> Iterator[Alarm]:
    made = Alarm()
    yield made
    made.close()


def rings(alarm: Alarm, timeout: float) -> bool:
    return bool(select([alarm.fd], [], [], timeout)[0])


def test_alarm_rings_at_its_time_and_not_before_until_it_is_set_again(alarm: Alarm) -> None:
    assert not rings(alarm, 0.0)
    deadline = time.monotonic_ns() + 50_000_000
    alarm.set(deadline)
    assert rings(alarm, 600.0)
    assert time.monotonic_ns() >= deadline
    assert rings(alarm, 0.0)
    alarm.set(time.monotonic_ns() + 600_000_000_000)
    assert not rings(alarm, 0.01)


def test_alarm_gives_its_descriptor_back() -> None:
    alarm = Alarm()
    alarm.close()
    with pytest.raises(OSError, match="descriptor"):
        os.fstat(alarm.fd)


def learned(lead: Lead, observations: list[float]) -> float:
    for late in observations:
        lead.learn(late)
    return lead.value


def test_lead_finds_what_waking_costs_and_a_stall_moves_it_by_one_step() -> None:
    assert learned(Lead(2e-4), [80e-6, 90e-6] * 100) == pytest.approx(85e-6, abs=2e-6)
    lead = Lead(2e-4)
    before = learned(lead, [50e-6] * 100)
    assert learned(lead, [0.02]) - before == pytest.approx(Lead.STEP)


def test_lead_stays_within_its_bounds() -> None:
    assert learned(Lead(1e-4), [1.0] * 100) == 1e-4
    assert learned(Lead(1e-4), [-1.0] * 100) == 0.0
    assert learned(Lead(0.0), [1.0] * 100) == 0.0
