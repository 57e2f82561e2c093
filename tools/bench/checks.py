"""Measure the detection time of faults of motor, encoder and tendon, and the energy that the joint receives until then.

Usage: tools/run bench/checks [--loads held weight imposed limb] [--faults NAME ...] [--sensors motor encoder sensor]
                              [--set-points sine constant] [--calibrated] [--sample N] [--rows FILE]

The shipped actuator runs with true parameters in virtual time. With two encoders the estimator is "stretch". Sensors:
"motor" has no joint encoder and no joint torque sensor, "encoder" has the joint encoder, and "sensor" has both. A
prescribed motion has the gait as set-point instead of the sine. Each fault starts at 1 s. A run ends 1.2 s after an
axis has latched, 3 s after the fault, or 6 s after a fault that develops slowly. The table has these values:

  told    time of the first report after the fault
  off     time from the fault until the plant's motor torque is zero, once the axis has latched; "-" if it did not
  given   the largest work on the joint in any window, less the work of the set-point, from the fault until the torque
          is off or the run ends

--json also prints the work until the first report.

If k_t of (3.56) differs from the file, the elongation is wrong from the first torque, and the times start there. If the
lever p + d/2 differs, only the pretension is wrong, after the wrap angle has changed by a fifth between 1 s and 4 s. In
this case the angle is commanded, and the estimator is "map". The model file has the [uncertainty] of stiffness and
bends from a data sheet, or with --calibrated from `tsa calibrate --stretch` on a rig with a joint torque sensor.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from tools import command
from tools.campaign.passive.experiment import Experiment
from tools.campaign.passive.judge import Ended, peak_speed, reactions, windows
from tools.command import Row
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.virtual.result import AxisResult
from tsa_ctrl.virtual.script import Change, parse_fault_option

AT = 0.9995  # s, between two cycles, so that the report of the next cycle is after the fault
AT_ONCE, SLOWLY = 3.0, 6.0  # s that are evaluated after a sudden fault, and after a fault that develops slowly
LOADS = ("held", "weight", "imposed", "limb", "spring")


@dataclass(frozen=True)
class Wrong:
    """A fault of the plant at `AT`, or a difference between plant and file that exists from the enable.

    `stiffness` and `lever` are ratios of the plant's value to the file's value. With `straightens` the sheath
    straightens and the angle is commanded. `after` is the evaluated time in s.
    """

    fault: str = ""
    stiffness: float = 1.0
    lever: float = 1.0
    straightens: bool = False
    after: float = AT_ONCE

    @property
    def at(self) -> float:
        """Return the time of the fault in the log, s, or 0 for an error that acts from the first torque."""
        return AT if self.stiffness == 1.0 else 0.0

    def possible(self, sensors: str) -> bool:
        """Return False for a fault of a joint encoder that the sensor configuration does not have."""
        return sensors != "motor" or not self.fault.startswith("encoder")


FAULTS = {  # by name in the table
    "nothing": Wrong("clear"),
    "motor turns the wrong way": Wrong("reversed_sign"),
    "motor delivers twice the torque": Wrong("torque_gain value=2.0"),
    "joint encoder's sign reversed": Wrong("encoder_slip value=-1.0"),
    "joint encoder's zero jumps by 0.1 rad": Wrong("encoder_jump value=0.1"),
    "joint encoder's zero jumps by 0.01 rad": Wrong("encoder_jump value=0.01"),
    "encoder zeros drift apart by 0.02 rad/s": Wrong("encoder_drift value=0.02", after=SLOWLY),
    "tendon torn": Wrong("torn_tendon value=0"),
    "pulley loose (joint encoder follows half)": Wrong("encoder_slip value=0.5"),
    "tendons fray, all within 0.5 s": Wrong("fraying value=2.0"),
    "tendons fray, all within 2 s": Wrong("fraying value=0.5", after=SLOWLY),
    "tendons fray, half within 5 s": Wrong("fraying value=0.1", after=SLOWLY),
    "k_t half of the file's value": Wrong(stiffness=0.5, after=SLOWLY),
    "k_t twice the file's value": Wrong(stiffness=2.0, after=SLOWLY),
    "sheath straightens, lever of (3.56) correct": Wrong(straightens=True, after=SLOWLY),
    "the same, lever twice the file's value": Wrong(lever=2.0, straightens=True, after=SLOWLY),
    "the same, lever half of the file's value": Wrong(lever=0.5, straightens=True, after=SLOWLY),
}
STRAIGHT = 0.8  # final share of the bending angle
WITHIN = 3.0  # s, duration of the straightening
STAIRS = 60  # steps in which the angle is commanded
KEY = ("fault", "load", "sensors", "set_point", "calibrated")
# Half widths of the intervals of the stiffness and of the centre of the bends, 1, as bench/stretch prints them. Their
# minima are MODEL and COURSE_FOUND in identify/calibrate/stretch.py.
CALIBRATED = (0.006, 0.002)
NONE = 0.02  # N*m; a smaller motor torque counts as zero


def combinations(
    faults: Iterable[str], loads: Iterable[str], sensors: Iterable[str], set_points: Iterable[str]
) -> list[tuple[str, str, str, str]]:
    """Return all combinations of fault, load, sensors and set-point for which the fault is possible."""
    every = itertools.product(faults, loads, sensors, set_points)
    return [each for each in every if FAULTS[each[0]].possible(each[2])]


def trial(name: str, load: str, sensors: str = "encoder", set_point: str = "sine", calibrated: bool = False) -> Row:
    """Run one fault with one load, and return the row with the result of `judged`."""
    wrong = FAULTS[name]
    axis: dict[str, Any] = {} if sensors == "motor" else {"estimator": {"kind": "stretch", "use": True}}
    plant: dict[str, Any] = {"perturbation": {"axial_stiffness": wrong.stiffness}}
    changes: tuple[Change, ...] = ()
    if wrong.straightens:
        axis |= {"estimator": {"kind": "map", "use": True}, "bending": {"source": "command"}}
        plant["environment"] = {"bending": [[0.0, 1.0], [AT, 1.0], [AT + WITHIN, STRAIGHT]]}
        changes = tuple(
            Change("bending_angle", NOMINAL.bending_angle * (1.0 + (STRAIGHT - 1.0) * share), AT + WITHIN * share)
            for share in np.linspace(0.0, 1.0, STAIRS + 1)[1:].tolist()
        )
    rig = Experiment(
        load,
        "gait" if load == "imposed" and set_point == "sine" else set_point,
        sensors,
        compensation=1.0,
        file_model=file_of(wrong, calibrated),
        axis=axis,
        file={"controller": {"after_fault": "wait"}},
        plant={**plant, "perturbation": {"friction_coefficient": 1.0, "pretension": 1.0, **plant["perturbation"]}},
    )
    faults = [parse_fault_option(f"{wrong.fault}@{AT}")] if wrong.fault else []
    result = rig.play(AT + wrong.after, faults, changes, Ended(AT, False))
    row: Row = {"fault": name, "load": load, "sensors": sensors, "set_point": set_point, "calibrated": calibrated}
    row |= {"latched": reactions(result.summary.events, AT)["latched"], "peak": peak_speed(result, AT)}
    return {**row, **judged(result.axes[0], result.summary.events, wrong.at)}


def file_of(wrong: Wrong, calibrated: bool) -> TendonSheath:
    """Return the controller's model: the true model with the lever error of the fault and the file's uncertainty."""
    model = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})
    if calibrated:
        stiffness, centre = CALIBRATED
        model = dataclasses.replace(model, axial_stiffness_uncertainty=stiffness, bending_centre_uncertainty=centre)
    return dataclasses.replace(model, contact_offset=model.lever / wrong.lever - model.diameter / 2.0)


def judged(axis: AxisResult, events: Sequence[Event], at: float) -> dict[str, Any]:
    """Return the times of report and torque-off, the text of the report, and the work on the joint.

    `told` and `off` are in s from `at` or from the first torque, whichever is later. `given` is in mJ.
    """
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
    """Format the times of report and torque-off (s) and the work (mJ)."""
    times = " / ".join("-" if row[key] is None else f"{row[key]:.2f}" for key in ("told", "off"))
    return f"{times}; {row['given']:.0f}"


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=LOADS[:4])
    parser.add_argument("--faults", nargs="+", choices=tuple(FAULTS), default=tuple(FAULTS))
    parser.add_argument("--set-points", nargs="+", choices=("sine", "constant"), default=("sine", "constant"))
    parser.add_argument(
        "--calibrated", action="store_true", help="uncertainty of stiffness and bends after a calibration"
    )
    command.share(parser, "sensors sample seed rows processes json")
    arguments = parser.parse_args()
    every = combinations(arguments.faults, arguments.loads, arguments.sensors, arguments.set_points)
    wanted = command.drawn([(*each, arguments.calibrated) for each in every], arguments)
    rows = command.run_rows(_trial, wanted, lambda row: tuple(row[name] for name in KEY), arguments)

    def shown() -> list[Table | str]:
        return [*tables(rows, arguments), f"{len(rows)} trials; seed {arguments.seed}"]

    command.print_tables(rows, arguments, shown)
    return 0


def _trial(key: tuple[str, str, str, str, bool]) -> Row:
    return trial(*key)


def tables(rows: Sequence[Row], arguments: argparse.Namespace) -> list[Table]:
    """Return a table for each sensor configuration and set-point, with a row per fault and a column per load."""
    found = []
    for key, those in command.parts(rows, sensors=arguments.sensors, set_point=arguments.set_points):
        lines = []
        for (name,), mine in command.parts(those, fault=arguments.faults):
            by_load = {row["load"]: row for row in mine}
            words = next((row["words"] for row in mine if row["words"]), "nothing")
            cells = (cell(by_load[load]) if load in by_load else "" for load in arguments.loads)
            lines.append((name, *cells, words.split(":")[0]))
        heads = ("fault", *arguments.loads, "words of the first")
        found.append(command.table(heads, lines, f"{', '.join(key)}: told / off (s); given (mJ)"))
    return found
