"""Inject every fault in every phase at twenty moments of the cycle, and judge motor and joint, in virtual time.

Usage: tools/run campaign/virtual [--pairs] [--part I/N] [--sample N] [--only TEXT]... [--rows FILE] [--seed 1]
                                  [--sensors motor encoder sensor] [--processes 1|2] [--keep] [--json] [--list]

The daemon's loop and the simulated plant share one clock. Every fault of the catalogue is injected while the loop
starts, enables, fades in, runs, is tuned, stops, is in fault, resets or recovers. The seed determines random load
(imposed, held, free, spring, weight, limb, wearer), shape of the sheath, set-point, motor, delay, sensor and number of
axes of each trial. A repeated trial has the same result to the last bit. --pairs injects two faults at once.

A fault is watched until the loop or a guard latches, and 0.45 s longer, or for 3 s. Then its cause is removed.

A trial is safe if the plant's motor torque stays within the limiter's limit. After a fault that must end the torque,
the torque must become zero within [safety] zero_torque_within and stay zero, and the cause must be reported. The joint
must not exceed the motion of the reference runs (see phase/verdict.py) by more than 2 rad/s, 0.35 rad or 0.1 J. The
work of the set-point does not count. A wrong signal that only a motion reveals is judged by these three limits.

Each trial is written to --rows (default virtual.jsonl) immediately, so the same command continues an interrupted run.
--part I/N runs every N-th trial, starting with the I-th, and --sample N the first N in a random order. --keep writes
the summary of all rows to tools/campaign/phase/hazards.json, the source of the table of hazards (`tools/run
manual/write`). The last line is `N trials, N safe`. Exit code 1: a trial was unsafe.
"""

from __future__ import annotations

import datetime
import functools
import json
import platform
from collections.abc import Iterator
from pathlib import Path

from tools import command
from tools.campaign.phase.catalogue import HAZARDS
from tools.campaign.phase.plan import Trial, chosen
from tools.campaign.phase.results import KEPT, row, summary
from tools.campaign.phase.stage import WATCH
from tools.campaign.phase.verdict import judge
from tools.command import Row
from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--pairs", action="store_true", help="two faults at once: a drawn sample of 500")
    parser.add_argument("--part", default="1/1", metavar="I/N", help="every N-th trial from the I-th on")
    parser.add_argument("--only", action="append", default=[], metavar="TEXT", help="trials with TEXT in their name")
    parser.add_argument("--sensors", nargs="+", choices=command.SENSORS, help="default: as drawn")
    command.share(parser, "sample rows seed processes json", rows=Path("virtual.jsonl"), seed=1)
    parser.add_argument("--keep", action="store_true", help="write the summary of all rows for the manual")
    parser.add_argument("--list", action="store_true", help="only print the names of the trials")
    options = parser.parse_args()
    kind = "pairs" if options.pairs else "full"
    trials = chosen(options.seed, kind, options.sample or None, tuple(options.only), part(options.part))
    if options.sensors:
        trials = [trial.with_sensors(sensors) for trial in trials for sensors in options.sensors]
    if options.list:
        print("\n".join(trial.key for trial in trials))
        return 0
    if not trials:
        raise UsageError(f"no trial has '{', '.join(options.only)}' in its name; see --list")
    by_key = {(options.seed, trial.key): trial for trial in trials}
    work = functools.partial(play, by_key)
    rows = command.run_rows(work, list(by_key), lambda each: (each["seed"], each["key"]), options)
    if options.keep:
        keep([each for each in command.read_rows(options.rows) if each["seed"] == options.seed], options.seed)
    command.print_tables(rows, options, lambda: report(rows))
    return int(any(each["wrong"] for each in rows))


def part(text: str) -> tuple[int, int]:
    """Return I and N of "I/N".

    Raises:
        UsageError: The text has another form.
    """
    place, slash, parts = text.partition("/")
    if not (slash and place.isdigit() and parts.isdigit() and 1 <= int(place) <= int(parts)):
        raise UsageError(f"--part {text}: allowed is I/N with I from 1 to N, for example 1/4")
    return int(place), int(parts)


def play(trials: dict[tuple[int, str], Trial], key: tuple[int, str]) -> Row:
    """Return the row of one trial."""
    return row(trials[key], judge(trials[key]), key[0])


def keep(rows: list[Row], seed: int) -> None:
    """Write the summary for the manual."""
    about = {
        "date": datetime.date.today().isoformat(),
        "python": platform.python_version(),
        "seed": seed,
        "watched": WATCH,
        "trials": len(rows),
        "pairs": sum(len(each["names"]) == 2 for each in rows),
        "safe": sum(not each["wrong"] for each in rows),
    }
    settings.write_text(KEPT, json.dumps({"about": about, "hazards": summary(rows)}, indent=1) + "\n")


def report(rows: list[Row]) -> Iterator[str]:
    """Yield a line for each hazard, the unsafe trials, and the totals."""
    found = summary(rows)
    for hazard, each in ((hazard, found[hazard.name]) for hazard in HAZARDS if hazard.name in found):
        within = "" if each["zero_worst"] is None else f", zero after {1e3 * each['zero_worst']:.0f} ms at most"
        yield f"{hazard.name:42.42} {each['safe']:>4} of {each['trials']:>4} safe{within}"
    unsafe = [each for each in rows if each["wrong"]]
    for each in unsafe:
        yield f"unsafe: {each['key']} ({', '.join(map(str, each['rig']))}): {'; '.join(each['wrong'])}"
    yield f"\n{len(rows)} trials, {len(rows) - len(unsafe)} safe"
