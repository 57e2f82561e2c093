"""Create logs of a sheath whose wrap angle depends on other joints. `[routing]` in the file may be wrong or absent.

The angles of a hip and an ankle change the rig's wrap angle. Friction and pretension are calculated from it with the
four tensions of `plant`. No code is shared with the package under test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import sensors
from .bench import Recipe, draw_bench
from .cases import Case, finish, generator
from .motion import wander
from .rig import log_uniform

NAMES = ("absent", "wrong", "two", "right")
SWING = (0.3, 0.8)  # rad, half range of the hip motion
COUNTS = 2**16  # counts per revolution of the other joints' encoders


@dataclass(frozen=True)
class Gains:
    """True gains and gains of the model file, in rad of wrap angle per rad of a joint."""

    true: dict[str, float]
    file: dict[str, float]

    @property
    def missing(self) -> dict[str, float]:
        """Return the differences between the true gains and the gains of the file."""
        return {joint: gain - self.file.get(joint, 0.0) for joint, gain in self.true.items()}


def routed_case(name: str, seed: int, short: bool = False) -> tuple[Case, Gains]:
    """Return a case and its gains. `name` selects no routing in the file, wrong gains, two joints or the right gain."""
    rng = generator("routed", name, seed)
    recipe = Recipe(bending="varied", level=(0.3, 0.6), x=(0.15, 0.6), joint_angle=True, sign_noise=1.0, short=short)
    bench = draw_bench(rng, recipe)
    sign = float(rng.choice([-1.0, 1.0]))
    bent = [run.scene.theta - bench.rig.bending for run in bench.runs]
    reach = max(float(np.max(np.abs(each))) for each in bent)
    hip = sign * reach / rng.uniform(*SWING)
    ankle = -0.5 * hip if name == "two" else 0.0
    angles = []
    for run, theta in zip(bench.runs, bent, strict=True):
        other = 0.4 * wander(rng, run.scene.t, float(np.ptp(run.scene.t)) / rng.uniform(3.0, 5.0))
        angles.append({"hip": (theta - ankle * other) / hip, "ankle": other})
    case = finish(rng, "routed", name, seed, bench, {}, bench.reading * log_uniform(rng, 0.004, 0.012), "rich")
    for log, run, joints in zip(case.logs, bench.runs, angles, strict=True):
        del log.columns["theta"]
        for joint, angle in joints.items():
            log.columns[f"q_j.{joint}"] = sensors.encoder(rng, run.pick(angle), COUNTS)
    true = {"hip": hip, **({"ankle": ankle} if ankle else {})}
    off = float(rng.choice([-1.0, 1.0])) * rng.uniform(0.2, 0.4)
    file = {"wrong": {"hip": hip / (1.0 + off)}, "right": true}.get(name, {})
    if file:
        case.model += f"\n[routing]\njoints = {{ hip = {file['hip']!r} }}\n"
    return case, Gains(true, file)
