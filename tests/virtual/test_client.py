"""Run the manual's controller verbatim on a limb in a hand, in virtual time, and evaluate the torque on the hand."""

from __future__ import annotations

import math
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import tsa_ctrl
from tests.conftest import ROOT
from tests.virtual.files import controller, plant, write
from tests.virtual.serving import ServedRun
from tsa_ctrl.ipc.client import Client

PAGE = ROOT / "tsa_ctrl" / "ipc" / "README.md"
GRIP = (60.0, 3.0)  # N*m/rad, N*m*s/rad; a hand that the device cannot move
HAND = [
    (0.0, *GRIP, 0.2),
    (1.0, *GRIP, 0.2),
    (2.0, *GRIP, 0.45),
    (3.2, *GRIP, -0.05),
    (4.0, *GRIP, 0.2),
]  # s, ., ., rad
SETTLED = 1.0  # s, end of the fade-in
HALF_LOOP = 2.0 * 45.0 * 0.025 * math.sinh(0.26)  # N*m at the joint, uncompensated friction


def block(language: str) -> str:
    """Return the only block of the page in this language."""
    found = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(found) == 1
    return str(found[0])


@pytest.mark.slow
def test_a_hand_feels_the_stiffness_that_the_manuals_controller_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hand moves the limb by 0.25 rad in both directions. The slope of torque over angle is the stated stiffness."""
    text = block("python")
    assert "STIFFNESS, DAMPING, REST = 4.0, 0.3, 0.2" in text
    setpoint = {"kind": "socket", "timeout": 0.2}
    files = write(
        tmp_path,
        controller(setpoint=setpoint, file={"socket": {"path": str(tmp_path / "tsa.sock")}}),
        plant(joint={"load": "limb", "initial_angle": 0.2, "hand": HAND, "hand_repeat": False}),
    )
    run = ServedRun(*files, seconds=4.0)
    client = partial(Client, run.path, clock=run.clock, sleep=run.sleep)
    monkeypatch.setattr(tsa_ctrl, "Client", client, raising=False)
    run.control(0.0, lambda: exec(text, {}))
    try:
        result = run.simulate()
    finally:
        run.close()
    axis = result.axes[0]
    assert axis.faults == ()
    log, counted = axis.log, axis.counted & (axis.log["t"] > SETTLED)
    q, omega, tau = log["q_j"][counted], log["omega_j"][counted], axis.delivered[counted]
    columns = np.column_stack([q - 0.2, omega, np.ones_like(q)])
    (slope, drag, offset), *_ = np.linalg.lstsq(columns, tau, rcond=None)
    assert np.ptp(q) > 0.4
    assert slope == pytest.approx(-4.0, rel=0.05)
    assert abs(offset) < 0.05 * 4.0 * np.ptp(q)
    residual = tau - columns @ (slope, drag, offset)
    assert np.sqrt(np.mean(residual**2)) < 0.1 * HALF_LOOP
