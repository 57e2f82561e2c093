"""The demo itself: plant and daemon twice on the same motion, without and with compensation."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.bus_choice import BusChoice
from tsa_ctrl.demo.motion import Play
from tsa_ctrl.demo.outcome import Outcome, read_course
from tsa_ctrl.processes import daemon, plant

RUNS = {"without": ("nominal.toml", 0.0), "with": ("nominal.toml", 0.95)}

Progress = Callable[[str, float], None]


def demo(folder: Path, bus: BusChoice, play: Play, seconds: float, rate: float, tendon: str, say: Progress) -> Outcome:
    """Run both and measure; everything is left in `folder`. `say(what, share)` reports progress.

    `seconds` of torque per run; `rate` of the loop in Hz; `tendon` is the plant's kind ("full" or "distributed").
    Raises BusError when plant or daemon fail.
    """
    rig.write(folder, bus, play, rate, tendon, RUNS)
    courses = []
    for number, name in enumerate(RUNS):
        say(f"{name} compensation: starting the plant", number / len(RUNS))
        with plant(folder):
            summary = daemon(folder, name, seconds, partial(_tick, say, name, number))
        courses.append(read_course(folder, summary, seconds))
    outcome = Outcome(bus.name, courses[0], courses[1], folder / "demo.png")
    outcome.draw(float(play.t[-1]))
    return outcome


def _tick(say: Progress, name: str, number: int, share: float) -> None:
    say(f"{name} compensation", (number + share) / len(RUNS))
