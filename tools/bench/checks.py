"""What is found of a motor, an encoder or a tendon that is not as the model says, without a joint torque sensor; when.

Usage: tools/run bench/checks [--loads held spring weight imposed] [--faults NAME ...] [--calibrated]
                              [--results FILE] [--json]
The shipped actuator with true parameters and the estimator "stretch" in use, in virtual time; each fault begins at 1 s.
"Told" is the first line after that, "off" the time from the fault until the motor's torque is zero at the plant, once
the axis has latched; "-" where that did not come within the run, that is 6 s after the fault. With --calibrated the
model file's [uncertainty] of stiffness and bends is what `tsa calibrate --stretch` leaves of a rig with a joint torque
sensor, in place of what a data sheet does: the guard doubts less.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tests.virtual.joints import GAIT, play, sine
from tools import command
from tools.bench.results import Results, Row
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import save_model

AT = 1.0  # s
AFTER = 6.0  # s
LOADS = ("held", "spring", "weight", "imposed")
FAULTS = {  # by what a person calls it: the plant's fault
    "motor turns the wrong way": "reversed_sign",
    "motor gives twice": "torque_gain value=2.0",
    "joint encoder's sign turned": "encoder_slip value=-1.0",
    "tendon torn": "torn_tendon value=0",
    "pulley loose (joint encoder follows half)": "encoder_slip value=0.5",
    "tendons fray, all within 0.5 s": "fraying value=2.0",
    "tendons fray, all within 2 s": "fraying value=0.5",
    "tendons fray, half within 5 s": "fraying value=0.1",
}
MODEL = "told.toml"
# 1, as bench/stretch prints of rigs: half an interval of the stiffness, and that of the centre of the bends (MODEL and
# COURSE_FOUND in identify/calibrate/stretch.py are their floors)
CALIBRATED = (0.006, 0.002)
TRIPPED = "tripped by the controller: "
NONE = 0.02  # N*m, that a drive reports of no torque


def trial(name: str, load: str, calibrated: bool) -> Row:
    """One fault on one joint: seconds from the fault until something was told, and until the torque ended."""
    with tempfile.TemporaryDirectory(prefix="bench-checks-") as folder:
        model = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})
        if calibrated:
            stiffness, centre = CALIBRATED
            model = dataclasses.replace(model, axial_stiffness_uncertainty=stiffness, bending_centre_uncertainty=centre)
        save_model(model, Path(folder) / MODEL)
        result = play(
            Path(folder),
            load,
            GAIT if load == "imposed" else sine(0.6, 0.5),
            AT + AFTER,
            axis={"model": MODEL, "torque_sensor": None, "estimator": {"kind": "stretch", "use": True}},
            plant={"torque_sensor": {"present": False}},
            faults=[f"{FAULTS[name]}@{AT}"],
        )
    axis = result.axes[0]
    told = [event for event in result.summary.events if AT < event.t < axis.until and event.text]
    clock = axis.truth["clock"] - axis.start
    fault = next((event for event in told if event.fault), None)
    off = None
    if fault is not None:
        ended = np.flatnonzero((clock >= fault.t) & (np.abs(axis.truth["tau_m"]) <= NONE))
        off = float(clock[ended[0]]) - AT if ended.size else None
    return {
        "fault": name,
        "load": load,
        "told": told[0].t - AT if told else None,
        "words": (fault or told[0]).text if told else "",
        "off": off,
    }


def cell(row: dict[str, Any]) -> str:
    """Told and off, s."""
    return " / ".join("-" if row[key] is None else f"{row[key]:.2f}" for key in ("told", "off"))


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=LOADS)
    parser.add_argument("--faults", nargs="+", choices=tuple(FAULTS), default=tuple(FAULTS))
    parser.add_argument("--calibrated", action="store_true", help="stiffness and bends as a calibration knows them")
    parser.add_argument("--results", type=Path, help="a JSON object per trial; those that it holds are not run again")
    parser.add_argument("--json", action="store_true", help="a JSON object a line, instead of a table")
    arguments = parser.parse_args()
    known = Results(arguments.results, lambda row: (row["fault"], row["load"]))
    table = Table("told / off (s)", *arguments.loads, "words of the first")
    for name in arguments.faults:
        rows = []
        for load in arguments.loads:
            if (name, load) not in known:
                known.add(trial(name, load, arguments.calibrated))
            rows.append(known[name, load])
            if arguments.json:
                print(json.dumps(rows[-1]), flush=True)
        words = next((row["words"] for row in rows if row["words"]), "nothing")
        table.add_row(name, *map(cell, rows), words.removeprefix(TRIPPED).split(":")[0])
    if not arguments.json:
        Console(width=250).print(table)
    return 0
