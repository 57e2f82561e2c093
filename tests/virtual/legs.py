"""Simulate a walking leg with hip, knee and ankle in one controller, moved by a wearer.

The wearer's muscles are springs and dampers that follow the angles of a gait (script of a hand). They are strong enough
to lift the foot and to put it down. The set-points are additional torques. The hip bends the knee's sheath, and the
knee bends the ankle's sheath.
"""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from tests.virtual import joints
from tests.virtual.files import Tables
from tsa_ctrl import simulate_loop
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.model.routing import Route, Routing
from tsa_ctrl.virtual.result import Simulation

PERIOD = 1.6  # s, of a stride
GAIN = 0.8  # rad/rad
# Share of the stride and angle in rad: heel strike at 0, toe-off at 0.54.
ANGLES = {
    "hip": [(0.0, 0.3), (0.5, -0.2), (0.88, 0.35), (1.0, 0.3)],
    "knee": [(0.0, 0.08), (0.45, 0.08), (0.64, 1.2), (0.72, 1.15), (1.0, 0.08)],
    "ankle": [(0.0, 0.0), (0.45, 0.1), (0.55, -0.1), (0.68, 0.4), (0.85, 0.3), (1.0, 0.0)],
}
MUSCLES = {"hip": (30.0, 2.5), "knee": (20.0, 1.5), "ankle": (15.0, 0.8)}  # N*m/rad, N*m*s/rad
TORQUES = {"hip": (0.1, 0.8, 0.0), "knee": (0.0, 0.6, 0.3), "ankle": (-0.1, 0.4, 1.0)}  # N*m mean, N*m amplitude, rad
CROSSED = {"knee": "hip", "ankle": "knee"}


ONE_BUS = 400.0  # Hz, highest rate of three axes with encoders and torque sensors on one bus
BUSES = ("thigh", "shank")


def files(folder: Path, rate: float, compensation: float = 1.0) -> tuple[Path, Path]:
    """Write the controller and plant files. The controller's models contain the routing gains.

    Above ONE_BUS, the hip has a bus of its own, and the drives use few PDOs ("lean").
    """
    paths = joints.files(folder, "imposed", {"kind": "constant"}, compensation=compensation)
    controller, plant = (tomlkit.parse(path.read_text(encoding="utf-8")).unwrap() for path in paths)
    (axis,), (machine,) = controller["axis"], plant["axis"]
    controller["controller"]["rate"] = rate
    controller["axis"] = [_axis(axis, name, rate, place) for place, name in enumerate(ANGLES)]
    plant["mechanism"] = {"kind": "mujoco"}
    plant["axis"] = [_machine(folder, machine, name) for name in ANGLES]
    if rate > ONE_BUS:
        for tables in (controller, plant):
            tables["bus"] = [{**tables.get("bus", {}), "name": name, "channel": name} for name in BUSES]
            for each, place in zip(tables["axis"], (0, 1, 1), strict=True):
                each["bus"] = BUSES[place]
        for each in controller["axis"]:
            each["drive"]["pdo"] = "lean"
    for path, tables in zip(paths, (controller, plant), strict=True):
        path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    return paths


def _axis(axis: Tables, name: str, rate: float, place: int) -> Tables:
    mean, amplitude, phase = TORQUES[name]
    sine = {"amplitude": amplitude, "frequency": 1.0 / PERIOD, "phase": phase}
    setpoint = {"kind": "multi_sine", "offset": mean, "components": [sine]}
    made: dict[str, Any] = copy.deepcopy(dict(axis)) | {"name": name, "setpoint": setpoint}
    made["law"]["delay"] = 1.5 / rate + joints.LAG
    made["drive"] |= {"node_id": 1 + place, "serial_number": 1 + place}
    made["encoder"]["node_id"] = 32 + place
    made["torque_sensor"]["node_id"] = 64 + place
    if name in CROSSED:
        made["estimator"] = {"kind": "map"}
        angle = joints.NOMINAL.bending_angle
        made["bending"] = {"source": "joints", "offset": angle, "gains": {CROSSED[name]: GAIN}}
    return made


def _machine(folder: Path, machine: Tables, name: str) -> Tables:
    hand = [[share * PERIOD, *MUSCLES[name], angle] for share, angle in ANGLES[name]]
    made = {key: value for key, value in machine.items() if key != "motion"}
    made |= {"name": name, "joint": {"hand": hand}}
    if name in CROSSED:
        made["actuator"] = f"{name}.toml"
        route = Route({CROSSED[name]: GAIN}, {})
        save_model(dataclasses.replace(joints.NOMINAL, routing=Routing(route, route)), folder / f"{name}.toml")
    return made


def walk(folder: Path, seconds: float, rate: float, compensation: float = 1.0) -> Simulation:
    return simulate_loop(*files(folder, rate, compensation), seconds)


def errors(result: Simulation, after: float) -> dict[str, float]:
    """Return the RMS error of each joint's torque, mN*m, from `after` s of the log on until the stop."""
    found = {}
    for axis in result.axes:
        late = axis.log["t"][axis.counted] >= after
        found[axis.to_dict()["name"]] = float(1e3 * np.sqrt(np.mean(np.square(axis.error[late]))))
    return found
