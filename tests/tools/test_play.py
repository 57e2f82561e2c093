"""measured/play: a set-point file from the measured trials; the demo itself is tested elsewhere."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from tsa_ctrl.demo.motion import from_file
from tsa_ctrl.demo.rig import MOST_TORQUE


def tool(*arguments: str, data: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "TSA_DATA": str(data)}
    command = [sys.executable, str(ROOT / "tools"), "measured/play", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("trial", ["load050_0.3Hz", "load090_0.5Hz", "load010_0.1Hz"])
def test_the_demo_takes_the_file_and_can_repeat_it(data_dir: Path, tmp_path: Path, trial: str) -> None:
    done = tool("--file-only", "--trial", trial, "--out", str(tmp_path), data=data_dir)
    assert done.returncode == 0, done.stderr
    assert "joint torque times" in done.stdout
    play = from_file(tmp_path / "setpoint.csv", MOST_TORQUE)
    assert np.max(np.abs(play.tau_j_des)) == pytest.approx(0.9)
    assert np.ptp(play.q_j) > 0.7  # rad: the measured swing, not scaled
    assert play.q_j[-1] == pytest.approx(play.q_j[0])
    assert play.tau_j_des[-1] == pytest.approx(play.tau_j_des[0])


def test_without_the_data_there_is_one_line_and_no_error(tmp_path: Path) -> None:
    done = tool(data=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") == 1
    assert "TSA_DATA" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(("--trial", "x"), "no such trial"), (("--file-only", "--out", "/dev/null/x"), "cannot be written")],
)
def test_a_mistake_is_one_line(data_dir: Path, arguments: tuple[str, ...], said: str) -> None:
    done = tool(*arguments, data=data_dir)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
