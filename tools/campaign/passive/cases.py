"""What the runaway campaign plays: the real loop on distributed tendons whose sheath changes at once.

Nothing is drawn: the same case is the same run.
"""

from __future__ import annotations

import dataclasses
import itertools
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tools.bench.control import true_model
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.bus_choice import VIRTUAL
from tsa_ctrl.demo.motion import gait, play_for
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change, Fault
from tsa_ctrl.virtual.simulation import simulate_loop

LOADS = {"weight": 0.02, "spring": 0.02, "free": 0.02, "limb": 0.05}  # kg*m^2
SET_POINTS = ("zero", "constant", "sine", "gait")
CHANGES = {
    "pretension": (0.1, 0.3, 0.5, 0.7, 0.9),
    "friction": (0.5, 0.75, 1.25, 1.5),
    "bending": (0.8, 0.9, 1.1, 1.2),
}
GAIT_SHARE = {"weight": 0.4, "free": 0.4}  # of the gait's torque: a joint of 0.02 kg*m^2 stays below 5 rad/s
CONSTANT, SINE = 0.3, 0.5  # N*m
AT, SECONDS = 1.2, 2.1  # s of the log: of the change, and from it to the end
LET_GO = 0.2  # s after it
TO_REST, REST, MEASURED = 2.0, 3.0, 1.0  # s: the set-point's gain goes to 0, all comes to rest, then it is seen


@dataclasses.dataclass(frozen=True)
class Case:
    """What is played; `change` "" is nothing."""

    load: str
    set_point: str
    change: str
    share: float
    delay: int

    @property
    def name(self) -> str:
        what = f"{self.change} {self.share:g}" if self.change else "nothing"
        return f"{self.load}, {self.set_point}, {what}, delay {self.delay}"


def cases(delays: Sequence[int]) -> list[Case]:
    """All of them."""
    changes = [("", 1.0)] + [(name, share) for name, shares in CHANGES.items() for share in shares]
    return [
        Case(load, set_point, *change, delay)
        for load, set_point, change, delay in itertools.product(LOADS, SET_POINTS, changes, delays)
    ]


def modelled() -> TendonSheath:
    """The controller's model: true friction, pretension and shape; the tendons' stiffness as the data sheet has it."""
    return dataclasses.replace(true_model("uniform"), axial_stiffness=rig.NOMINAL.axial_stiffness)


def play(case: Case, compensation: float) -> Simulation:
    """Run a case."""
    motion = gait()
    scaled = dataclasses.replace(motion, tau_j_des=GAIT_SHARE.get(case.load, 1.0) * motion.tau_j_des)
    with tempfile.TemporaryDirectory(prefix="runaway-") as name:
        folder = Path(name)
        save_model(modelled(), folder / "true.toml")
        rig.write(folder, scaled, _plant(case), {"run": _controller(case, compensation)})
        seconds, faults, changes = AT + SECONDS, [], []
        if not case.change:
            seconds = AT + TO_REST + REST + MEASURED
            changes = [Change("setpoint_gain", 0.0, AT)]
        else:
            faults = [Fault(f"{case.change} value={case.share:g}", AT)]
            if case.set_point in ("zero", "constant"):
                faults.append(Fault("push value=0.5 duration=0.05", AT))
        return simulate_loop(
            folder / "controller-run.toml", folder / "plant.toml", seconds, faults=faults, changes=changes
        )


def _plant(case: Case) -> rig.Tables:
    axis: dict[str, Any] = {"drive": {"delay_periods": case.delay - 1}, "motor": {"inertia": rig.MOTOR_INERTIA}}
    tables = rig.plant(VIRTUAL, "distributed", axis, case.load)
    if case.load == "limb":
        go = AT + LET_GO
        tables["axis"][0]["joint"] |= {
            "hand": [[0.0, 0.0, 1.0, 0.0], [go, 0.0, 1.0, 0.0], [go + 0.01, 0.0, 0.0, 0.0]],
            "hand_repeat": False,
        }
    return tables


def _controller(case: Case, compensation: float) -> rig.Tables:
    tables = rig.controller(VIRTUAL, "run", 1000.0, "true.toml", compensation)
    axis = tables["axis"][0]
    axis["law"]["fade_in"] = 0.5
    if compensation > 0.0:
        axis["law"]["delay"] = (case.delay + 1.0) * 1e-3  # transport, half a period of hold, the torque loop
    if case.set_point in ("zero", "constant"):
        axis["setpoint"] = {"kind": "constant", "offset": CONSTANT if case.set_point == "constant" else 0.0}
    elif case.set_point == "sine":
        axis["setpoint"] = {"kind": "sine", "amplitude": SINE, "frequency": 0.5}
    return tables


def play_healthy(load: str, seconds: float, compensation: float, seed: int) -> Simulation:
    """A slice with nothing wrong, gait or, on a load that it would throw about, a sine."""
    played = play_for(load) if load in ("weight", "free", "wearer") else gait()
    with tempfile.TemporaryDirectory(prefix="runaway-") as name:
        folder = Path(name)
        save_model(modelled(), folder / "true.toml")
        controller = rig.controller(VIRTUAL, "run", 1000.0, "true.toml", compensation)
        rig.write(folder, played, rig.plant(VIRTUAL, "distributed", None, load), {"run": controller})
        run, plant = folder / "controller-run.toml", folder / "plant.toml"
        return simulate_loop(run, plant, seconds, seed=seed)
