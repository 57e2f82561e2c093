"""What is found of a motor, an encoder or a tendon that is not as the model says; when, and what the joint got by then.

Usage: tools/run bench/checks [--loads held weight imposed limb] [--faults NAME ...] [--torque-sensor]
                              [--calibrated] [--results FILE] [--json]
The shipped actuator with true parameters and the estimator "stretch" in use, in virtual time, without a joint torque
sensor unless it is asked for; each fault begins at 1 s. "Told" is the first line after that, "off" the time from the
fault until the motor's torque is zero at the plant, once the axis has latched; "-" where that did not come within the
run, that is 3 s after the fault, or 6 s where it gets worse slowly. "Given" is the most work of any window that the
joint was given beyond what was wanted, from the fault until the torque is off, else until the end; until the first line
it is in the objects that --json prints. Without a fault it is what the law leaves.
Where k_t of (3.56) is not the file's the stretch is wrong from the first torque on, and the times count from there.
Where the lever p + d/2 is not, the pretension is wrong alone, once the bending changes: it does by a fifth from 1 s to
4 s, the angle is told, and the estimator is "map". With --calibrated the model file's [uncertainty] of stiffness and
bends is what `tsa calibrate --stretch` leaves of a rig with a joint torque sensor, in place of what a data sheet does:
the guard doubts less.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tests.virtual.joints import GAIT, play, sine
from tools import command
from tools.bench.results import Results, Row
from tools.campaign.passive.judge import windows
from tsa_ctrl.daemon.events import Event
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.virtual.result import AxisResult
from tsa_ctrl.virtual.script import Change

AT = 0.9995  # s, between two cycles: what is told in the next one is told after it
AT_ONCE, SLOWLY = 3.0, 6.0  # s that are looked at, of what is wrong at once and of what gets worse
LOADS = ("held", "weight", "imposed", "limb", "spring")


@dataclass(frozen=True)
class Wrong:
    """What is wrong: a fault of the plant at `AT`, or what is not as the file says from the enable on.

    `stiffness`, `lever`: of the plant, as shares of the file's; `straightens`: the sheath does, and its angle is told;
    `after`: s that are looked at.
    """

    fault: str = ""
    stiffness: float = 1.0
    lever: float = 1.0
    straightens: bool = False
    after: float = AT_ONCE

    @property
    def at(self) -> float:
        """s of the log from which times count; 0: from the first torque on."""
        return AT if self.stiffness == 1.0 else 0.0


FAULTS = {  # by what a person calls it
    "nothing": Wrong("clear"),
    "motor turns the wrong way": Wrong("reversed_sign"),
    "motor gives twice": Wrong("torque_gain value=2.0"),
    "joint encoder's sign turned": Wrong("encoder_slip value=-1.0"),
    "joint encoder's zero jumps by 0.1 rad": Wrong("encoder_jump value=0.1"),
    "joint encoder's zero jumps by 0.01 rad": Wrong("encoder_jump value=0.01"),
    "the encoders' zeros part by 0.02 rad/s": Wrong("encoder_drift value=0.02", after=SLOWLY),
    "tendon torn": Wrong("torn_tendon value=0"),
    "pulley loose (joint encoder follows half)": Wrong("encoder_slip value=0.5"),
    "tendons fray, all within 0.5 s": Wrong("fraying value=2.0"),
    "tendons fray, all within 2 s": Wrong("fraying value=0.5", after=SLOWLY),
    "tendons fray, half within 5 s": Wrong("fraying value=0.1", after=SLOWLY),
    "k_t half of the file's": Wrong(stiffness=0.5, after=SLOWLY),
    "k_t twice the file's": Wrong(stiffness=2.0, after=SLOWLY),
    "sheath straightens, lever of (3.56) right": Wrong(straightens=True, after=SLOWLY),
    "the same, lever twice the file's": Wrong(lever=2.0, straightens=True, after=SLOWLY),
    "the same, lever half of the file's": Wrong(lever=0.5, straightens=True, after=SLOWLY),
}
STRAIGHT = 0.8  # of the bending angle, at the end of
WITHIN = 3.0  # s
STAIRS = 60  # angles that are told by then
MODEL = "told.toml"
# 1, as bench/stretch prints of rigs: half an interval of the stiffness, and that of the centre of the bends (MODEL and
# COURSE_FOUND in identify/calibrate/stretch.py are their floors)
CALIBRATED = (0.006, 0.002)
TRIPPED = "tripped by the controller: "
NONE = 0.02  # N*m, that a drive reports of no torque


def trial(name: str, load: str, *, sensor: bool = False, calibrated: bool = False) -> Row:
    """One fault on one joint: what was told, and what the joint got, as `judged`."""
    wrong = FAULTS[name]
    axis: dict[str, Any] = {"model": MODEL, "estimator": {"kind": "stretch", "use": True}}
    plant: dict[str, Any] = {"perturbation": {"axial_stiffness": wrong.stiffness}}
    if not sensor:
        axis["torque_sensor"] = None
        plant["torque_sensor"] = {"present": False}
    changes: tuple[Change, ...] = ()
    if wrong.straightens:
        axis |= {"estimator": {"kind": "map", "use": True}, "bending": {"source": "command"}}
        plant["environment"] = {"bending": [[0.0, 1.0], [AT, 1.0], [AT + WITHIN, STRAIGHT]]}
        changes = tuple(
            Change("bending_angle", NOMINAL.bending_angle * (1.0 + (STRAIGHT - 1.0) * share), AT + WITHIN * share)
            for share in np.linspace(0.0, 1.0, STAIRS + 1)[1:].tolist()
        )
    with tempfile.TemporaryDirectory(prefix="bench-checks-") as folder:
        save_model(file_of(wrong, calibrated), Path(folder) / MODEL)
        result = play(
            Path(folder),
            load,
            GAIT if load == "imposed" else sine(0.6, 0.5),
            AT + wrong.after,
            axis=axis,
            plant=plant,
            changes=changes,
            faults=[f"{wrong.fault}@{AT}"] if wrong.fault else [],
        )
    row: Row = {"fault": name, "load": load, "sensor": sensor, "calibrated": calibrated}
    return {**row, **judged(result.axes[0], result.summary.events, wrong.at)}


def file_of(wrong: Wrong, calibrated: bool) -> TendonSheath:
    """The controller's model: the truth, but for what is wrong with the path that a bending angle takes."""
    model = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})
    if calibrated:
        stiffness, centre = CALIBRATED
        model = dataclasses.replace(model, axial_stiffness_uncertainty=stiffness, bending_centre_uncertainty=centre)
    return dataclasses.replace(model, contact_offset=model.lever / wrong.lever - model.diameter / 2.0)


def judged(axis: AxisResult, events: Sequence[Event], at: float) -> dict[str, Any]:
    """`told`, `off`: s from `at` s of the log on, or from the first torque; `words` of what was told; `given`: mJ."""
    begin = max(at, float(axis.log["t"][np.flatnonzero(axis.log["limit_reason"] != Reason.DISABLED.value)[0]]))
    said = [event for event in events if begin < event.t < axis.until and event.text]
    fault = next((event for event in said if event.fault), None)
    clock = axis.truth["clock"] - axis.start
    off = None
    if fault is not None:
        ended = np.flatnonzero((clock >= fault.t) & (np.abs(axis.truth["tau_m"]) <= NONE))
        off = float(clock[ended[0]]) if ended.size else None
    end = axis.until if off is None else off
    wanted = np.interp(clock, axis.log["t"], axis.log["tau_j_des"])
    work = (axis.truth["tau_j"] - wanted) * axis.truth["omega_j"] * np.diff(clock, prepend=clock[0])

    def given(until: float) -> float:
        return 1e3 * float(windows(work[(clock >= begin) & (clock < until)]).max(initial=0.0))

    return {
        "told": said[0].t - begin if said else None,
        "words": (fault or said[0]).text if said else "",
        "off": None if off is None else off - begin,
        "given": given(end),
        "given_until_told": given(said[0].t if said else end),
    }


def cell(row: dict[str, Any]) -> str:
    """Told and off, s; given, mJ."""
    times = " / ".join("-" if row[key] is None else f"{row[key]:.2f}" for key in ("told", "off"))
    return f"{times}; {row['given']:.0f}"


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=LOADS[:4])
    parser.add_argument("--faults", nargs="+", choices=tuple(FAULTS), default=tuple(FAULTS))
    parser.add_argument("--torque-sensor", action="store_true", help="with a joint torque sensor")
    parser.add_argument("--calibrated", action="store_true", help="stiffness and bends as a calibration knows them")
    parser.add_argument("--results", type=Path, help="a JSON object per trial; those that it holds are not run again")
    parser.add_argument("--json", action="store_true", help="a JSON object a line, instead of a table")
    arguments = parser.parse_args()
    known = Results(
        arguments.results, lambda row: tuple(row[name] for name in ("fault", "load", "sensor", "calibrated"))
    )
    table = Table("told / off (s); given (mJ)", *arguments.loads, "words of the first")
    for name in arguments.faults:
        rows = []
        for load in arguments.loads:
            key = (name, load, arguments.torque_sensor, arguments.calibrated)
            if key not in known:
                known.add(trial(name, load, sensor=arguments.torque_sensor, calibrated=arguments.calibrated))
            rows.append(known[key])
            if arguments.json:
                print(json.dumps(rows[-1]), flush=True)
        words = next((row["words"] for row in rows if row["words"]), "nothing")
        table.add_row(name, *map(cell, rows), words.removeprefix(TRIPPED).split(":")[0])
    if not arguments.json:
        Console(width=250).print(table)
    return 0
