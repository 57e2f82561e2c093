"""Test the sign and gain check with a locked joint on logs of the simulated rig."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.virtual.joints import files, sine
from tsa_ctrl import simulate_loop
from tsa_ctrl.config import load_configuration
from tsa_ctrl.drills.held import SECONDS, amplitude, held_configuration, sign_and_gain
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.readiness import SignAndGain

SHORT = 7.0  # s of torque: one reversal more than in a single period


def play(
    folder: Path,
    *faults: str,
    load: str = "held",
    axis: Mapping[str, Any] | None = None,
    plant: Mapping[str, Any] | None = None,
    scale: Mapping[str, float] | None = None,
) -> SignAndGain:
    """Return the sign and gain of a simulated run. `scale` contains factors for columns of the log."""
    paths = files(folder, load, sine(0.5, 0.5), axis=axis, plant=plant, curvature="motor_end")
    configuration = held_configuration(load_configuration(paths[0]), str(folder))
    log = dict(simulate_loop(configuration, paths[1], SHORT, faults=faults).axes[0].log)
    for name, factor in (scale or {}).items():
        log[name] = factor * log[name]
    return sign_and_gain("joint", log, configuration.models[0])


def test_a_healthy_rig_shows_its_sign_and_gain(tmp_path: Path) -> None:
    found = play(tmp_path)
    assert found.sensor == "joint torque sensor"
    assert found.gain == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_wrong_gain_is_rejected_with_its_value(tmp_path: Path, factor: float) -> None:
    with pytest.raises(
        BusError, match=rf"shows {factor:.1f}\d? times the torque of the model, allowed are 0\.9 to 1\.1"
    ):
        play(tmp_path, scale={"tau_j": factor})


def test_friction_that_the_file_does_not_have_changes_the_gain_little(tmp_path: Path) -> None:
    """With 30 % less friction than in the file, the gain stays within 6 % of 1.

    The gain is the slope between two reversals and does not depend on the width of the hysteresis loop.
    """
    assert play(tmp_path, plant={"perturbation": {"friction_coefficient": 0.7}}).gain == pytest.approx(1.0, abs=0.06)


def test_a_wrong_sign_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="shows the opposite sign"):
        play(tmp_path, scale={"tau_j": -1.0})


def test_a_joint_that_moves_is_not_held(tmp_path: Path) -> None:
    with pytest.raises(BusError, match=r"the joint moved by .* hold it within 0\.05 rad"):
        play(tmp_path, load="weight")


def test_a_sensor_that_stands_still_shows_nothing(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="follows the motor torque only by"):
        play(tmp_path, scale={"tau_j": 0.0})


def test_a_limit_below_the_friction_is_one_line_before_anything_moves(tmp_path: Path) -> None:
    paths = files(tmp_path, "held", sine(0.5, 0.5), axis={"limits": {"torque": 0.5}})
    with pytest.raises(UsageError, match=r"needs 0\.7\d+ N\*m at the motor .* raise limits\.torque or the pretension"):
        held_configuration(load_configuration(paths[0]), str(tmp_path))


def test_the_torque_stays_within_the_limit(tmp_path: Path) -> None:
    paths = files(tmp_path, "held", sine(0.5, 0.5), axis={"limits": {"torque": 0.9}})
    configuration = load_configuration(paths[0])
    assert amplitude(configuration, configuration.file.axes[0], configuration.models[0]) == 0.9
    assert SECONDS > SHORT
