"""campaign/virtual: that its judgement can say no, that it goes on where it stopped, and a sample of it."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pytest

from tools.campaign import virtual
from tools.campaign.phase import verdict as verdicts
from tools.campaign.phase.acts import ACTS
from tools.campaign.phase.catalogue import BY_NAME, HAZARDS
from tools.campaign.phase.plan import MOMENTS, PHASES, Draw, Trial, chosen, full, pairs
from tools.campaign.phase.results import read, row, summary
from tools.campaign.phase.stage import Seen, Stage, Traces
from tools.campaign.phase.verdict import Judge, Verdict, judge, motion
from tools.manual import hazards
from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.faults import FAULTS, parse_fault

HELD = Draw("held", "uniform", "constant", 1.0, 1.0, 1e-4, 0, True, 1, 0.5, 1)
LOST = Trial(("TPDOs lost",), "running", 0, 0.0, HELD)
EMCY = "emergency: drive node 1: EMCY 0x2310"
# Faults of single signals, judged by the time until they are found: tests/virtual/test_sensor_truth.py.
SIGNALS = {
    *("encoder_bit", "encoder_stuck", "forged_tpdo", "motor_encoder_stuck", "position_gain", "position_stuck"),
    *("reported_gain", "reported_offset", "reported_stuck", "velocity_gain", "velocity_stuck"),
}
STALE = "stale PDO: drive node 1: 3 cycles in a row"


def traces(*torques: float, speed: float = 0.0) -> Traces:
    """A millisecond a row from 1 s on."""
    made = Traces()
    for number, torque in enumerate(torques):
        made.clock.append(1.0 + 1e-3 * number)
        for column, value in zip(made.columns, (1, torque, torque, torque, 0, 0, speed, torque), strict=True):
            column.append(value)
    return made


def seen(*torques: float, **changes: object) -> Seen:
    good = Seen((traces(*torques),), 1.0, 1.4, 0.0, math.inf, (STALE,), (), "", "")
    return dataclasses.replace(good, **changes)


def verdict(trial: Trial, what: Seen) -> Verdict:
    return Judge(trial, what, 0.25).verdict()


def test_torque_that_ends_at_once_with_its_cause_is_safe() -> None:
    found = verdict(LOST, seen(*[0.5] * 5, *[0.0] * 400))
    assert found.wrong == ()
    assert found.zero == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (seen(*[0.5] * 300, *[0.0] * 100), "torque zero after 299 ms, allowed are 250"),
        (seen(*[0.5] * 5, *[0.0] * 300, 0.2, 0.0), "torque zero after 305 ms"),
        (seen(*[0.5] * 5, 0.0, faults=()), "nothing names its cause"),
        (seen(*[0.5] * 5, 0.0, faults=(EMCY,)), "nothing names its cause"),
        (seen(*[2.2] * 5, 0.0), "2.20 N*m are above the limit"),
        (seen(*[0.5] * 5, 0.0, crashed="ZeroDivisionError: x"), "ended by ZeroDivisionError"),
        (seen(0.0, injected=None), "the phase running never came"),
        (seen(*[0.5] * 500, stopped=1.0), "after the stop was asked for"),
    ],
)
def test_what_is_not_met_is_unsafe(what: Seen, words: str) -> None:
    assert words in "; ".join(verdict(LOST, what).wrong)


def test_a_latched_fault_has_no_torque() -> None:
    latched = dataclasses.replace(LOST, phase="fault")
    assert verdict(latched, seen(0.0, 0.2, 0.0)).wrong == ("torque although a fault was latched",)
    assert verdict(latched, seen(0.0, 0.2, 0.0, asked=1.0005)).wrong == ()


def test_before_there_is_torque_a_fault_that_passes_may_be_over() -> None:
    start = dataclasses.replace(LOST, phase="start")
    late = [0.0] * 100 + [0.5] * 290 + [0.0]
    assert "torque zero after" in verdict(start, seen(*late)).wrong[0]
    assert verdict(dataclasses.replace(start, names=("EMCY without a fault",)), seen(*late)).wrong == ()
    assert verdict(start, seen(*late, cleared=1.05)).wrong == ()


def test_motion_is_the_worst_of_all_axes() -> None:
    found = motion((traces(0.5, 0.5, speed=1.0), traces(*[-0.5] * 100, speed=-3.0)), 1.0)
    assert (found.speed, found.energy) == (3.0, pytest.approx(0.15))


ANEW = next(trial for trial in full(1) if trial.key == "recovery asked for meanwhile | fault | 6")  # a free joint


@pytest.mark.slow
def test_a_recovery_may_move_a_free_joint_as_a_first_start_does() -> None:
    found = judge(ANEW)
    assert found.wrong == ()
    assert found.cause.startswith("emergency")


@pytest.mark.slow
def test_a_recovery_that_moves_the_joint_more_than_it_wants_is_unsafe(monkeypatch: pytest.MonkeyPatch) -> None:
    def faulty(stage: Stage) -> None:
        stage.recover()
        stage.tune("setpoint_gain", 2.0)

    monkeypatch.setitem(ACTS, "recover", faulty)
    assert "beyond, borne are" in "; ".join(judge(ANEW).wrong)


def test_what_a_recovery_wants_excuses_no_lie_and_no_running_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    def played(trial: Trial) -> str:
        twins = []

        def play(twin: Trial, compensation: float | None = None) -> tuple[Seen, float]:
            twins.append(twin.phase)
            return seen(0.0), 0.25

        monkeypatch.setattr(verdicts, "play", play)
        moved = Seen((traces(*[0.5] * 300, speed=3.0),), 1.0, 1.4, 0.9, math.inf, (STALE,), (), "", "")
        assert "rad/s of the joint beyond" in "; ".join(verdict(trial, moved).wrong)
        return " ".join(twins)

    free = dataclasses.replace(ANEW, phase="resetting")
    assert "enabling" in played(free)
    assert "enabling" not in played(dataclasses.replace(free, phase="running"))
    assert "enabling" not in played(dataclasses.replace(free, names=("friction half",)))


def test_motion_is_looked_at_between_two_times() -> None:
    found = motion((traces(*[0.5] * 100, speed=1.0),), 1.0095, 1.0195)
    assert found.energy == pytest.approx(0.005)


def test_the_plan_has_every_fault_in_every_phase_at_every_moment_once() -> None:
    keys = [trial.key for trial in full(1)]
    assert len(set(keys)) == len(keys) == len(HAZARDS) * len(PHASES) * MOMENTS
    drawn = [trial.draw for trial in full(1)]
    assert {draw.load for draw in drawn} == {"imposed", "held", "free", "spring", "weight", "limb", "wearer"}
    assert {draw.axes for draw in drawn} == {1, 2}
    assert len({trial.names for trial in pairs(1)}) > 400


@pytest.mark.slow
def test_parts_are_the_whole() -> None:
    whole = {trial.key for trial in chosen(1, "full", 100, (), (1, 1))}
    parts = [{trial.key for trial in chosen(1, "full", 100, (), (n, 3))} for n in (1, 2, 3)]
    assert whole == set.union(*parts)
    assert sum(map(len, parts)) == 100


def test_a_sample_has_every_fault_before_any_comes_again() -> None:
    first = [trial.names for trial in chosen(1, "full", len(HAZARDS), (), (1, 1))]
    assert len(set(first)) == len(HAZARDS)


def test_every_fault_of_the_plant_and_every_act_is_in_the_catalogue() -> None:
    lines = [line for hazard in HAZARDS for line in hazard.lines]
    configured = {"digital_input"}  # [safety] emergency_stop gives it a meaning: tests/virtual/test_emergency_stop.py
    configured |= SIGNALS
    assert {line.split()[0] for line in lines} >= set(FAULTS) - configured
    for line in lines:
        parse_fault(line)
    assert {hazard.act for hazard in HAZARDS if hazard.act} == set(ACTS)
    assert all(bool(hazard.lines) != bool(hazard.act) for hazard in HAZARDS)


def test_an_interrupted_file_is_read_up_to_the_line_that_was_cut(tmp_path: Path) -> None:
    path = tmp_path / "virtual.jsonl"
    line = json.dumps(row(LOST, Verdict((), 0.004, 0.7, (0.1, 0.0, 0.0), STALE), 1))
    path.write_text(f"{line}\n{line[:20]}", encoding="utf-8")
    assert [each["key"] for each in read(path, 1)] == [LOST.key]
    assert path.read_text(encoding="utf-8") == f"{line}\n"
    with pytest.raises(UsageError, match="line 1 has seed 1, asked for is 2"):
        read(path, 2)
    path.write_text("nonsense\n", encoding="utf-8")
    with pytest.raises(UsageError, match="line 1 is not a trial"):
        read(path, 1)


def test_a_summary_tells_cause_time_and_what_was_unsafe() -> None:
    good = row(LOST, Verdict((), 0.004, 0.7, (0.1, 0.0, 0.0), STALE), 1)
    bad = row(LOST, Verdict(("torque",), 0.4, 0.9, (2.5, 0.0, 0.0), STALE), 1)
    (found,) = summary([good, bad]).values()
    assert (found["safe"], found["trials"], found["causes"]) == (1, 2, ["stale PDO"])
    assert (found["zero_worst"], found["speed"], found["unsafe"]) == (0.4, 2.5, {"running": 1})
    assert found["beyond"] == {
        "joints": {"held": 1},
        "blind": 0,
        "peak": 0.9,
        "speed": 2.5,
        "travel": 0.0,
        "energy": 0.0,
    }


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b"])
def test_a_wrong_part_is_one_clear_line(text: str) -> None:
    with pytest.raises(UsageError, match="allowed is I/N"):
        virtual.part(text)


def test_the_table_has_a_line_for_every_hazard() -> None:
    assert [cells[1] for cells in hazards.rows()] == [hazard.name for hazard in HAZARDS]
    assert {len(cells) for cells in hazards.rows()} == {len(hazards.HEAD)}


@pytest.mark.slow
def test_the_same_trial_gives_the_same_result() -> None:
    assert judge(LOST) == judge(LOST)


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
