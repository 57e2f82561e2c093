"""Run healthy rigs, and count the reports of the guard and the faults of any check.

Usage: tools/run campaign/runaway healthy [--seconds 3600] [--sensors ...] [--loads ...] [--slices N] [--rows FILE]

Each load plays the gait (weight, free and wearer a sine) with true friction, pretension and shape, in slices of 60 s
with different noise. With --rows an interrupted run continues. --slices limits the new slices of each load in one call.
Exit code 1: there was a report of the guard or a fault.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from tools import command
from tools.campaign.passive.experiment import INERTIA, SENSORS, Experiment
from tools.campaign.passive.judge import GUARD

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


def play(part: Slice, compensation: float) -> dict[str, Any]:
    """Run a slice, and return the guard's reports and the faults."""
    set_point = "sine" if part.healthy in SINE else "gait"
    rig = Experiment(part.healthy, set_point, part.sensors, compensation=compensation, seed=part.slice, fade_in=1.0)
    result = rig.play(part.seconds)
    said = [event.text for event in result.summary.events if event.text.startswith(GUARD)]
    said += [str(fault) for fault in result.axes[0].faults]
    return {**dataclasses.asdict(part), "compensation": compensation, "said": said}


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return a line for each sensor configuration and load."""
    heads = ("sensors", "load", "with nothing wrong (s)", "runs", "reported or latched")
    found = Table(*heads, title="healthy", title_justify="left")
    for key in itertools.product(SENSORS, LOADS):
        those = [row for row in rows if (row["sensors"], row["healthy"]) == key]
        if those:
            texts = sorted({text for row in those for text in row["said"]})
            seconds = sum(row["seconds"] for row in those)
            found.add_row(*key, f"{seconds:g}", str(len(those)), "; ".join(texts) or "nothing")
    return found


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--seconds", type=float, default=3600.0, help="of each load and configuration (default 3600)")
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=("imposed", "weight", "limb"))
    parser.add_argument("--slices", type=int, default=1000, help="of each load and configuration at most")
    command.share(parser, "sensors compensation rows processes json")


def run(chosen: argparse.Namespace) -> int:
    """Run the missing slices. Return 1 if anything was reported."""
    count = math.ceil(chosen.seconds / SLICE)
    lengths = [min(SLICE, chosen.seconds - number * SLICE) for number in range(count)]
    product = itertools.product(enumerate(lengths, 1), chosen.sensors, chosen.loads)
    parts = [Slice(sensors, load, number, seconds) for (number, seconds), sensors, load in product]
    known = {key_of(row) for row in command.read_rows(chosen.rows)}
    done = [part for part in parts if (part, chosen.compensation) in known]
    waiting = [part for part in parts if (part, chosen.compensation) not in known]
    parts = done + waiting[: chosen.slices * len(chosen.sensors) * len(chosen.loads)]
    work = functools.partial(play, compensation=chosen.compensation)
    return command.judged(
        work, parts, lambda row: key_of(row)[0], chosen, lambda row: not row["said"], str, lambda rows: [table(rows)]
    )


def key_of(row: dict[str, Any]) -> tuple[Slice, float]:
    """Return the slice of a row and its compensation."""
    return command.from_row(Slice, row), row["compensation"]
