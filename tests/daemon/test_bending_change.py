"""Test two joints on one bus whose wrap angle increases by 40 % during a run. One axis estimates the change."""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import tomlkit

from tests.tune import rig as busy
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.rig import VIRTUAL, gait
from tsa_ctrl.log.table import read_table
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.virtual.simulation import simulate_loop

RATE = 400.0  # Hz, loop rate of both axes
SECONDS = 9.0
BENDING = [[0.0, 1.0], [2.5, 1.0], [3.5, 1.4]]  # (s since the enable, factor of the wrap angle)
JUDGED = 6.5  # s since the enable; by then the estimate has converged
AXIAL_STIFFNESS = 20e3  # N; the longer path raises the pretension by a quarter


def write(folder: Path) -> None:
    """Write the files of two axes that are equal except for the estimator of the second."""
    busy.write(folder, VIRTUAL, RATE)
    save_model(dataclasses.replace(rig.NOMINAL, axial_stiffness=AXIAL_STIFFNESS), folder / "nominal.toml")
    exact = {"friction_coefficient": 1.0, "pretension": 1.0, "axial_stiffness": 1.0}
    changes = {"environment": {"bending": BENDING}, "perturbation": exact, "motor": {"inertia": 2e-5}}
    tables = rig.plant(VIRTUAL, "full", changes)
    tables["axis"].append({**copy.deepcopy(tables["axis"][0]), "name": "followed"})
    controller = tomlkit.parse((folder / busy.CONTROLLER).read_text()).unwrap()
    second = copy.deepcopy(controller["axis"][0])
    second.update(name="followed", estimator={"kind": "sensor", "use": True})
    for node, number in (("drive", 2), ("encoder", 33), ("torque_sensor", 65)):
        second[node]["node_id"] = number
    controller["axis"][0]["drive"]["serial_number"] = 1
    controller["axis"][0]["estimator"] = {"kind": "fixed"}
    second["drive"]["serial_number"] = 2
    controller["axis"].append(second)
    rig_files = ((folder / "plant.toml", tables), (folder / busy.CONTROLLER, controller))
    for path, data in rig_files:
        path.write_text(tomlkit.dumps(data))
    gait().write_motion(folder / "motion.csv")


def error(log: Path, axis: str, begin: float, end: float) -> float:
    """Return the RMS error of the joint torque (N*m) between two times since the enable."""
    columns = read_table(f"{log}:{axis}", ("t", "tau_j_des", "tau_m_cmd", "tau_j")).columns
    t = columns["t"] - columns["t"][np.flatnonzero(columns["tau_m_cmd"])[0]]
    part = (t >= begin) & (t <= end) & np.isfinite(columns["tau_j"])
    return float(np.sqrt(np.mean(np.square((columns["tau_j"] - columns["tau_j_des"])[part]))))


@pytest.mark.slow
def test_the_estimator_follows_and_the_torque_error_stays_small(tmp_path: Path) -> None:
    """The change more than doubles the torque error of the axis with fixed parameters.

    Afterwards the axis with the estimator has less than half of that error.
    """
    write(tmp_path)
    simulate_loop(tmp_path / busy.CONTROLLER, tmp_path / "plant.toml", SECONDS, out=tmp_path)
    log, end = tmp_path / "tsa.mcap", SECONDS - 0.5
    fixed, followed = (error(log, axis, JUDGED, end) for axis in ("joint", "followed"))
    assert error(log, "joint", 1.2, 2.5) < 0.5 * fixed
    assert followed < 0.5 * fixed
