"""Scan for joints that the controller keeps moving if the plant has less friction than the controller's file.

Usage: tools/run campaign/runaway scan [--sensors motor ...] [--loads free ...] [--shares 0.1 ...] [--sample N]

Each cell is one run of the real loop on distributed tendons in virtual time. From the start, the plant has a share of
the file's friction (--of friction, pretension or both). The set-point is 0 or 0.3 N*m, and the joint is nudged once
(0.4 N*m for 0.1 s). Sensors: "motor" has no joint encoder and no joint torque sensor, "encoder" has the joint encoder,
and "sensor" has both. The seed determines random shape, delay and encoders of each cell. A run ends once the joint has
been at rest for 1 s. The plant's true torque and speed are evaluated:

  speed   RMS speed of the joint over 0.5 s, 3 s after the nudge. Goal at set-point 0: at most 0.05 rad/s. Goal at a
          constant set-point: at most 0.2 rad/s above the faster of two reference runs, which are the same run at
          compensation 0 and the run without friction ("ideal"). A free joint that follows its set-point is not a
          runaway.
  work    the largest integral of (tau_J - tau_J_des) omega_J dt in any window, less the integral of the same run at
          compensation 0. Goal at set-point 0: at most 10 mJ with a torque sensor, otherwise 0.1 J in class "worn" and
          0.4 J in class "bench" (--class), also with a wrong sensor (--sensor-gains). A constant set-point has no goal.
Exit code 1: a goal was missed.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from tools import command
from tools.campaign.passive.experiment import INERTIA, SHARE, Experiment
from tools.campaign.passive.judge import REST, STILL, most_work, peak_speed, reactions, speed
from tools.command import SENSORS, Row
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Fault

SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
OF = ("friction", "pretension", "both")  # "both": each is multiplied by the square root of the share
SET_POINTS = ("zero", "constant")
CENTRES, DELAYS, BITS = (0.3, 0.5, 0.65), (1, 2, 3), (14, 20)  # 1; periods; least and most bits
NUDGE = 0.4  # N*m on the joint
NUDGED, NUDGE_TIME = 0.8, 0.1  # s of the log at the start of the nudge, and its duration, s
WRONG_SINCE = 0.02  # s of the log, from which a wrong torque sensor is wrong
WATCHED, WINDOW = 3.0, 0.5  # s from the nudge to the measurement of the speed, and duration of the measurement, s
RELAXED = ((0.0, 2.0, 0.3, 0.0),)  # a wearer's hand: s, N*m/rad, N*m*s/rad, rad
IDEAL = 0.01  # share of the friction in the run without friction
MOST_SPEED = {"zero": 0.05, "constant": 0.2}  # rad/s; at a constant set-point in excess of the reference runs
MOST_WITH_SENSOR = 10e-3  # J
MOST_WORK = {"worn": 0.1, "bench": 0.4}  # J by class of use, without a joint torque sensor


@dataclass(frozen=True)
class Cell:
    """One run of the scan. `of` selects the parameters of the plant that are a `share` of the file's values."""

    sensors: str
    load: str
    set_point: str
    of: str
    share: float
    centre: float
    delay: int
    motor_bits: int
    joint_bits: int
    gain: float = 1.0  # of the joint torque sensor: -1 is a reversed one, 0 an unplugged one

    @property
    def key(self) -> str:
        rig = f"s_c {self.centre:g}, delay {self.delay}, {self.motor_bits} and {self.joint_bits} bit"
        if self.gain != 1.0:
            rig += f", sensor times {self.gain:g}"
        return f"{self.sensors}, {self.load}, {self.set_point}, {self.of} {self.share:g}, {rig}"

    def experiment(self, compensation: float) -> Experiment:
        """Return the experiment of the cell."""
        each = self.share**0.5 if self.of == "both" else self.share
        fields: dict[str, Any] = {
            "friction": each if self.of != "pretension" else 1.0,
            "pretension": each if self.of != "friction" else 1.0,
            "hand": RELAXED if self.load == "wearer" else None,
        }
        rig = dataclasses.asdict(self)
        del rig["of"], rig["share"], rig["gain"]
        return Experiment(**{**rig, **fields, "compensation": compensation, "fade_in": 0.3})


def judge(cell: Cell, use: str) -> Row:
    """Run a cell for a class of use and, if it moves at a constant set-point, also its reference runs."""
    result = play(cell.experiment(SHARE), cell.gain)
    left = speed(result, NUDGED + WATCHED, NUDGED + WATCHED + WINDOW)
    work = most_work(result, NUDGED)
    most = MOST_WITH_SENSOR if cell.sensors == "sensor" and cell.gain == 1.0 else MOST_WORK[use]
    bound = MOST_SPEED[cell.set_point]
    without = ideal = 0.0
    if cell.set_point == "constant" and left > bound:
        without = speed(play(cell.experiment(0.0)), NUDGED + WATCHED, NUDGED + WATCHED + WINDOW)
        if left > without + bound:  # a free joint may follow its set-point, as the run without friction shows
            bare = dataclasses.replace(cell, of="friction", share=IDEAL).experiment(0.0)
            ideal = speed(play(bare), NUDGED + WATCHED, NUDGED + WATCHED + WINDOW)
    if work > most:
        work = max(0.0, work - most_work(play(cell.experiment(0.0)), NUDGED))
    events = [event.text for event in result.summary.events if event.t > NUDGED and event.text]
    return {
        **dataclasses.asdict(cell),
        "class": use,
        "speed": left,
        "work": work,
        "speed_without": without,
        "speed_ideal": ideal,
        "peak": peak_speed(result, NUDGED),
        **reactions(result.summary.events, NUDGED),
        "events": events[:3],
        "sustained": left > bound + max(without, ideal),
        "excess_work": work > most,
    }


def play(experiment: Experiment, gain: float = 1.0) -> Simulation:
    """Run an experiment with a nudge, until the joint has rested. `gain` is the joint torque sensor's gain."""
    since = NUDGED + NUDGE_TIME

    def ended(t: float, omega: float, events: Sequence[Event]) -> bool:
        nonlocal since
        if abs(omega) > STILL or t < NUDGED + NUDGE_TIME:
            since = max(t, NUDGED + NUDGE_TIME)
        return t - since > REST

    faults = [Fault(f"push value={NUDGE} duration={NUDGE_TIME}", NUDGED)]
    if gain != 1.0:
        faults.append(Fault(f"torque_sensor_gain value={gain:g}", WRONG_SINCE))
    return experiment.play(NUDGED + WATCHED + WINDOW + 0.1, faults, ended=ended)


def cells(
    seed: int,
    sensors: Sequence[str],
    loads: Sequence[str],
    set_points: Sequence[str],
    of: Sequence[str],
    shares: Sequence[float],
    gains: Sequence[float] = (1.0,),
) -> list[Cell]:
    """Return all cells, each with a random centre of the bends, delay and resolution of the encoders."""
    found = []
    for names in itertools.product(sensors, loads, set_points, of, shares):
        rng = np.random.default_rng([seed, zlib.crc32(repr(names).encode())])
        drawn: dict[str, Any] = {
            "centre": float(rng.choice(CENTRES)),
            "delay": int(rng.choice(DELAYS)),
            "motor_bits": int(rng.integers(BITS[0], BITS[1] + 1)),
            "joint_bits": int(rng.integers(BITS[0], BITS[1] + 1)),
        }
        found += [Cell(*names, **drawn, gain=gain) for gain in gains]
    return found


def good(row: Row) -> bool:
    return not (row["sustained"] or (row["excess_work"] and row["set_point"] == "zero"))


def table(rows: Sequence[Row]) -> Table:
    """Return a line for each sensor configuration, load and set-point, with the worst speed and work."""
    heads = ("sensors", "load", "set-point", "cells", "missed", "speed (rad/s)", "at c = 0; ideal", "of the cell")
    lines = []
    for key, those in command.parts(rows, sensors=SENSORS, load=INERTIA, set_point=SET_POINTS):
        fast = max(those, key=lambda row: row["speed"] - max(row["speed_without"], row["speed_ideal"]))
        strong = max(those, key=lambda row: float(row["work"]))
        reference = f"{fast['speed_without']:.2f}; {fast['speed_ideal']:.2f}"
        speeds = (f"{fast['speed']:.2f}", reference, _words(fast))
        missed = sum(not good(row) for row in those)
        lines.append((*key, len(those), missed, *speeds, f"{1e3 * strong['work']:.1f}", _words(strong)))
    return command.table((*heads, "work (mJ)", "of the cell"), lines, "scan")


def _words(row: Row) -> str:
    bits = f"{row['motor_bits']}/{row['joint_bits']} bit"
    wrong = f", sensor times {row['gain']:g}" if row.get("gain", 1.0) != 1.0 else ""
    return f"{row['of']} {row['share']:g}, s_c {row['centre']:g}, delay {row['delay']}, {bits}{wrong}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the scan's options."""
    parser.add_argument("--loads", nargs="+", choices=tuple(INERTIA), default=("free", "weight", "limb", "spring"))
    parser.add_argument("--set-points", nargs="+", choices=SET_POINTS, default=SET_POINTS)
    parser.add_argument("--of", nargs="+", choices=OF, default=OF[:1], help="the reduced parameter of the plant")
    parser.add_argument("--shares", nargs="+", type=float, default=SHARES, help="of the file's, 1 (default 0.1 to 1)")
    parser.add_argument(
        "--sensor-gains",
        nargs="+",
        type=float,
        default=(1.0,),
        help="of the joint torque sensor: -1 is a reversed one, 0 an unplugged one (default 1)",
    )
    command.share(parser, "sensors seed sample rows processes json")
    parser.add_argument(
        "--class",
        dest="use",
        choices=tuple(MOST_WORK),
        default="bench",
        help="class of use whose goal for the work applies",
    )


def run(chosen: argparse.Namespace) -> int:
    """Run and print the chosen cells. Return 1 if a cell missed a goal."""
    command.seeded(chosen)
    names = (chosen.sensors, chosen.loads, chosen.set_points, chosen.of, chosen.shares)
    found = command.drawn(cells(chosen.seed, *names, chosen.sensor_gains), chosen)

    def tables(rows: list[Row]) -> list[Table | str]:
        missed = sum(not good(row) for row in rows)
        return [table(rows), f"{len(rows)} cells, {missed} missed; seed {chosen.seed}"]

    work, key = functools.partial(judge, use=chosen.use), functools.partial(command.from_row, Cell)
    return command.judged(work, found, key, chosen, good, words, tables)


def words(row: Row) -> str:
    """Return the name and the measured values of a cell."""
    name = command.from_row(Cell, row).key
    speeds = f"{row['speed']:.2f} rad/s (c = 0: {row['speed_without']:.2f}, ideal {row['speed_ideal']:.2f})"
    first = "; ".join(text.split(";")[0] for text in row["events"][:2])
    return f"{name}: {speeds}, {1e3 * row['work']:.1f} mJ; {first or 'no event'}"
