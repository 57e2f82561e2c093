"""Which trials there are: fault by phase by moment in full, the joint, the shapes and the rest drawn for each."""

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
MOMENTS = 20  # within a cycle
PAIRS = 500
TWO_AXES = 0.1  # share of the trials
LATER = 0.05  # s, within which the second of a pair follows
LOADS = ("imposed", "held", "free", "spring", "weight", "limb", "wearer")
SHAPES = ("uniform", "motor_end", "joint_end", "s_bent")
WANTED = ("constant", "sine", "step", "negative")


@dataclass(frozen=True)
class Draw:
    """What a rig is like; `seed` of its noise, `share` 0 to 1: where in a phase that lasts the fault comes."""

    load: str
    shape: str
    wanted: str
    friction: float
    pretension: float
    inertia: float  # kg*m^2 of the motor
    delay: int  # periods that the drive takes beyond the next SYNC
    sensor: bool
    axes: int
    share: float
    seed: int
    encoder: bool = True


@dataclass(frozen=True)
class Trial:
    """One trial; `names` are one fault or a pair of them, `moment` of `MOMENTS` is that of the first."""

    names: tuple[str, ...]
    phase: str
    moment: int
    gap: float  # s between the two of a pair
    draw: Draw
    sensors: str = ""  # a chosen configuration, not the drawn one

    @property
    def key(self) -> str:
        return f"{' + '.join(self.names)} | {self.phase} | {self.moment}" + f" | {self.sensors}" * bool(self.sensors)

    def with_sensors(self, sensors: str) -> Trial:
        """Return the same trial with "motor" alone, a joint "encoder", or a joint torque "sensor" and an encoder."""
        draw = dataclasses.replace(self.draw, sensor=sensors == "sensor", encoder=sensors != "motor")
        return dataclasses.replace(self, draw=draw, sensors=sensors)


def draw(rng: random.Random, axes: int = 1) -> Draw:
    """A rig whose truth is within 5 % of its file's, as after a calibration."""
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
    """Every fault in every phase at every moment, in an order of their numbers."""
    for hazard, phase, moment in itertools.product(HAZARDS, PHASES, range(MOMENTS)):
        rng = random.Random(f"{seed} {hazard.name} {phase} {moment}")
        yield Trial((hazard.name,), phase, moment, 0.0, draw(rng, hazard.axes))


def pairs(seed: int) -> Iterator[Trial]:
    """Two faults together, or one soon after the other; no trial twice."""
    for number in range(PAIRS):
        rng = random.Random(f"{seed} pair {number}")
        names = tuple(rng.sample(list(BY_NAME), 2))
        axes = max(BY_NAME[name].axes for name in names)
        gap = rng.choice((0.0, rng.uniform(0.0, LATER)))
        yield Trial(names, rng.choice(PHASES), number % MOMENTS, gap, draw(rng, axes))


def chosen(seed: int, kind: str, sample: int | None, only: tuple[str, ...], part: tuple[int, int]) -> list[Trial]:
    """The trials to run: all or a drawn sample of them, those with a word of `only`, of these every n-th.

    The order is drawn, every fault once before any comes again, so that an interrupted run has seen of everything.
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
