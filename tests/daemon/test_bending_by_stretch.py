"""A sheath that is bent 40 % more during a run, followed with a joint torque sensor and by the stretch alone."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomlkit

from tests.daemon.test_bending_change import JUDGED, SECONDS, write
from tests.tune import rig as busy
from tsa_ctrl.virtual.result import AxisResult
from tsa_ctrl.virtual.simulation import simulate_loop

TIMES = 1.5  # what the torque sensor's estimator reaches


def error(axis: AxisResult, begin: float, end: float) -> float:
    """RMS of the delivered joint torque less the one wanted, N*m, between two times since the enable."""
    t = axis.log["t"] - axis.log["t"][np.flatnonzero(axis.log["tau_m_cmd"])[0]]
    part = axis.counted & (t >= begin) & (t <= end)
    return float(np.sqrt(np.mean(np.square((axis.delivered - axis.log["tau_j_des"])[part]))))


@pytest.mark.slow
@pytest.mark.soak  # the same limit on another rig: tests/control/test_stretch_estimator.py
def test_without_a_torque_sensor_the_change_is_followed_as_well(tmp_path: Path) -> None:
    """The plant's truth judges both; the one without a sensor has no joint torque to read."""
    write(tmp_path)
    path = tmp_path / busy.CONTROLLER
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    by_stretch = tables["axis"][0]
    del by_stretch["torque_sensor"]
    by_stretch["estimator"] = {"kind": "stretch", "use": True}
    by_stretch["law"]["motor_inertia"] = 2e-5
    path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    stretched, sensed = simulate_loop(path, tmp_path / "plant.toml", SECONDS, out=tmp_path).axes
    assert not stretched.faults
    end = SECONDS - 0.5
    found, reached = (error(axis, JUDGED, end) for axis in (stretched, sensed))
    assert found <= TIMES * reached
