"""`tsa investigate` on a simulated rig on a vcan: a hidden offset, and Ctrl-C while torque is applied."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.tune import rig
from tsa_ctrl.demo.rig import BusChoice
from tsa_ctrl.system.process_supervisor import plant, tsa

RATE = 250.0  # Hz, a rate that a virtual machine can keep
SHORT = ("--yes", "--json", "--seconds", "10", "--most", "2", "--out", "out")
PATIENCE = 120.0  # s

pytestmark = [pytest.mark.vcan, pytest.mark.hil, pytest.mark.slow]


def test_the_hidden_offset_is_named(tmp_path: Path, vcan: str) -> None:
    effects = {"effects": {"torque_offset": {"offset": 0.2}}}
    rig.write(tmp_path, BusChoice("socketcan", vcan), RATE, axis=effects)
    command = tsa("investigate", rig.CONTROLLER, *SHORT)
    with plant(tmp_path):
        run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert run.stdout, run.stderr
    found = json.loads(run.stdout)
    assert "torque_offset" in {cause["effect"] for cause in found["causes"]}, found["statement"]
    assert found["motions"] >= 1
    assert (tmp_path / "out/motion-1/motion-1.mcap").is_file()


@pytest.mark.soak
def test_an_interruption_keeps_the_motions_so_far(tmp_path: Path, vcan: str) -> None:
    rig.write(tmp_path, BusChoice("socketcan", vcan), RATE)
    with plant(tmp_path):
        run = subprocess.Popen(
            tsa("investigate", rig.CONTROLLER, *SHORT), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        end = time.monotonic() + PATIENCE
        while not (tmp_path / "out/motion-1/motion-1.csv").exists():
            assert time.monotonic() < end
            time.sleep(0.05)
        time.sleep(4.0)  # the interrupt comes while torque is applied
        run.send_signal(signal.SIGINT)
        out, _ = run.communicate(timeout=60)
    assert run.returncode == 1
    assert json.loads(out)["answer"] == "stopped"
    assert (tmp_path / "out/report.html").is_file()
