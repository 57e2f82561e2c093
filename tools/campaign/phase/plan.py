"""Generate the trials of the campaign: each fault in each phase at each moment, each with a random rig."""

from __future__ import annotations

import dataclasses
import itertools
import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from tools.campaign.phase.catalogue import BY_NAME, HAZARDS

PHASES = (
    "start", "enabling", "ramping", "running", "tuning", "stopping", "fault", "resetting", "recovering",
)  # fmt: skip
MOMENTS = 20  # moments within a cycle
PAIRS = 500  # trials with two faults
TWO_AXES = 0.1  # share of the trials
LATER = 0.05  # s, longest time between the two faults of a pair
LOADS = ("imposed", "held", "free", "spring", "weight", "limb", "wearer")
SHAPES = ("uniform", "motor_end", "joint_end", "s_bent")
WANTED = ("constant", "sine", "step", "negative")


@dataclass(frozen=True)
class Draw:
    """A random rig. `seed` is the seed of its noise. `share` is the relative time of the fault in the phase, 0 to 1."""

    load: str
    shape: str
    wanted: str
    friction: float
    pretension: float
    inertia: float  # kg*m^2 of the motor
    delay: int  # periods, in addition to the next SYNC
    sensor: bool
    axes: int
    share: float
    seed: int
    encoder: bool = True


@dataclass(frozen=True)
class Trial:
    """One trial with one fault or a pair of faults. `moment`, from 0 to `MOMENTS` - 1, is the time of the first one."""

    names: tuple[str, ...]
    phase: str
    moment: int
    gap: float  # s between the two faults of a pair
    draw: Draw
    sensors: str = ""  # sensor configuration that replaces the random one

    @property
    def key(self) -> str:
        return f"{' + '.join(self.names)} | {self.phase} | {self.moment}" + f" | {self.sensors}" * bool(self.sensors)

    def with_sensors(self, sensors: str) -> Trial:
        """Return the same trial with the sensors "motor", "encoder" or "sensor" (both joint sensors)."""
        draw = dataclasses.replace(self.draw, sensor=sensors == "sensor", encoder=sensors != "motor")
        return dataclasses.replace(self, draw=draw, sensors=sensors)


def draw(rng: random.Random, axes: int = 1) -> Draw:
    """Return a random rig with friction and pretension within 5 % of the file's values, as after a calibration."""
    return Draw(
        load=rng.choice(LOADS),
        shape=rng.choice(SHAPES),
        wanted=rng.choice(WANTED),
        friction=rng.uniform(0.95, 1.05),
        pretension=rng.uniform(0.95, 1.05),
        inertia=rng.choice((3e-5, 1e-4, 6e-4)),
        delay=rng.choice((0, 0, 1, 2)),
        sensor=rng.random() < 0.75,
        axes=max(axes, 1 + (rng.random() < TWO_AXES)),
        share=rng.random(),
        seed=rng.randrange(1 << 30),
    )


def full(seed: int) -> Iterator[Trial]:
    """Yield every fault in every phase at every moment."""
    for hazard, phase, moment in itertools.product(HAZARDS, PHASES, range(MOMENTS)):
        rng = random.Random(f"{seed} {hazard.name} {phase} {moment}")
        yield Trial((hazard.name,), phase, moment, 0.0, draw(rng, hazard.axes))


def pairs(seed: int) -> Iterator[Trial]:
    """Yield trials with two faults, at the same time or shortly after each other."""
    for number in range(PAIRS):
        rng = random.Random(f"{seed} pair {number}")
        names = tuple(rng.sample(list(BY_NAME), 2))
        axes = max(BY_NAME[name].axes for name in names)
        gap = rng.choice((0.0, rng.uniform(0.0, LATER)))
        yield Trial(names, rng.choice(PHASES), number % MOMENTS, gap, draw(rng, axes))


def chosen(seed: int, kind: str, sample: int | None, only: tuple[str, ...], part: tuple[int, int]) -> list[Trial]:
    """Return the trials to run.

    `only` selects the trials whose key contains one of its words. `sample` selects that many trials, and `part` every
    n-th of them. The order is random, but each fault occurs once before any fault occurs again. Therefore an
    interrupted run has trials of every fault.
    """
    trials = [*full(seed)] if kind == "full" else [*pairs(seed)]
    trials = [trial for trial in trials if not only or any(word in trial.key for word in only)]
    random.Random(seed).shuffle(trials)
    seen: Counter[tuple[str, ...]] = Counter()
    turns = []
    for trial in trials:
        turns.append(seen[trial.names])
        seen[trial.names] += 1
    trials = [trials[n] for n in sorted(range(len(trials)), key=turns.__getitem__)]
    place, parts = part
    return trials[: len(trials) if sample is None else sample][place - 1 :: parts]
