"""Run 2 % of the cases of the runaway campaigns with a new seed in each run, in at most 20 s of processor time."""

from __future__ import annotations

import argparse
import functools
import random
import secrets
import time
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from tools.bench import checks
from tools.campaign.passive import changes, scan
from tools.command import SENSORS

SHARE, SECONDS = 0.02, 5.0  # share of the cases; s of processor time of each campaign
PROMISED = ("sensor",)  # configurations in which no cell of the scan sustains a motion
SCANNED = 25e-3  # J; a free joint with 90 % of the friction receives 19 mJ, while the campaign's goal is 10 mJ
SURE = 0.5  # J that a change may add at most with a joint torque sensor
FASTEST = 15.0  # rad/s; [axis.limits] over_speed is 12 rad/s as shipped
SEED = secrets.randbelow(10**6)


def drawn(every: Sequence[Any], play: Callable[[Any], dict[str, Any]]) -> list[dict[str, Any]]:
    """Run a share of the items in random order until the time is over."""
    print(f"seed {SEED}")
    begun = time.process_time()
    rows = []
    for each in random.Random(SEED).sample(list(every), max(1, round(SHARE * len(every)))):
        if time.process_time() - begun > SECONDS:
            break
        rows.append(play(each))
    return rows


@pytest.mark.slow
def test_no_motion_is_sustained_with_less_friction_than_the_files() -> None:
    judge = functools.partial(scan.judge, use="bench")
    every = scan.cells(SEED, PROMISED, ("free", "weight", "limb", "spring"), scan.SET_POINTS, scan.OF, scan.SHARES)
    for row in drawn(every, judge):
        assert not row["sustained"], scan.words(row)
        assert row["work"] <= SCANNED or row["set_point"] != "zero", scan.words(row)


@pytest.mark.slow
def test_no_motion_is_sustained_with_a_wrong_torque_sensor() -> None:
    """It is unplugged, reversed, or reversed with half of its gain. It receives at most the energy credit."""
    judge = functools.partial(scan.judge, use="worn")
    rig = ("free", "weight", "limb", "spring"), scan.SET_POINTS, scan.OF, scan.SHARES
    for row in drawn(scan.cells(SEED, ("sensor",), *rig, gains=(-1.0, -0.5, 0.0)), judge):
        assert scan.good(row), scan.words(row)


@pytest.mark.slow
def test_a_change_that_a_torque_sensor_shows_adds_little_work() -> None:
    parser = argparse.ArgumentParser()
    changes.options(parser)
    shown = [case for case in changes.cases(parser.parse_args([])) if case.sensors == "sensor" and case.change]
    for row in drawn(shown, changes.judge):
        assert row["added"] <= SURE, changes.words(row)


@pytest.mark.slow
def test_no_fault_takes_the_joint_far_beyond_its_over_speed_limit() -> None:
    every = checks.combinations(checks.FAULTS, checks.LOADS, SENSORS, ("sine", "constant"))
    for row in drawn(every, lambda key: checks.trial(*key)):
        assert row["peak"] <= FASTEST, row
