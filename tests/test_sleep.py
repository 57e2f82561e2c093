from __future__ import annotations

import pytest

from tsa_ctrl.sleep import Lead


def learned(lead: Lead, observations: list[float]) -> float:
    for late in observations:
        lead.learn(late)
    return lead.value


def test_lead_finds_what_waking_costs() -> None:
    assert learned(Lead(2e-4), [80e-6, 90e-6] * 100) == pytest.approx(85e-6, abs=2e-6)


def test_stall_moves_the_lead_by_one_step() -> None:
    lead = Lead(2e-4)
    before = learned(lead, [50e-6] * 100)
    assert learned(lead, [0.02]) - before == pytest.approx(Lead.STEP)


def test_lead_stays_within_its_bounds() -> None:
    assert learned(Lead(1e-4), [1.0] * 100) == 1e-4
    assert learned(Lead(1e-4), [-1.0] * 100) == 0.0
    assert learned(Lead(0.0), [1.0] * 100) == 0.0
