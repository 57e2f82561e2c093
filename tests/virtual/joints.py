"""Run the shipped actuator with true parameters and any load in virtual time, and return the delivered torque.

The plant's tendons are distributed. The controller's model is true, including the curvature profile of the sheath. A
delay is the number of whole periods between a measurement and the resulting torque.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from tests.virtual.files import Tables, merged
from tsa_ctrl import simulate_loop
from tsa_ctrl.demo.rig import NOMINAL, gait
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change, Fault

PERIOD = 1e-3  # s
LAG = 0.5e-3  # s, of the drive's torque loop
GAIT: Tables = {"kind": "file", "file": "setpoint.csv", "loop": True}


def sine(amplitude: float, frequency: float) -> Tables:
    return {"kind": "sine", "amplitude": amplitude, "frequency": frequency}


CASES: dict[str, tuple[str, Tables, float]] = {  # load, set-point and time in s
    "gait": ("imposed", GAIT, 5.0),
    **{load: (load, sine(0.5, 0.5), 4.0) for load in ("held", "spring", "weight", "free", "limb")},
    "wearer": ("wearer", sine(0.5, 0.5), 8.0),
}


def files(
    folder: Path,
    load: str,
    setpoint: Mapping[str, Any],
    *,
    delay: int = 1,
    inertia: float = 1e-4,
    known: bool = True,
    compensation: float = 1.0,
    curvature: Any = "uniform",
    axis: Mapping[str, Any] | None = None,
    plant: Mapping[str, Any] | None = None,
) -> tuple[Path, Path]:
    """Write controller and plant.

    `inertia` is the motor's, and the controller has it if `known`. `axis` and `plant` change tables of the controller's
    and the plant's axis.
    """
    save_model(NOMINAL, folder / "nominal.toml")
    save_model(NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": curvature}}), folder / "true.toml")
    gait().write_setpoint(folder / "setpoint.csv")
    gait().write_motion(folder / "motion.csv")
    law: Tables = {"fade_in": 0.5, "compensation": compensation}
    if known:
        law |= {"motor_inertia": inertia, "delay": (delay + 0.5) * PERIOD + LAG}
    controller = {
        "controller": {"settle_cycles": 20},
        "axis": [
            merged(
                {
                    "name": "joint",
                    "model": "true.toml",
                    "drive": {"node_id": 1, "max_torque": 3.0},
                    "encoder": {"node_id": 32},
                    "torque_sensor": {"node_id": 64},
                    "setpoint": dict(setpoint),
                    "law": law,
                    "estimator": {"kind": "fixed"},
                    "limits": {"torque": 2.5, "rate": 400.0},
                },
                axis or {},
            )
        ],
    }
    machine = {
        "physics": {"start": "first_enable"},
        "axis": [
            merged(
                {
                    "name": "joint",
                    "actuator": "nominal.toml",
                    "tendon": {"kind": "distributed", "curvature": curvature},
                    "drive": {"delay_periods": delay - 1},
                    "motor": {"inertia": inertia},
                    "joint": {"load": load},
                    "motion": {"kind": "file", "file": "motion.csv"},
                },
                plant or {},
            )
        ],
    }
    paths = folder / "controller.toml", folder / "plant.toml"
    for path, tables in zip(paths, (controller, machine), strict=True):
        path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    return paths


def play(
    folder: Path,
    load: str,
    setpoint: Mapping[str, Any],
    seconds: float,
    *,
    changes: tuple[Change, ...] = (),
    faults: Sequence[Fault | str] = (),
    seed: int | None = None,
    **more: Any,
) -> Simulation:
    """Write the files and run them."""
    paths = files(folder, load, setpoint, **more)
    return simulate_loop(*paths, seconds, changes=changes, faults=faults, seed=seed)


def play_case(folder: Path, name: str, seconds: float | None = None, **more: Any) -> Simulation:
    """Run one of `CASES`, or its first `seconds`."""
    load, setpoint, whole = CASES[name]
    return play(folder, load, setpoint, seconds or whole, **more)


def error(result: Simulation, after: float = 1.0) -> NDArray[np.float64]:
    """Return the delivered minus the desired joint torque, mN*m, from `after` s of the log until the stop."""
    axis = result.axes[0]
    t = axis.log["t"][axis.counted]
    return 1e3 * axis.error[t >= after]


def rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
