"""Test plan, catalogue and verdict of campaign/virtual, and a sample of its trials."""

from __future__ import annotations

import pytest

from tools.campaign.phase.catalogue import BY_NAME, HAZARDS
from tools.campaign.phase.plan import PHASES, chosen
from tools.campaign.phase.stage import ACTS, RECOVER_ACT
from tools.campaign.phase.verdict import judge
from tools.manual.parts import hazard_results
from tsa_ctrl.plant.faults import FAULTS, parse_fault
from tsa_ctrl.safety.causes import REMEDIES

# Faults of single signals, judged by the time to detection: tests/virtual/test_sensor_truth.py.
SIGNALS = {
    *("encoder_bit", "encoder_stuck", "forged_tpdo", "motor_encoder_stuck", "position_gain", "position_stuck"),
    *("reported_gain", "reported_offset", "reported_stuck", "velocity_gain", "velocity_stuck"),
}


def test_every_fault_of_the_plant_and_every_act_is_in_the_catalogue() -> None:
    lines = [line for hazard in HAZARDS for line in hazard.lines]
    configured = {"digital_input"}  # has an effect with [safety] emergency_stop: tests/virtual/test_emergency_stop.py
    configured |= SIGNALS
    assert {line.split()[0] for line in lines} >= set(FAULTS) - configured
    for line in lines:
        parse_fault(line)
    assert {hazard.act for hazard in HAZARDS if hazard.act} == {*ACTS, RECOVER_ACT}
    assert all(bool(hazard.lines) != bool(hazard.act) for hazard in HAZARDS)


@pytest.mark.slow
@pytest.mark.parametrize("phase", PHASES)
def test_a_sample_is_safe(phase: str) -> None:
    """A random trial of each phase, each with another fault, is safe. Known open hazards are excluded.

    The whole campaign takes two hours.
    """
    drawn = chosen(7 + PHASES.index(phase), "full", 4, (f"| {phase} |",), (1, 1))
    trials = [trial for trial in drawn if not BY_NAME[trial.names[0]].open]
    for trial in trials[:1]:
        assert (trial.key, trial.draw, judge(trial).wrong) == (trial.key, trial.draw, ())


def test_only_what_is_known_to_be_open_was_unsafe_when_the_table_was_made() -> None:
    found = hazard_results()["hazards"]
    assert {name for name, row in found.items() if row["unsafe"]} <= {each.name for each in HAZARDS if each.open}


def test_every_recorded_fault_of_the_hazard_catalogue_has_one_cause() -> None:
    for name, row in hazard_results()["hazards"].items():
        assert len(row["cause_ids"]) == len(row["causes"]), name
        assert set(row["cause_ids"]) <= set(REMEDIES), name
