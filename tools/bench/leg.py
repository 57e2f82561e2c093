"""Compare a leg whose joints bend each other's sheaths with its goals in virtual time.

Usage: tools/run bench/leg [--only PART ...] [--json]

The hip bends the knee's sheath (0.8 rad/rad, hip +-0.5 rad), with the demo's actuator at 500 Hz. The numbers are RMS
errors of the knee's joint torque after 2 s, in mN*m unless the row has another unit. The goal of the first rows is 1.3
times the error with a resting hip, or that error plus 6 mN*m, whichever is larger. A runaway is measured by the highest
speed of a free knee in the last second at set-point 0. The knee is pushed four seconds before the end, while the hip
swings at 1 Hz and the file has twice the true gain. --only selects parts.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tomlkit

from tests.virtual import joints, knees, legs
from tools import command
from tools.command import SENSORS, Row
from tsa_ctrl import simulate_loop
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import load_tendon_sheath, save_model
from tsa_ctrl.model.routing import Route, Routing
from tsa_ctrl.virtual.result import Simulation

HIP = (0.1, 0.4, 1.0)  # Hz
ROUTED = {"alike": (0.8, 0.8), "differently": (1.2, 0.4)}  # rad/rad of tendons a and b
LOST = 3.1  # s, time at which the hip's encoder fails
RUNAWAY = 6.0  # s
NUDGE = "push axis=joint value=1.0 duration=0.2@2.0"  # N*m, enough to overcome the friction of a resting joint


def with_gain(folder: Path, gain: float) -> None:
    """Set the gain in the model file of the controller, rad/rad."""
    path = folder / "followed.toml"
    route = Route({"hip": gain}, {})
    save_model(dataclasses.replace(load_tendon_sheath(path), routing=Routing(route, route)), path)


def with_sensors(controller: Path, sensors: str) -> None:
    """Remove the sensors that a configuration of `SENSORS` does not have."""
    tables = tomlkit.parse(controller.read_text(encoding="utf-8")).unwrap()
    for axis in tables["axis"]:
        if sensors != "sensor":
            axis.pop("torque_sensor", None)
        if sensors == "motor":
            axis.pop("encoder", None)
    controller.write_text(tomlkit.dumps(tables), encoding="utf-8")


def error(result: Simulation) -> float:
    """Return the RMS error after 2 s, mN*m, or nan after a fault."""
    found = joints.error(result, 2.0)
    return joints.rms(found) if found.size and not result.axes[0].faults else float("nan")


def tracking(folder: Path, load: str) -> Iterator[Row]:
    """Yield the errors with true gains and with gains that are wrong by 20 %."""
    resting = error(simulate_loop(*knees.files(folder, load, 0.0), knees.SECONDS))
    goal = max(1.3 * resting, resting + 6.0)
    for name, gains in ROUTED.items():
        for frequency in HIP:
            paths = knees.files(folder, load, frequency)
            knees.apart(folder, *gains)
            found = error(simulate_loop(*paths, knees.SECONDS))
            yield {"what": f"{load}, tendons routed {name}, hip {frequency:g} Hz", "goal": goal, "found": found}
    for share in (0.8, 1.2):
        paths = knees.files(folder, load, 0.4)
        with_gain(folder, share * knees.GAIN)
        found = error(simulate_loop(*paths, knees.SECONDS))
        yield {"what": f"{load}, gain {share:g} of the plant's, hip 0.4 Hz", "goal": 60.0, "found": found}


def losses(folder: Path) -> Iterator[Row]:
    """Yield the torque step after an encoder of the hip fails, and the error without an encoder of the hip."""
    gearing = NOMINAL.joint_pulley_radius / NOMINAL.motor_pulley_radius
    for load in ("imposed", "weight"):
        paths = knees.files(folder, load, 0.4, travel=True)
        log = simulate_loop(*paths, 3.6, faults=[f"missing_tpdo axis=hip node=encoder@{LOST}"]).axes[0].log
        after = (log["t"][1:] > LOST) & (log["t"][1:] < LOST + 0.2) & (np.diff(log["sigma"]) == 0.0)
        step = 1e3 * gearing * float(np.abs(np.diff(log["tau_m_cmd"]))[after].max())
        yield {"what": f"{load}, hip's encoder dies: largest step of a cycle", "goal": 50.0, "found": step}
        span = {"unmeasured": {"hip": [-knees.SWING, knees.SWING]}}
        found = error(simulate_loop(*knees.files(folder, load, 0.4, bending=span), knees.SECONDS))
        yield {"what": f"{load}, no angle of the hip (error that the start prints)", "goal": 544.0, "found": found}


def runaway(folder: Path) -> Iterator[Row]:
    """Yield the speed of a free knee at set-point 0, in three sensor configurations."""
    for sensors in SENSORS:
        paths = knees.files(folder, "free", 1.0)
        with_gain(folder, 2.0 * knees.GAIN)
        tables = tomlkit.parse(paths[0].read_text(encoding="utf-8")).unwrap()
        tables["axis"][0]["setpoint"] = {"kind": "constant"}
        paths[0].write_text(tomlkit.dumps(tables), encoding="utf-8")
        with_sensors(paths[0], sensors)
        log = simulate_loop(*paths, RUNAWAY, faults=[NUDGE]).axes[0].log
        speed = float(np.abs(log["omega_j"][log["t"] > RUNAWAY - 1.0]).max())
        yield {"what": f"free, {sensors}, gain twice the plant's: speed, mrad/s", "goal": 100.0, "found": 1e3 * speed}


def walking(folder: Path) -> Iterator[Row]:
    """Yield the error of each joint of a walking leg in MuJoCo, in % of the error without compensation."""
    for rate in (legs.ONE_BUS, 1000.0):
        without, found = (legs.errors(legs.walk(folder, 5.5, rate, share), 2.0) for share in (0.0, 1.0))
        for name, most in without.items():
            left = 100.0 * found[name] / most
            yield {"what": f"walking leg, {name}, {rate:g} Hz: error left, %", "goal": 5.0, "found": left}


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--only", choices=("imposed", "weight", "losses", "runaway", "walking"), nargs="*")
    command.share(parser, "json")
    chosen = parser.parse_args()
    parts = {
        "imposed": lambda folder: tracking(folder, "imposed"),
        "weight": lambda folder: tracking(folder, "weight"),
        "losses": losses,
        "runaway": runaway,
        "walking": walking,
    }
    rows = []
    for name, part in parts.items():
        if chosen.only and name not in chosen.only:
            continue
        with tempfile.TemporaryDirectory(prefix="tsa-leg-") as folder:
            for row in part(Path(folder)):
                rows.append(row)
                if chosen.json:
                    print(json.dumps(row), flush=True)
    if not chosen.json:
        command.print_goals(rows)
    return 0
