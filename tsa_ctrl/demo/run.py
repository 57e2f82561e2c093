"""Runs of plant and daemon on the same motion; the demo is two of them, without and with compensation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.bus_choice import BusChoice
from tsa_ctrl.demo.motion import Play
from tsa_ctrl.demo.outcome import Course, Outcome, course_of
from tsa_ctrl.demo.stage import runs_on

COMPENSATION = 0.95

Progress = Callable[[str, float], None]


def demo(
    folder: Path,
    bus: BusChoice,
    play: Play,
    seconds: float,
    rate: float,
    tendon: str,
    say: Progress,
    load: str = "imposed",
) -> Outcome:
    """Run both and measure; everything is left in `folder`. `say(what, share)` reports progress.

    `seconds` of torque per run; `rate` of the loop in Hz; `tendon` is the plant's kind ("full" or "distributed") and
    `load` what the joint drives. Raises BusError when plant or daemon fail.
    """
    controllers = {
        name: rig.controller(bus, name, rate, "nominal.toml", compensation)
        for name, compensation in (("without", 0.0), ("with", COMPENSATION))
    }
    courses = compare(folder, bus, play, rig.plant(bus, tendon, load=load), controllers, seconds, say)
    outcome = Outcome(bus.name, load, courses["without"], courses["with"], folder / "demo.png")
    outcome.draw(play.shown)
    return outcome


def compare(
    folder: Path,
    bus: BusChoice,
    play: Play,
    plant_tables: rig.Tables,
    controllers: Mapping[str, rig.Tables],
    seconds: float,
    say: Progress,
) -> dict[str, Course]:
    """Each controller for `seconds` on a plant that starts anew, with the same motion; their courses by name."""
    rig.write(folder, play, plant_tables, controllers)
    run = runs_on(bus)
    courses = {}
    for number, name in enumerate(controllers):
        say(f"{name} compensation: starting the plant", number / len(controllers))
        summary = run(folder, name, seconds, partial(_tick, say, name, number, len(controllers)))
        courses[name] = course_of(folder, summary, seconds)
    return courses


def _tick(say: Progress, name: str, number: int, runs: int, share: float) -> None:
    say(f"{name} compensation", (number + share) / runs)
