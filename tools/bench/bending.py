"""A sheath that is bent more during a run: followed by the stretch alone, and by a joint torque sensor.

Usage: tools/run bench/bending [--rigs 10] [--first 0] [--seed 1] [--change 0.4] [--results FILE] [--json]
Rigs drawn at random bend anywhere up to s_c = 0.7, evenly or in two bends, on the distributed plant in virtual time; a
gait is imposed, the file is the rig's before the change, stiffness and bends as well known as a calibration leaves
them. Within 1.5 s of a run the sheath is bent 40 % more, and its path gets longer by (3.50), so that the pretension
rises by a quarter: the tensioner gives. Errors are those of the delivered joint torque in mN*m RMS, over two steps
before the change and over the last two of the 10 s from its beginning, once with the estimator "stretch" and no joint
torque sensor, once with "sensor". The last column is the one over the other. With --results each rig is kept in a file
as it ends; those that it holds are not run again.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from tests.virtual.joints import GAIT, play, rms
from tests.virtual.rigs import draw
from tools import command
from tools.bench.checks import CALIBRATED
from tools.bench.stretch import shape
from tools.command import Row
from tsa_ctrl.demo.motion import PERIOD
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.virtual.result import AxisResult

BEGIN = 0.6 + 2 * PERIOD  # s of the log: torque has faded in, and two steps are over
WITHIN = 1.5  # s
FOLLOWED = BEGIN + 10.0 - 2 * PERIOD  # s: two steps later 10 s are over
SECONDS = BEGIN + 10.0
TIGHTER = 0.25  # of the pretension
MODEL, PLANT = "rig.toml", "plant-rig.toml"
WAYS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {  # of the axis, of the plant
    "sensor": ({"estimator": {"kind": "sensor", "use": True}}, {}),
    "stretch": (
        {"estimator": {"kind": "stretch", "use": True}, "torque_sensor": None},
        {"torque_sensor": {"present": False}},
    ),
}


def error(axis: AxisResult, begin: float) -> float:
    """RMS of delivered less wanted joint torque over two steps from `begin` s on, mN*m; nan where the torque ended."""
    t = axis.log["t"][axis.counted]
    part = (t >= begin) & (t < begin + 2 * PERIOD)
    whole = np.count_nonzero(part) >= 0.99 * np.count_nonzero(axis.log["t"] < 2 * PERIOD)
    return 1e3 * rms(axis.error[part]) if whole else float("nan")


def tensioned(model: TendonSheath, change: float) -> TendonSheath:
    """The same, its path so much longer when it is bent by `change` more that the pretension rises by `TIGHTER`."""
    lever = TIGHTER * model.pretension / (model.tendon_stiffness * change * model.bending_angle)
    return dataclasses.replace(model, contact_offset=0.0, diameter=2.0 * lever)


def trial(seed: int, number: int, change: float) -> Row:
    """One rig, followed both ways: `sensor` and `stretch` and what they were before the change, mN*m."""
    rig, bends = draw(seed, number), shape(seed, number)
    stiffness, centre = CALIBRATED
    truth = tensioned(rig.truth, change)
    told = dataclasses.replace(
        truth.with_effects({"elongation_coupling": {"curvature_profile": bends.points}}),
        axial_stiffness_uncertainty=stiffness,
        bending_centre_uncertainty=centre,
    )
    row: Row = {"seed": seed, "rig": number, "change": change, "centre": bends.centre, "faults": []}
    for name, (axis, plant) in WAYS.items():
        with tempfile.TemporaryDirectory(prefix="bench-bending-") as folder:
            save_model(truth, Path(folder) / PLANT)
            save_model(told, Path(folder) / MODEL)
            bending = [[0.0, 1.0], [BEGIN, 1.0], [BEGIN + WITHIN, 1.0 + change]]
            result = play(
                Path(folder),
                "imposed",
                GAIT,
                SECONDS,
                delay=rig.delay,
                inertia=rig.inertia,
                curvature=[list(point) for point in bends.points],
                axis={"model": MODEL, **axis},
                plant={"actuator": PLANT, "environment": {"bending": bending}, **plant},
            ).axes[0]
        row |= {name: error(result, FOLLOWED), f"{name}_before": error(result, BEGIN - 2 * PERIOD)}
        row["faults"] += [f"{name}: {fault}" for fault in result.faults]
    return row


def main() -> int:
    parser = command.parser(__name__, __doc__)
    command.share(parser, "rigs first seed rows processes json", seed=1)
    parser.add_argument("--change", type=float, default=0.4, help="of the bending angle, as a share")
    arguments = parser.parse_args()
    if arguments.rigs < 1:
        parser.error(f"--rigs {arguments.rigs}: at least 1")
    numbers = range(arguments.first, arguments.first + arguments.rigs)
    asked = [(arguments.seed, number, arguments.change) for number in numbers]
    rows = command.run_rows(_trial, asked, lambda row: (row["seed"], row["rig"], row["change"]), arguments)
    command.print_tables(rows, arguments, lambda: report(rows))
    return 0


def _trial(asked: tuple[int, int, float]) -> Row:
    return trial(*asked)


def report(rows: list[Row]) -> list[Table | str]:
    """Return the table, and what the rows ended in where they ended early."""
    table = Table("rig", "s_c", "before: sensor", "before: stretch", "after: sensor", "after: stretch", "times")
    names = ("sensor_before", "stretch_before", "sensor", "stretch")
    for row in rows:
        values = [row[name] for name in names]
        table.add_row(
            str(row["rig"]),
            f"{row['centre']:.2f}",
            *(f"{value:.1f}" for value in values),
            f"{values[3] / values[2]:.2f}",
        )
    found = np.array([[row[name] for name in names] for row in rows])
    times = found[:, 3] / found[:, 2]
    for words, taken in (("median", np.nanmedian), ("worst", np.nanmax)):
        table.add_row(words, "", *(f"{taken(column):.1f}" for column in found.T), f"{taken(times):.2f}")
    return [table, *(f"rig {row['rig']}: {fault}" for row in rows for fault in row["faults"])]
