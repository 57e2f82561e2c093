"""campaign/virtual: its plan, its catalogue, a verdict that is unsafe, and a sample of its trials."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tools.campaign.phase.acts import ACTS
from tools.campaign.phase.catalogue import BY_NAME, HAZARDS
from tools.campaign.phase.plan import MOMENTS, PHASES, Draw, Trial, chosen, full, pairs
from tools.campaign.phase.stage import RECOVER_ACT, Seen
from tools.campaign.phase.verdict import Judge, judge
from tools.manual import hazards
from tools.manual.hazards import load
from tsa_ctrl.plant.faults import FAULTS, parse_fault
from tsa_ctrl.safety.causes import REMEDIES

HELD = Draw("held", "uniform", "constant", 1.0, 1.0, 1e-4, 0, True, 1, 0.5, 1)
LOST = Trial(("TPDOs lost",), "running", 0, 0.0, HELD)
# Faults of single signals, judged by the time until they are found: tests/virtual/test_sensor_truth.py.
SIGNALS = {
    *("encoder_bit", "encoder_stuck", "forged_tpdo", "motor_encoder_stuck", "position_gain", "position_stuck"),
    *("reported_gain", "reported_offset", "reported_stuck", "velocity_gain", "velocity_stuck"),
}
STALE = "stale PDO: drive node 1: 3 cycles in a row"


def test_torque_that_does_not_end_is_unsafe() -> None:
    """The motor keeps its torque for 0.4 s after the fault; 0.25 s are allowed."""
    names = ("enabled", "torque_loop", "q_j", "omega_j", "tau_j")
    traces = {"clock": 1.0 + 1e-3 * np.arange(400), **dict.fromkeys(names, np.full(400, 0.5))}
    seen = Seen((traces,), 1.0, 1.4, 0.0, math.inf, (STALE,), ("stale_pdo",), (), "", "")
    assert "torque zero after 399 ms, allowed are 250" in Judge(LOST, seen, 0.25).verdict().wrong


def test_the_plan_has_every_fault_in_every_phase_at_every_moment_once() -> None:
    keys = [trial.key for trial in full(1)]
    assert len(set(keys)) == len(keys) == len(HAZARDS) * len(PHASES) * MOMENTS
    drawn = [trial.draw for trial in full(1)]
    assert {draw.load for draw in drawn} == {"imposed", "held", "free", "spring", "weight", "limb", "wearer"}
    assert {draw.axes for draw in drawn} == {1, 2}
    assert len({trial.names for trial in pairs(1)}) > 400


def test_every_fault_of_the_plant_and_every_act_is_in_the_catalogue() -> None:
    lines = [line for hazard in HAZARDS for line in hazard.lines]
    configured = {"digital_input"}  # [safety] emergency_stop gives it a meaning: tests/virtual/test_emergency_stop.py
    configured |= SIGNALS
    assert {line.split()[0] for line in lines} >= set(FAULTS) - configured
    for line in lines:
        parse_fault(line)
    assert {hazard.act for hazard in HAZARDS if hazard.act} == {*ACTS, RECOVER_ACT}
    assert all(bool(hazard.lines) != bool(hazard.act) for hazard in HAZARDS)


def test_a_third_party_that_takes_the_time_out_of_commands_away_is_found() -> None:
    found = judge(dataclasses.replace(LOST, names=("a third party's SDO takes the RPDO timer",)))
    assert found.wrong == ()
    assert found.cause == "second master: somebody else sent a master's frame 0x601"


def test_a_loop_that_dies_ends_its_trial_and_the_drive_stops_by_itself() -> None:
    found = judge(dataclasses.replace(LOST, names=("loop dies",)))
    assert found.wrong == ()
    assert found.zero is not None
    assert 0.005 < found.zero < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.soak)])
def test_a_sample_is_safe(phase: str, count: int) -> None:
    """Trials of each phase, drawn, of what is not known to be open; the whole takes an hour."""
    trials = [trial for trial in chosen(7, "full", 4, (f"| {phase} |",), (1, 1)) if not BY_NAME[trial.names[0]].open]
    for trial in trials[:count]:
        assert (trial.key, trial.draw, judge(trial).wrong) == (trial.key, trial.draw, ())


def test_only_what_is_known_to_be_open_was_unsafe_when_the_table_was_made() -> None:
    found = hazards.load()["hazards"]
    assert {name for name, row in found.items() if row["unsafe"]} <= {each.name for each in HAZARDS if each.open}


def test_a_trial_without_a_joint_encoder_stops_as_well() -> None:
    blind = LOST.with_sensors("motor")
    assert blind.key == f"{LOST.key} | motor"
    assert judge(blind).wrong == ()


def test_every_recorded_fault_of_the_hazard_catalogue_has_one_cause() -> None:
    for name, row in load()["hazards"].items():
        assert len(row["cause_ids"]) == len(row["causes"]), name
        assert set(row["cause_ids"]) <= set(REMEDIES), name
