"""Run healthy rigs, and count the reports of the guard and the faults of any check.

Usage: tools/run campaign/runaway healthy [--seconds 3600] [--sensors ...] [--loads ...] [--rows FILE]

Each load plays the gait (weight, free and wearer a sine) with true friction, pretension and shape, in slices of 60 s
with different noise. With --rows an interrupted run continues. Exit code 1: there was a report of the guard or a fault.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table

from tools import command
from tools.campaign.passive.experiment import INERTIA, Experiment
from tools.campaign.passive.judge import GUARD
from tools.command import SENSORS, Row

LOADS = ("imposed", *INERTIA)
SLICE = 60.0  # s; a log of an hour does not fit into memory
SINE = ("weight", "free", "wearer")  # loads that would move too fast with the gait


@dataclass(frozen=True)
class Slice:
    """A part of a healthy run. `slice` is its number and the seed of its noise."""

    sensors: str
    healthy: str
    slice: int
    seconds: float


def play(part: Slice) -> Row:
    """Run a slice, and return the guard's reports and the faults."""
    set_point = "sine" if part.healthy in SINE else "gait"
    result = Experiment(part.healthy, set_point, part.sensors, seed=part.slice, fade_in=1.0).play(part.seconds)
    said = [event.text for event in result.summary.events if event.text.startswith(GUARD)]
    said += [str(fault) for fault in result.axes[0].faults]
    return {**dataclasses.asdict(part), "said": said}


def table(rows: Sequence[Row]) -> Table:
    """Return a line for each sensor configuration and load."""
    lines = []
    for key, those in command.parts(rows, sensors=SENSORS, healthy=LOADS):
        texts = sorted({text for row in those for text in row["said"]})
        seconds = sum(row["seconds"] for row in those)
        lines.append((*key, f"{seconds:g}", len(those), "; ".join(texts) or "nothing"))
    heads = ("sensors", "load", "time without a fault (s)", "runs", "reports and latches")
    return command.table(heads, lines, "healthy")


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--seconds", type=float, default=3600.0, help="of each load and configuration (default 3600)")
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=("imposed", "weight", "limb"))
    command.share(parser, "sensors rows processes json")


def run(chosen: argparse.Namespace) -> int:
    """Run the missing slices. Return 1 if anything was reported."""
    count = math.ceil(chosen.seconds / SLICE)
    lengths = [min(SLICE, chosen.seconds - number * SLICE) for number in range(count)]
    product = itertools.product(enumerate(lengths, 1), chosen.sensors, chosen.loads)
    parts = [Slice(sensors, load, number, seconds) for (number, seconds), sensors, load in product]
    key = functools.partial(command.from_row, Slice)
    return command.judged(play, parts, key, chosen, lambda row: not row["said"], str, lambda rows: [table(rows)])
