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
import functools
import itertools
import textwrap
from collections.abc import Sequence

from rich.table import Table

from tools import command
from tools.campaign.passive.cases import AT, CONFIRMED, Case, judge
from tools.campaign.passive.experiment import INERTIA, SENSORS, SET_POINTS
from tools.command import Row
from tsa_ctrl.errors import UsageError

CHANGES = {
    "pretension": (0.1, 0.3, 0.5, 0.7, 0.9),
    "friction": (0.1, 0.5, 0.75, 1.25, 1.5),
    "bending": (0.8, 0.9, 1.1, 1.2),
    "torque_gain": (1.4, 2.0),
}
case_of = functools.partial(command.from_row, Case)
LOSSES = (("pretension", 0.5), ("friction", 0.1), ("torque_gain", 1.4), ("torque_gain", 2.0))
LOSS_TITLE = "loss: worst work added (mJ) before; once both directions have slid"


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
    heads = ("sensors", "load", "set-point", "runs", "added, worst (mJ)", "goal", "late, worst (mJ)", "reported")
    found = Table(*heads, "latched", "missed", "at rest (rad/s; N·m)", title="changes", title_justify="left")
    for key in itertools.product(SENSORS, INERTIA, SET_POINTS):
        those = [row for row in rows if (row["sensors"], row["load"], row["set_point"]) == key]
        changed = [row for row in those if row["change"]]
        if not those:
            continue
        resting = [row for row in those if not row["change"]]
        rest = f"{max(r['speed'] for r in resting):.3f}; {max(r['torque'] for r in resting):.3f}" if resting else "-"
        goals = {case_of(row).most for row in changed} - {None}
        found.add_row(
            *key,
            str(len(those)),
            f"{1e3 * max((row['added'] for row in changed), default=0.0):.1f}",
            ", ".join(f"{1e3 * most:.0f}" for most in sorted(filter(None, goals))) or "-",
            f"{1e3 * max((row['late_added'] for row in changed), default=0.0):.1f}",
            str(sum(row["reported"] is not None for row in changed)),
            str(sum(row["latched"] is not None for row in changed)),
            str(sum(not row["good"] for row in those)),
            rest,
        )
    return found


LISTED: command.Columns = {
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
    "reported (s)": command.seconds_of("reported"),
    "latched (s)": command.seconds_of("latched"),
    "after (mJ)": lambda row: None if row["acted"] is None else f"{1e3 * row['after']:.1f}",
    "late (mJ)": lambda row: f"{1e3 * row['late_added']:.1f}",
    "report": lambda row: textwrap.shorten(row["words"].split(";")[0].split(":")[0], 34, placeholder=" ..."),
}


def losses(rows: Sequence[Row]) -> Table:
    """Return a line for each load, set-point and loss, with the worst work before and after CONFIRMED, mJ."""
    found = Table("load", "set-point", "change", *SENSORS, "c = 0", title=LOSS_TITLE, title_justify="left")
    keys = dict.fromkeys((row["load"], row["set_point"], case_of(row).what) for row in rows)
    for key in keys:
        those = [row for row in rows if (row["load"], row["set_point"], case_of(row).what) == key]
        cells = []
        for sensors in SENSORS:
            mine = [row for row in those if row["sensors"] == sensors]
            early, late = ([row for row in mine if (row["at"] >= CONFIRMED) is known] for known in (False, True))
            cells.append(
                "; ".join(f"{1e3 * max(r['added'] for r in each):.0f}" if each else "-" for each in (early, late))
            )
        found.add_row(*key, *cells, f"{1e3 * max(row.get('work_without', 0.0) for row in those):.0f}")
    return found


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
    command.share(parser, "sensors compensation sample seed rows processes json")
    parser.add_argument("--worst", action="store_true", help="also print the 20 worst of each configuration")
    parser.add_argument("--which", action="store_true", help="also print the cases that missed a goal")
    parser.set_defaults(loss=loss)


def run(chosen: argparse.Namespace) -> int:
    """Run and print the chosen cases. Return 1 if a case missed a goal."""
    found = command.drawn(cases(chosen), chosen)
    play = functools.partial(judge, compensation=chosen.compensation, compare=chosen.loss)

    def tables(rows: list[Row]) -> list[Table | str]:
        changed = [row for row in rows if row["change"]]
        tables: list[Table | str] = [losses(changed)] if chosen.loss else [table(rows)]
        tables += command.worst(changed, "added", LISTED) if chosen.worst else []
        tables += (
            [command.listing("missed", [row for row in changed if not row["good"]], LISTED)] if chosen.which else []
        )
        count = sum(not row["good"] for row in rows)
        drawn = f"; seed {chosen.seed}" if chosen.sample else ""
        return [*tables, f"{len(rows)} runs, {len(rows) - count} as they must be, {count} missed{drawn}"]

    key = functools.partial(_at, compensation=chosen.compensation)
    return command.judged(play, found, key, chosen, good, lambda row: f"{case_of(row).name}: {words(row)}", tables)


def good(row: Row) -> bool:
    """Return True if a case met its goals."""
    return bool(row["good"])


def _at(row: Row, compensation: float) -> Case | None:
    """Return the case of a row, or None if the row has another compensation."""
    return case_of(row) if row["compensation"] == compensation else None


def words(row: Row) -> str:
    """Return the measurement as one line of text."""
    if not row["change"]:
        return f"{row['speed']:.3f} rad/s, {row['torque']:.3f} N*m at rest" + (", reported" if row["told"] else "")
    added = f"{1e3 * row['added']:.1f} mJ added, {1e3 * row['late_added']:.1f} mJ of it late"
    reported = "not reported" if row["reported"] is None else f"reported after {row['reported']:.3f} s"
    return f"{added}, {abs(row['speed']):.1f} rad/s at the change, {row['peak']:.1f} at most, {reported}"
