"""Test the sign and gain check with a locked joint on logs of the simulated rig."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.virtual.joints import files, sine
from tsa_ctrl import simulate_loop
from tsa_ctrl.config import load_configuration
from tsa_ctrl.drills.held import SECONDS, amplitude, held_configuration, sign_and_gain
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.readiness import SignAndGain

SHORT = 7.0  # s of torque: one reversal more than in a single period


class Run:
    """A simulated run: its configuration and its log."""

    def __init__(self, folder: Path, plant: Mapping[str, Any] | None = None) -> None:
        paths = files(folder, "held", sine(0.5, 0.5), plant=plant, curvature="motor_end")
        self.configuration = held_configuration(load_configuration(paths[0]), str(folder))
        self.log = simulate_loop(self.configuration, paths[1], SHORT).axes[0].log

    def sign_and_gain(self, factor: float = 1.0, moved: float = 0.0) -> SignAndGain:
        """Return the result if the sensor shows `factor` times the torque and the joint creeps by `moved` (rad)."""
        angle = self.log["q_j"] + np.linspace(0.0, moved, len(self.log["q_j"]))
        log = {**self.log, "tau_j": factor * self.log["tau_j"], "q_j": angle}
        return sign_and_gain("joint", log, self.configuration.models[0])


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run(tmp_path_factory.mktemp("healthy"))


def test_a_healthy_rig_shows_its_sign_and_gain(healthy: Run) -> None:
    found = healthy.sign_and_gain()
    assert found.sensor == "joint torque sensor"
    assert found.gain == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (0.8, r"shows 0\.8\d? times the torque of the model, allowed are 0\.9 to 1\.1"),
        (1.2, r"shows 1\.2\d? times the torque of the model, allowed are 0\.9 to 1\.1"),
        (-1.0, "shows the opposite sign"),
        (0.0, "follows the motor torque only by"),
    ],
)
def test_a_wrong_gain_or_sign_is_rejected(healthy: Run, factor: float, message: str) -> None:
    with pytest.raises(BusError, match=message):
        healthy.sign_and_gain(factor)


def test_friction_that_the_file_does_not_have_changes_the_gain_little(tmp_path: Path) -> None:
    """With 30 % less friction than in the file, the gain stays within 6 % of 1.

    The gain is the slope between two reversals and does not depend on the width of the hysteresis loop.
    """
    run = Run(tmp_path, plant={"perturbation": {"friction_coefficient": 0.7}})
    assert run.sign_and_gain().gain == pytest.approx(1.0, abs=0.06)


def test_a_joint_that_moves_is_not_held(healthy: Run) -> None:
    healthy.sign_and_gain(moved=0.04)
    with pytest.raises(BusError, match=r"the joint moved by .* hold it within 0\.05 rad"):
        healthy.sign_and_gain(moved=0.06)


def test_a_limit_below_the_friction_is_one_line_before_anything_moves(tmp_path: Path) -> None:
    paths = files(tmp_path, "held", sine(0.5, 0.5), axis={"limits": {"torque": 0.5}})
    with pytest.raises(UsageError, match=r"needs 0\.7\d+ N\*m at the motor .* raise limits\.torque or the pretension"):
        held_configuration(load_configuration(paths[0]), str(tmp_path))


def test_the_torque_stays_within_the_limit(tmp_path: Path) -> None:
    paths = files(tmp_path, "held", sine(0.5, 0.5), axis={"limits": {"torque": 0.9}})
    configuration = load_configuration(paths[0])
    assert amplitude(configuration, configuration.file.axes[0], configuration.models[0]) == 0.9
    assert SECONDS > SHORT
