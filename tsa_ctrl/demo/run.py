"""Run plant and daemon on the same motion, once without and once with compensation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.outcome import Course, Outcome, course_of
from tsa_ctrl.demo.rig import BusChoice, Play
from tsa_ctrl.errors import BusError
from tsa_ctrl.system.process_supervisor import daemon, plant

COMPENSATION = 0.95
RATE = 1000.0  # Hz
LEFT_OUT = 0.1  # share of cycles: occasional stalls skip less than 0.02, a machine that is too slow skips a third

Progress = Callable[[str, float], None]
Run = Callable[[Path, str, float, Callable[[float], None]], dict[str, Any]]  # folder, name, seconds, tick -> summary


def runs_on(bus: BusChoice) -> Run:
    """Return a function that runs `controller-NAME.toml` of a folder on a new plant, and returns the run's summary.

    Plant and daemon run as processes on the bus, or both in this process in virtual time.
    """
    if bus.virtual:
        from tsa_ctrl.virtual.simulation import play  # the loop and the plant in this process

        return play
    return _on_the_bus


def _on_the_bus(folder: Path, name: str, seconds: float, tick: Callable[[float], None]) -> dict[str, Any]:
    with plant(folder):
        return daemon(folder, name, seconds, tick)


def demo(
    folder: Path,
    bus: BusChoice,
    play: Play,
    seconds: float,
    rate: float | None,
    tendon: str,
    say: Progress,
    load: str = "imposed",
) -> Outcome:
    """Run without and with compensation and return the outcome; all files stay in `folder`.

    Args:
        folder: folder of the files.
        bus: bus of plant and daemon.
        play: motion and set-point.
        seconds: torque per run, s.
        rate: rate of the loop, Hz; None: RATE, at which a machine that is too slow is an error.
        tendon: kind of the plant's tendon, "full" or "distributed".
        say: receives a text and the completed share.
        load: load of the joint.

    Raises:
        BusError: the plant or the daemon failed, or the machine is too slow.
    """
    taken, plant = rate or RATE, rig.plant(bus, tendon, load=load)
    controllers = {
        name: rig.controller(bus, name, taken, "nominal.toml", compensation)
        for name, compensation in (("without", 0.0), ("with", COMPENSATION))
    }
    courses = compare(folder, bus, play, plant, controllers, seconds, say)
    skipped = max(course.skipped for course in courses.values())
    if rate is None and skipped > LEFT_OUT:
        raise BusError(
            f"the loop skipped {skipped:.0%} of its cycles; this machine, which also simulates drive and joint, cannot "
            f"sustain {taken:g} Hz: give a lower --rate"
        )
    outcome = Outcome(bus.name, load, courses["without"], courses["with"], folder / "demo.png", taken)
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
    """Run each controller for `seconds` on a new plant with the same motion; return their courses by name."""
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
