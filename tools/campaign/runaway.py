"""Whether compensation ever moves a joint by itself: loads, set-points and sudden changes, in virtual time.

Usage: tools/run campaign/runaway [--sample N] [--rows FILE] [--delays 1 3] [--compensation 0.95] [--json]
       [--loads free ...] [--set-points constant ...] [--missed FILE] [--which] [--healthy SECONDS [--slices N]]
       tools/run campaign/runaway scan --help

Each case is one run of the real loop on distributed tendons, whose model file is true until 1.2 s: then pretension,
friction or bending step to a share of what they were, and a joint that stands is nudged (a limb's hand lets go). Judged
by the plant's truth from then on:

  work    most that the joint was given beyond the set-point's work within any window, J/2 (1 rad/s)^2 at most; where it
          is more, the same run without compensation is made, and what is given there, too, is not the compensation's
  late    the same, counted from 1 s after the first `FELT` on: at most `FELT`
  told    the guard said so where more than it allows was given, and latched where it happened again, or the estimate
          did, which then is what is compensated
  after   of the work, what was given after the first time that the guard had taken everything back: delay, and a motor
          that swings on tendons that it has wound up; it grows with the joint's speed at the change (`speed`)

With nothing changed the set-point ends instead: 3 s later the joint must stand (0.02 rad/s RMS) and the motor be quiet
(0.02 N*m peak to peak). --sample N: N cases spread over all, the same ones each time. --missed FILE: those alone that
missed a goal in that file of rows. --rows FILE: cases that are in the file are not run again, new ones are added, and
the table is that of the file; --which: a table of those that missed, instead. --healthy SECONDS: instead, that long of
gait (of a sine on weight, free and wearer) on each load with nothing wrong, in slices of `SLICE` s with noise of their
own: the guard must say nothing. With --rows it goes on where it was, by --slices of each load at most. Exit code 1: a
goal was missed.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tools import command
from tools.bench.results import read_rows
from tools.campaign.passive import scan
from tools.campaign.passive.cases import LOADS, SET_POINTS, Case, cases
from tools.campaign.passive.judge import healthy, judge, words
from tsa_ctrl.errors import UsageError

HEALTHY = ("imposed", *LOADS, "wearer")
SLICE = 60.0  # s of a healthy run at once: what was run is kept, and a log of an hour does not fit into memory


def all_healthy(options: argparse.Namespace) -> int:
    """Slices of each load up to what is asked for, a slice of each in turn; 1 if the guard said anything."""
    rows = [row for row in read_rows(options.rows) if "healthy" in row and row["compensation"] == options.compensation]
    loads = [load for load in HEALTHY if load in options.loads]
    for _, load in itertools.product(range(min(options.slices, math.ceil(options.healthy / SLICE))), loads):
        done = [row for row in rows if row["healthy"] == load]
        left = options.healthy - sum(row["seconds"] for row in done)
        if left > 0.0:
            rows.append(healthy(load, 1 + len(done), min(SLICE, left), options.compensation))
            _keep(options, rows[-1])
    Console(width=130).print(quiet_hours(rows, loads))
    return 1 if any(row["said"] for row in rows) else 0


def quiet_hours(rows: Sequence[dict[str, Any]], loads: Sequence[str]) -> Table:
    """A line for each load: how long it went with nothing wrong, and what was said all the same."""
    found = Table("load", "with nothing wrong (s)", "runs", "said or latched", title="healthy", title_justify="left")
    for load in loads:
        done = [row for row in rows if row["healthy"] == load]
        texts = sorted({text for row in done for text in row["said"]})
        seconds = sum(row["seconds"] for row in done)
        found.add_row(load, f"{seconds:g}", str(len(done)), "; ".join(texts) or "nothing")
    return found


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """One line for each load and set-point, and the sum."""
    heads = ("load", "set-point", "runs", "work, worst (mJ)", "of", "late, worst (mJ)", "told", "latched", "missed")
    found = Table(*heads, "at rest (rad/s; N·m)", title="runaway", title_justify="left")
    for load, set_point in itertools.product(LOADS, SET_POINTS):
        those = [row for row in rows if (row["load"], row["set_point"]) == (load, set_point)]
        changed = [row for row in those if row["change"]]
        if not those:
            continue
        resting = [row for row in those if not row["change"]]
        rest = f"{max(r['speed'] for r in resting):.3f}; {max(r['torque'] for r in resting):.3f}" if resting else "-"
        found.add_row(
            load,
            set_point,
            str(len(those)),
            f"{1e3 * max((row['added'] for row in changed), default=0.0):.1f}",
            f"{0.5e3 * LOADS[load]:.0f}",
            f"{1e3 * max((row['late_added'] for row in changed), default=0.0):.1f}",
            str(sum(row["told"] for row in changed)),
            str(sum(row["latched"] for row in changed)),
            str(sum(not row["good"] for row in those)),
            rest,
        )
    return found


def which(rows: Sequence[dict[str, Any]]) -> Table:
    """A line for each that missed, and how much of what it was given came when everything had been taken back."""
    heads = (
        "load",
        "set-point",
        "change",
        "delay (periods)",
        "at first (rad/s)",
        "added (mJ)",
        "after (mJ)",
        "late (mJ)",
    )
    found = Table(*heads, "told", title="missed", title_justify="left")
    for row in rows:
        if not row["good"] and row["change"]:
            found.add_row(
                row["load"],
                row["set_point"],
                f"{row['change']} {row['share']:g}",
                str(row["delay"]),
                f"{abs(row['speed']):.1f}",
                f"{1e3 * row['added']:.1f}",
                "-" if row["acted"] is None else f"{1e3 * row['after']:.1f}",
                f"{1e3 * row['late_added']:.1f}",
                "no" if row["silent"] else "yes",
            )
    return found


def spread(all_cases: list[Case], number: int) -> list[Case]:
    """`number` of them, in steps that meet every load, set-point and change alike."""
    stride = 37  # prime to any count of cases here
    count = len(all_cases)
    return [all_cases[(k * stride) % count] for k in range(min(number, count))]


def main() -> int:
    if sys.argv[1:2] == ["scan"]:
        parser = command.parser(f"{__name__} scan", scan.__doc__)
        scan.options(parser)
        return scan.run(parser.parse_args(sys.argv[2:]))
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--sample", type=int, default=0, help="so many cases; 0: all")
    parser.add_argument("--rows", type=Path, help="JSON lines of what was run, kept and added to")
    parser.add_argument("--missed", type=Path, help="JSON lines of an earlier run: only what missed a goal there")
    parser.add_argument("--which", action="store_true", help="a table of what missed a goal, instead")
    parser.add_argument("--loads", nargs="+", choices=HEALTHY, default=HEALTHY)
    parser.add_argument("--set-points", nargs="+", choices=SET_POINTS, default=SET_POINTS)
    parser.add_argument("--delays", type=int, nargs="+", default=(1, 3), help="periods from measurement to torque")
    parser.add_argument("--compensation", type=float, default=0.95, help="share of the friction term (default 0.95)")
    parser.add_argument("--json", action="store_true", help="a JSON object a case, instead of the table")
    parser.add_argument("--healthy", type=float, metavar="SECONDS", help="gait with nothing wrong, on each load")
    parser.add_argument("--slices", type=int, default=1000, help="of a healthy run, of each load at most")
    options = parser.parse_args()
    if options.healthy is not None:
        if not options.healthy > 0.0:
            parser.error(f"--healthy {options.healthy:g}: more than 0 s")
        return all_healthy(options)
    wanted = cases(options.delays)
    chosen = spread(wanted, options.sample) if options.sample else wanted
    chosen = [case for case in chosen if case.load in options.loads and case.set_point in options.set_points]
    if options.missed is not None:
        if not options.missed.is_file():
            raise UsageError(f"{options.missed}: no such file; give the rows of an earlier run")
        missed = {_key(row) for row in read_rows(options.missed) if not row["good"]}
        chosen = [case for case in chosen if _key_of(case, options) in missed]
    rows = [row for row in read_rows(options.rows) if "healthy" not in row]
    done = {_key(row) for row in rows}
    quiet = options.json or options.which
    if not quiet:
        for row in rows:
            say(row)
    for case in chosen:
        if _key_of(case, options) in done:
            continue
        row = judge(case, options.compensation)
        rows.append(row)
        _keep(options, row)
        if options.json:
            print(json.dumps(row), flush=True)
        elif not quiet:
            say(row)
    if options.which:
        Console(width=130).print(which(rows))
    elif not options.json:
        Console(width=130).print(table(rows))
        count = sum(not row["good"] for row in rows)
        print(f"{len(rows)} runs, {len(rows) - count} as they must be, {count} missed")
    return 0 if all(row["good"] for row in rows) else 1


def say(row: dict[str, Any]) -> None:
    """A line for what missed a goal."""
    if not row["good"]:
        case = Case(**{field.name: row[field.name] for field in dataclasses.fields(Case)})
        print(f"missed: {case.name}: {words(row)}", flush=True)


def _keep(options: argparse.Namespace, row: dict[str, Any]) -> None:
    if options.rows is not None:
        with options.rows.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def _key_of(case: Case, options: argparse.Namespace) -> tuple[Any, ...]:
    return _key(dataclasses.asdict(case) | {"compensation": options.compensation})


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[name] for name in ("load", "set_point", "change", "share", "delay", "compensation"))
