"""campaign/faults: its judgement, which must be able to say no, and the campaign itself on a vcan."""

from __future__ import annotations

import dataclasses
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from tools.campaign.fault.acts import ACTS, LASTING
from tools.campaign.fault.campaign import Campaign, Result, Trial
from tools.campaign.fault.catalogue import FAULTS, Fault
from tools.campaign.fault.verdict import Expected, Row, Seen, judge, longest_gap, stopped_after, zero_after
from tools.campaign.faults import counted
from tsa_ctrl.plant.ailments import AILMENTS
from tsa_ctrl.plant.faults import FAULTS as PLANT_FAULTS
from tsa_ctrl.plant.faults import parse_fault

GOOD = Seen(0.02, 0.001, "faulted", ("stale PDO: drive node 1",), (), 0.8, False, 0.8)
STOPS = Expected(cause="stale PDO")
ON = Seen(None, 0.001, "running", (), ("log: No space left on device",), 0.8, False, 0.8)
GOES_ON = Expected(harmless="counted", said="No space")


def rows(*torques: float) -> list[Row]:
    return [Row(1.0 + 0.001 * n, torque) for n, torque in enumerate(torques)]


def test_zero_counts_from_the_last_row_with_torque() -> None:
    assert zero_after(rows(0.5, 0.5, 0.3, 0.005, 0.0, 0.0), 1.001) == pytest.approx(0.002)
    assert zero_after(rows(0.5, 0.0, 0.0, 0.2, 0.0), 1.0) == pytest.approx(0.004)
    assert zero_after(rows(0.5, 0.0, 0.0, -0.2), 1.0) is None
    assert zero_after(rows(0.0, 0.0), 1.0) == 0.0


def test_a_hole_in_the_record_is_found() -> None:
    assert longest_gap([*rows(0.0, 0.0), Row(1.2, 0.0)]) == pytest.approx(0.199)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"zero": None}, "does not stay zero"),
        ({"zero": 0.26}, "260 ms, allowed are 250"),
        ({"faults": ("tripped: over-speed",)}, "does not name its cause"),
        ({"faults": ()}, "no fault"),
        ({"came_back": True}, "came back by itself"),
        ({"phase": "running"}, "not latched"),
        ({"torque_before": 0.0}, "no torque to lose"),
    ],
)
def test_a_fault_that_is_not_met_is_unsafe(change: dict[str, object], words: str) -> None:
    found = judge(STOPS, dataclasses.replace(GOOD, **change), 0.25, 2.0)
    assert not found.safe
    assert words in "; ".join(found.wrong)


def test_a_fault_that_is_met_is_safe() -> None:
    found = judge(STOPS, GOOD, 0.25, 2.0)
    assert (found.safe, found.latched, found.cause_in_log, found.detected) == (True, True, True, GOOD.faults[0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"notes": ()}, "nobody says so"),
        ({"faults": ("stale PDO",), "phase": "faulted"}, "stops: stale PDO"),
        ({"phase": "silent"}, "the loop is silent"),
        ({"most": 2.2}, "above the limit"),
    ],
)
def test_a_loss_that_stops_or_is_not_said_is_unsafe(change: dict[str, object], words: str) -> None:
    assert judge(GOES_ON, ON, 0.25, 2.0).safe
    found = judge(GOES_ON, dataclasses.replace(ON, **change), 0.25, 2.0)
    assert words in "; ".join(found.wrong)


def test_a_fault_that_may_stop_the_loop_is_safe_either_way() -> None:
    either = Expected(cause="stale PDO", harmless="tolerated")
    assert judge(either, dataclasses.replace(ON, notes=()), 0.25, 2.0).latched is None
    assert judge(either, GOOD, 0.25, 2.0).latched is True
    assert not judge(either, dataclasses.replace(GOOD, zero=None), 0.25, 2.0).safe
    assert not judge(either, dataclasses.replace(ON, phase="silent"), 0.25, 2.0).safe


STALLED = dataclasses.replace(ON, zero=0.9, stopped=0.01, phase="faulted", faults=("stale PDO: drive node 1",))


def test_a_loop_that_a_standing_machine_stopped_is_safe_and_told_apart() -> None:
    found = judge(GOES_ON, STALLED, 0.25, 2.0)
    assert (found.safe, found.stalled, found.latched, found.detected) == (True, True, True, "stale PDO: drive node 1")
    assert not judge(GOES_ON, ON, 0.25, 2.0).stalled


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stopped": None}, "stops: stale PDO"),  # it did not stand still, or the torque went on
        ({"stopped": 0.26}, "stops: stale PDO"),
        ({"faults": ("tripped: over-speed",)}, "stops: tripped: over-speed"),
        ({"faults": ()}, "the loop is faulted"),
        ({"notes": ()}, "nobody says so"),
        ({"most": 2.2}, "above the limit"),
    ],
)
def test_a_standing_machine_excuses_nothing_else(change: dict[str, object], words: str) -> None:
    found = judge(GOES_ON, dataclasses.replace(STALLED, **change), 0.25, 2.0)
    assert not found.safe
    assert words in "; ".join(found.wrong)


def test_a_stop_is_timed_from_where_the_machine_stood_still() -> None:
    before, after = rows(0.5, 0.5, 0.5), [Row(1.010, 0.5), Row(1.011, 0.3), Row(1.012, 0.0), Row(1.013, 0.0)]
    assert stopped_after([*before, *after], 1.0, 0.0025) == pytest.approx(0.010)
    assert stopped_after([*before, *after], 1.0, 0.02) is None
    assert stopped_after([*before, *after], 1.011, 0.0025) is None
    assert stopped_after([*before, *after[:2]], 1.0, 0.0025) is None
    earlier, later = Row(0.9, 0.5), Row(1.5, 0.0)  # of two holes with torque the last; none of those without
    assert stopped_after([earlier, *before, *after, later], 0.8, 0.0025) == pytest.approx(0.010)
    assert stopped_after([Row(1.0, 0.0), Row(1.1, 0.0)], 1.0, 0.0025) is None


def test_every_fault_of_the_plant_is_in_the_campaign() -> None:
    """Faults of parts that still answer run in virtual time; a digital input needs [safety] emergency_stop."""
    lines = [fault.plant for fault in FAULTS if fault.plant]
    assert {line.split()[0] for line in lines} == set(PLANT_FAULTS) - set(AILMENTS) - {"digital_input"}
    for line in lines:
        parse_fault(line)
    names = [fault.name for fault in FAULTS]
    assert len(set(names)) == len(names)


def test_every_act_is_used_and_there() -> None:
    assert {fault.act for fault in FAULTS if fault.act} == set(ACTS)
    assert set(ACTS) > LASTING


class Holes(Campaign):
    """Trials with holes as long as told, s, without processes."""

    def __init__(self, gaps: list[float]) -> None:
        super().__init__(Path(), "none")
        self.gaps = gaps
        self.tried: list[Trial] = []
        self.lives = 0

    def _running(self) -> Any:
        return None

    def _configuration(self, wanted: float) -> str:
        return ""

    def _end_life(self) -> None:
        self.lives += bool(self._trials)
        self.tried += self._trials
        self._trials = []

    def _try(self, daemon: Any, fault: Fault) -> Trial:
        unsafe = 1.0  # s until torque zero: what came of it decides nothing
        gap = self.gaps.pop(0)
        return Trial(fault, 0.0, 1.0, unsafe, gap, "faulted", 0.8, False, 0.8, (), (), None)


@pytest.mark.parametrize(
    ("gaps", "discarded"),
    [
        ([0.001, 0.001], [False]),
        ([0.01, 0.001, 0.001], [True, False]),
        ([0.01] * 6, [True, True, True, True, False]),
    ],
)
def test_a_trial_is_discarded_for_its_hole_alone(gaps: list[float], discarded: list[bool], tmp_path: Path) -> None:
    campaign = Holes(gaps)
    campaign.folder = tmp_path
    campaign._run_group([FAULTS[0]], negative=False)
    assert [trial.discarded for trial in campaign.tried] == discarded


@pytest.mark.parametrize(("act", "lives"), [("", 1), ("hang", 1), ("kill_log", 2)])
def test_a_trial_done_again_has_a_new_daemon_only_where_the_last_one_lost_something(
    act: str, lives: int, tmp_path: Path
) -> None:
    campaign = Holes([0.01, 0.001])
    campaign.folder = tmp_path
    campaign._run_group([dataclasses.replace(FAULTS[0], act=act)], negative=False)
    assert campaign.lives == lives


def test_what_was_discarded_is_counted_with_its_verdicts() -> None:
    trial = Trial(FAULTS[0], 0.0, 1.0, 0.01, 0.01, "faulted", 0.8, False, 0.8, (), (), None, 0, True)
    verdicts = [judge(STOPS, GOOD, 0.25, 2.0), judge(STOPS, dataclasses.replace(GOOD, zero=None), 0.25, 2.0)]
    words = counted(43, [Result(trial, verdict) for verdict in verdicts])
    assert words == "43 of 45 trials, 2 discarded for holes: 1 safe, 1 unsafe"


# What only processes, signals and real time show, on one plant. What is killed, a closed terminal, and a full disk are
# tests of tests/daemon and tests/drills, clients that hang of tests/daemon, an interface that goes down of
# tests/bus/wire; every other fault has its trials in virtual time (campaign/virtual), of which a sample is a test; and
# all of both are `tools/test -m soak`.
REAL = tuple(fault for fault in FAULTS if fault.act in ("flood_socket", "hang") and not fault.bare)


@pytest.mark.vcan
@pytest.mark.hil
@pytest.mark.slow
@pytest.mark.parametrize(
    "chosen", [pytest.param(REAL, id="real"), pytest.param(FAULTS, id="all", marks=pytest.mark.soak)]
)
def test_every_fault_is_met_safely(vcan: str, chosen: tuple[Fault, ...]) -> None:
    """Torque zero in time at the plant, cause in the log, latched; or the loop goes on and says what was lost."""
    only = [word for fault in chosen for word in ("--only", fault.name)]
    done = subprocess.run(
        [ROOT / "tools" / "run", "campaign/faults", "--tolerant", "--json", *only], capture_output=True, text=True
    )
    assert done.stdout, done.stderr
    found = json.loads(done.stdout)["faults"]
    assert {fault["name"] for fault in found} >= {fault.name for fault in chosen}
    assert [(fault["name"], fault["wrong"]) for fault in found if not fault["safe"]] == []
