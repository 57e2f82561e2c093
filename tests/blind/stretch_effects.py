"""Hidden effects that are visible only in the angles of both pulleys, calculated without code of the package."""

from __future__ import annotations

from typing import Any

import numpy as np

from .bench import Bench, Run
from .plant import Tensions

Array = np.ndarray
NAMES = ("series_spring", "tendon_creep", "pulley_slip", "joint_play")


def added(name: str, parameters: dict[str, Any], tensions: Tensions, t: Array, joint_radius: float) -> Array:
    """Return the amount (m) that the effect adds to r_M q_M - r_J q_J, (n,). t (s) is the time column of the log."""
    match name:
        case "series_spring":  # half the difference of both springs' elongations
            a, b = (
                (tensions.t2, tensions.t4) if parameters.get("end", "motor") == "joint" else (tensions.t1, tensions.t3)
            )
            return 0.5 * (b / parameters["stiffness"] - a / parameters["stiffness"])
        case "tendon_creep":
            return parameters["length"] * (1.0 - np.exp((t[0] - t) / parameters["time_constant"]))
        case "pulley_slip":
            return np.where(t >= parameters["time"], parameters["length"], 0.0)
        case "joint_play":  # the pulley leads the joint by half of the gap in the direction of its torque
            return joint_radius * 0.5 * parameters["gap"] * np.sign(tensions.t4 - tensions.t2)
    raise ValueError(f"unknown effect: {name}")


def draw(rng: np.random.Generator, name: str, bench: Bench, run: Run, reach: float) -> dict[str, Any]:
    """Return random parameters with a size of 0.3 to 1 times `reach` (m), the tendon elongation of that run."""
    size = rng.uniform(0.3, 1.0) * reach
    sign = float(rng.choice([-1.0, 1.0]))
    t = run.pick(run.scene.t)
    seconds = float(t[-1] - t[0])
    match name:
        case "series_spring":
            return {
                "stiffness": bench.rig.tendon_stiffness / rng.uniform(0.5, 1.5),
                "end": str(rng.choice(["motor", "joint"])),
            }
        case "tendon_creep":
            return {"length": sign * size, "time_constant": seconds * rng.uniform(0.06, 0.25)}
        case "pulley_slip":
            return {"length": sign * size, "time": bench.clock_start + seconds * rng.uniform(0.15, 0.85)}
        case "joint_play":
            return {"gap": 2.0 * size / bench.rig.joint_radius}
    raise ValueError(f"unknown effect: {name}")
