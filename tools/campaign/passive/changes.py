"""Measure the work on a joint if friction, pretension, bending or the motor changes while the loop is running.

Usage: tools/run campaign/runaway changes [--sensors motor ...] [--loads free ...] [--set-points sine ...]
                                          [--changes friction=0.1 ...] [--at 3] [--sample N] [--rows FILE] [--worst]
       tools/run campaign/runaway loss    (a sudden loss or a wrong drive, compared with compensation 0)

Each case is one run of the real loop on distributed tendons in virtual time. The model file is true until the time --at
(s of the log). Then one quantity steps to a share of its value: pretension, friction, bending, or the motor's torque
constant (torque_gain, without a change of the reported torque). With set-point zero or constant, the joint is nudged at
this moment, and the hand releases a limb. A run ends 1.2 s after a latch, after 1 s of rest, or 3 s after the change.
The plant's true torque and speed are evaluated:

  added    the largest work on the joint in any window after the change, less the work of the set-point and the work of
           the same run at compensation 0. Goals: J/2 (1 rad/s)^2 with the torque sensor. With only a joint encoder, a
           sine and a loss after 2.5 s (after sliding in both directions): 30 mJ, or 60 mJ on a free joint. Other
           cases have no goal.
  late     the same work more than 1 s after the first 1 mJ. Goal: at most 1 mJ with the torque sensor.
  silent   more than 4 mJ were added without a report. This misses the goal with the torque sensor.
  after    the part of the work after the guard first acted, caused by delay and the swing of the motor.

Without a change the set-point ends instead. 5 s later the joint must rest (0.02 rad/s RMS), and the motor torque must
be constant (0.02 N*m peak to peak). Cases in --rows FILE are not run again. --worst prints the 20 worst cases of each
sensor configuration, and --which prints the cases that missed a goal. Exit code 1: a goal was missed.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from tools import command
from tools.campaign.passive.experiment import INERTIA, SET_POINTS, SHARE, Experiment
from tools.campaign.passive.judge import (
    GUARD,
    LET_GO,
    Ended,
    FloatArray,
    peak_speed,
    power,
    reactions,
    speed,
    windows,
)
from tools.campaign.passive.scan import RELAXED
from tools.command import SENSORS, Row
from tsa_ctrl.errors import UsageError
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change, Fault

AT, WATCHED = 1.2, 3.0  # s: time of the change, and observation after the change
TO_REST, AT_REST, MEASURED = 2.0, 3.0, 1.0  # s: set-point gain fades to 0, motion decays, measurement at rest
SWUNG = 0.05  # s after the guard has acted, by which a swing has decayed
FELT = 1e-3  # J, three times the energy of a healthy reversal
ALLOWED = 3e-3  # J, [axis.passivity] energy as shipped
CONFIRMED = 2.5  # s of the log, by which the tendons have slid in both directions with a sine
LOST = {"free": 60e-3}  # J, most work that a loss after CONFIRMED may add with a joint encoder; 30 mJ for other loads
QUIET_SPEED, QUIET_TORQUE = 0.02, 0.02  # rad/s RMS, N*m peak to peak
CHANGES = {
    "pretension": (0.1, 0.3, 0.5, 0.7, 0.9),
    "friction": (0.1, 0.5, 0.75, 1.25, 1.5),
    "bending": (0.8, 0.9, 1.1, 1.2),
    "torque_gain": (1.4, 2.0),
}
LOSSES = (("pretension", 0.5), ("friction", 0.1), ("torque_gain", 1.4), ("torque_gain", 2.0))
WORST = 20  # rows in a list of the worst rows
LOSS_TITLE = "loss: worst work added (mJ) before; once both directions have slid"


@dataclass(frozen=True)
class Case:
    """One run with a change at the time `at` (s) of the log. Without a `change`, the set-point ends at this time."""

    sensors: str
    load: str
    set_point: str
    change: str
    share: float
    delay: int
    at: float

    @property
    def name(self) -> str:
        return f"{self.sensors}, {self.load}, {self.set_point}, {self.what}, delay {self.delay}, at {self.at:g} s"

    @property
    def what(self) -> str:
        return f"{self.change} {self.share:g}" if self.change else "nothing"

    @property
    def stands(self) -> bool:
        return self.set_point in ("zero", "constant")

    @property
    def most(self) -> float | None:
        """Return the goal for the added work, J, or None without a goal."""
        if self.sensors == "sensor":
            return 0.5 * INERTIA[self.load]
        lost = self.change in ("pretension", "friction") and self.share < 1.0
        if self.sensors == "encoder" and self.set_point == "sine" and lost and self.at >= CONFIRMED:
            return LOST.get(self.load, 30e-3)
        return None

    def play(self, compensation: float = SHARE) -> Simulation:
        """Run the case with this compensation."""
        go = self.at + LET_GO
        hands: dict[str, Sequence[Sequence[float]]] = {
            "limb": ((0.0, 0.0, 1.0, 0.0), (go, 0.0, 1.0, 0.0), (go + 0.01, 0.0, 0.0, 0.0)),
            "wearer": RELAXED,
        }
        hand = hands.get(self.load) if self.stands else None
        rig = Experiment(
            self.load, self.set_point, self.sensors, delay=self.delay, compensation=compensation, hand=hand
        )
        if not self.change:
            changes = [Change("setpoint_gain", 0.0, self.at)]
            return rig.play(self.at + TO_REST + AT_REST + MEASURED, changes=changes)
        faults = [Fault(f"{self.change} value={self.share:g}", self.at)]
        if self.stands:
            faults.append(Fault("push value=0.5 duration=0.05", self.at))
        return rig.play(self.at + WATCHED, faults, ended=Ended(self.at, self.stands))


def judge(case: Case, compare: bool = False) -> Row:
    """Run and evaluate a case. If it may miss a goal, or with `compare`, also run it at compensation 0."""
    result = case.play()
    events = result.summary.events
    row: Row = {**dataclasses.asdict(case), **reactions(events, case.at)}
    row["told"] = any(event.text.startswith(GUARD) for event in events)
    row["words"] = next((event.text for event in events if event.t > case.at and event.text), "")
    if not case.change:
        truth, axis = result.truth, result.axes[0]
        begin = case.at + TO_REST + AT_REST
        t = truth["clock"] - axis.start
        row["speed"] = speed(result, begin, axis.until)
        row["torque"] = float(np.ptp(truth["tau_m"][(t > begin) & (t < axis.until)]))
        row["good"] = row["speed"] <= QUIET_SPEED and row["torque"] <= QUIET_TORQUE and not row["told"]
        return row
    t, work = power(result, case.at)
    given = windows(work)
    row |= _swing(result, case.at, t, given)
    felt = np.flatnonzero(given > FELT)
    row["work"] = float(given.max(initial=0.0))
    row["late"] = _late(t, work, float(t[felt[0]]) + 1.0) if felt.size else 0.0
    row["onset"] = float(t[felt[0]]) - case.at if felt.size else None
    row["peak"] = peak_speed(result, case.at)
    most = 0.0 if compare else ALLOWED
    if row["work"] > most or row["late"] > FELT:
        t, work, row["peak_without"] = _without(dataclasses.replace(case, sensors="sensor"))
        row["work_without"] = float(windows(work).max(initial=0.0))
        row["late_without"] = _late(t, work, case.at + (row["onset"] or 0.0) + 1.0)
    row["added"] = max(0.0, row["work"] - row.get("work_without", 0.0))
    row["late_added"] = max(0.0, row["late"] - row.get("late_without", 0.0))
    row["silent"] = row["added"] > ALLOWED + FELT and row["reported"] is None
    row["good"] = case.most is None or row["added"] <= case.most
    if case.sensors == "sensor":
        row["good"] &= row["late_added"] <= FELT and not row["silent"]
    return row


@functools.lru_cache(maxsize=8)
def _without(case: Case) -> tuple[FloatArray, FloatArray, float]:
    """Return times, work per row and highest speed of a case at compensation 0, which do not depend on the sensors."""
    result = case.play(0.0)
    return *power(result, case.at), peak_speed(result, case.at)


def _swing(result: Simulation, at: float, t: FloatArray, given: FloatArray) -> Row:
    """Return the joint's speed at the change, and the work after the guard first acted on it."""
    axis, truth = result.axes[0], result.truth
    speed_then = float(np.interp(at, truth["clock"] - axis.start, truth["omega_j"]))
    acted = [event.t for event in result.summary.events if event.t >= at and event.text.startswith(GUARD)]
    found: Row = {"speed": speed_then, "acted": None, "after": 0.0}
    if acted and t.size:
        place = min(int(np.searchsorted(t, acted[0])), t.size - 1)
        swing = given[place : int(np.searchsorted(t, acted[0] + SWUNG))]
        found |= {"acted": acted[0] - at, "after": max(0.0, float(swing.max(initial=0.0) - given[place]))}
    return found


def _late(t: FloatArray, work: FloatArray, begin: float) -> float:
    return float(windows(work[t >= begin]).max(initial=0.0))


case_of = functools.partial(command.from_row, Case)


def cases(chosen: argparse.Namespace) -> list[Case]:
    """Return all cases of the chosen sensors, loads, set-points, changes, delays and times."""
    changes = [("", 1.0)] + [(name, share) for name, shares in CHANGES.items() for share in shares]
    if chosen.changes:
        changes = list(map(change_of, chosen.changes))
    rigs = itertools.product(chosen.loads, chosen.set_points, changes, chosen.delays, chosen.at, chosen.sensors)
    found = [Case(sensors, load, wanted, *change, delay, at) for load, wanted, change, delay, at, sensors in rigs]
    return [
        case for case in found if case.change or case.stands or case.load != "wearer"
    ]  # whose hand also moves at rest


def change_of(text: str) -> tuple[str, float]:
    """Return name and share of "friction=0.1" or "nothing".

    Raises:
        UsageError: The name or the share is invalid.
    """
    name, equals, value = text.partition("=")
    if text == "nothing":
        return "", 1.0
    try:
        share = float(value)
    except ValueError:
        share = 0.0
    if name not in CHANGES or not equals or not 0.0 < share <= 10.0:
        raise UsageError(f"--changes {text}: allowed are nothing or {', '.join(CHANGES)} =SHARE above 0, at most 10")
    return name, share


def table(rows: Sequence[Row]) -> Table:
    """Return a line for each sensor configuration, load and set-point."""
    lines = []
    for key, those in command.parts(rows, sensors=SENSORS, load=INERTIA, set_point=SET_POINTS):
        changed = [row for row in those if row["change"]]
        resting = [row for row in those if not row["change"]]
        rest = f"{max(r['speed'] for r in resting):.3f}; {max(r['torque'] for r in resting):.3f}" if resting else "-"
        goals = sorted({most for row in changed if (most := case_of(row).most)})
        worst = {name: 1e3 * max((row[name] for row in changed), default=0.0) for name in ("added", "late_added")}
        works = (f"{worst['added']:.1f}", ", ".join(f"{1e3 * most:.0f}" for most in goals) or "-")
        counts = (sum(row[name] is not None for row in changed) for name in ("reported", "latched"))
        missed = sum(not row["good"] for row in those)
        lines.append((*key, len(those), *works, f"{worst['late_added']:.1f}", *counts, missed, rest))
    heads = ("sensors", "load", "set-point", "runs", "added, worst (mJ)", "goal", "late, worst (mJ)", "reported")
    return command.table((*heads, "latched", "missed", "at rest (rad/s; N·m)"), lines, "changes")


LISTED: dict[str, Callable[[Row], object]] = {  # function that returns the cell of a row, by column head
    "sensors": lambda row: row["sensors"],
    "load": lambda row: row["load"],
    "set-point": lambda row: row["set_point"],
    "change": lambda row: case_of(row).what,
    "delay": lambda row: row["delay"],
    "at (s)": lambda row: f"{row['at']:g}",
    "then (rad/s)": lambda row: f"{abs(row['speed']):.1f}",
    "added (mJ)": lambda row: f"{1e3 * row['added']:.1f}",
    "c = 0 (mJ)": lambda row: f"{1e3 * row['work_without']:.1f}" if "work_without" in row else None,
    "peak (rad/s)": lambda row: f"{row['peak']:.1f}",
    "reported (s)": lambda row: _seconds(row["reported"]),
    "latched (s)": lambda row: _seconds(row["latched"]),
    "after (mJ)": lambda row: None if row["acted"] is None else f"{1e3 * row['after']:.1f}",
    "late (mJ)": lambda row: f"{1e3 * row['late_added']:.1f}",
    "report": lambda row: textwrap.shorten(row["words"].split(";")[0].split(":")[0], 34, placeholder=" ..."),
}


def _seconds(time: float | None) -> str | None:
    return None if time is None else f"{time:.3f}"


def listing(title: str, rows: Iterable[Row]) -> Table:
    """Return a table with a line for each row."""
    return command.table(tuple(LISTED), ([cell(row) for cell in LISTED.values()] for row in rows), title)


def worst(rows: Sequence[Row]) -> list[Table]:
    """Return a table for each sensor configuration, with the rows that have the largest added work."""
    ordered = sorted(rows, key=lambda row: -float(row["added"]))
    return [
        listing(f"{WORST} worst, {sensors}", those[:WORST])
        for (sensors,), those in command.parts(ordered, sensors=SENSORS)
    ]


def losses(rows: Sequence[Row]) -> Table:
    """Return a line for each load, set-point and loss, with the worst work before and after CONFIRMED, mJ."""
    lines = []
    keys = dict.fromkeys((row["load"], row["set_point"], case_of(row).what) for row in rows)
    for key in keys:
        those = [row for row in rows if (row["load"], row["set_point"], case_of(row).what) == key]
        cells = []
        for sensors in SENSORS:
            mine = [row for row in those if row["sensors"] == sensors]
            early, late = ([row for row in mine if (row["at"] >= CONFIRMED) is known] for known in (False, True))
            works = (f"{1e3 * max(r['added'] for r in each):.0f}" if each else "-" for each in (early, late))
            cells.append("; ".join(works))
        lines.append((*key, *cells, f"{1e3 * max(row.get('work_without', 0.0) for row in those):.0f}"))
    return command.table(("load", "set-point", "change", *SENSORS, "c = 0"), lines, LOSS_TITLE)


def options(parser: argparse.ArgumentParser, loss: bool = False) -> None:
    """Add the options, with the defaults for a sudden loss if `loss` is True."""
    losses = [f"{name}={share:g}" for name, share in LOSSES] if loss else []
    parser.add_argument("--loads", nargs="+", choices=tuple(INERTIA), default=tuple(INERTIA))
    parser.add_argument(
        "--set-points", nargs="+", choices=SET_POINTS, default=("sine", "constant") if loss else SET_POINTS
    )
    parser.add_argument("--changes", nargs="+", metavar="NAME=SHARE", default=losses, help="default: all, and nothing")
    parser.add_argument("--delays", type=int, nargs="+", default=(1,) if loss else (1, 3), help="periods")
    parser.add_argument("--at", type=float, nargs="+", default=(3.0, 3.5, 1.0) if loss else (AT,), help="s of the log")
    command.share(parser, "sensors sample seed rows processes json")
    parser.add_argument("--worst", action="store_true", help="also print the 20 worst of each configuration")
    parser.add_argument("--which", action="store_true", help="also print the cases that missed a goal")
    parser.set_defaults(loss=loss)


def run(chosen: argparse.Namespace) -> int:
    """Run and print the chosen cases. Return 1 if a case missed a goal."""
    found = command.drawn(cases(chosen), chosen)
    play = functools.partial(judge, compare=chosen.loss)

    def tables(rows: list[Row]) -> list[Table | str]:
        changed = [row for row in rows if row["change"]]
        tables: list[Table | str] = [losses(changed)] if chosen.loss else [table(rows)]
        tables += worst(changed) if chosen.worst else []
        tables += [listing("missed", (row for row in changed if not row["good"]))] if chosen.which else []
        count = sum(not row["good"] for row in rows)
        drawn = f"; seed {chosen.seed}" if chosen.sample else ""
        return [*tables, f"{len(rows)} runs, {len(rows) - count} as they must be, {count} missed{drawn}"]

    return command.judged(
        play, found, case_of, chosen, lambda row: row["good"], lambda row: f"{case_of(row).name}: {words(row)}", tables
    )


def words(row: Row) -> str:
    """Return the measurement as one line of text."""
    if not row["change"]:
        return f"{row['speed']:.3f} rad/s, {row['torque']:.3f} N*m at rest" + (", reported" if row["told"] else "")
    added = f"{1e3 * row['added']:.1f} mJ added, {1e3 * row['late_added']:.1f} mJ of it late"
    reported = "not reported" if row["reported"] is None else f"reported after {row['reported']:.3f} s"
    return f"{added}, {abs(row['speed']):.1f} rad/s at the change, {row['peak']:.1f} at most, {reported}"
