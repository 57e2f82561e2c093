"""Drives of other makes with their own profiles have the right units of torque, torque clamp and velocity."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.virtual.files import controller, plant, write
from tsa_ctrl import simulate_loop

DRIVES = Path(__file__).resolve().parents[2] / "config" / "drives"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["epos4", "elmo_gold"])
def test_runs_a_drive_of_another_make(tmp_path: Path, kind: str) -> None:
    """The speed is the derivative of the angle. The reported torque is the command of the previous period."""
    shutil.copytree(DRIVES, tmp_path / "drives")
    tables = controller(drive={"profile": kind})
    log = simulate_loop(*write(tmp_path, tables, plant(drive={"kind": kind})), 2.0).log
    moving = (log["t"] > 0.7) & (log["t"] < 2.0)
    speed, command, torque = (log[name][moving] for name in ("omega_m", "tau_m_cmd", "tau_m"))
    difference = np.gradient(log["q_m"][moving], log["t"][moving])
    assert np.dot(difference, speed) / np.dot(difference, difference) == pytest.approx(1.0, abs=0.02)
    assert np.abs(command).max() > 0.2
    assert np.corrcoef(command[:-2], torque[2:])[0, 1] > 0.98
