"""Three makes on one real vcan at 500 Hz: plant and daemon are processes, each drive has its own maker's profile.

In virtual time: tests/drives/test_several.py.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import tomlkit

from tests.conftest import ROOT
from tests.plant.bench import ACTUATOR

pytestmark = [pytest.mark.vcan, pytest.mark.hil, pytest.mark.slow, pytest.mark.soak]

MAKES = ("generic", "epos4", "elmo_gold")
RATE = 500.0  # Hz
SECONDS = 1.5
ATTEMPTS = 4


def files(folder: Path, channel: str) -> tuple[Path, Path]:
    """Controller and plant with one axis of each make, joints standing still."""
    (folder / "actuator.toml").write_text(ACTUATOR, encoding="utf-8")
    shutil.copytree(ROOT / "config" / "drives", folder / "drives")
    axes, drives = [], []
    for number, make in enumerate(MAKES, 1):
        axes.append(
            {
                "name": make,
                "model": "actuator.toml",
                "drive": {
                    "node_id": number,
                    "profile": make,
                    "max_torque": 2.5,
                    "rpdo_timeout": 0.2,
                    "host_timeout": 1.0,
                },
                "setpoint": {"kind": "constant", "offset": 0.3},
                "law": {"fade_in": 0.1},
                "limits": {"torque": 0.9},
            }
        )
        absent = {"present": False}
        drives.append(
            {
                "name": make,
                "drive": {"kind": make, "node_id": number},
                "motion": {"kind": "still"},
                "encoder": absent,
                "torque_sensor": absent,
            }
        )
    controller = {
        "controller": {"rate": RATE, "settle_cycles": 10},
        "bus": {"channel": channel, "supervision": {"tolerated_misses": 50, "lost_share": 1.0}},
        "realtime": {"allow_without": True},
        "log": {"enabled": False},
        "socket": {"path": str(folder / "tsa.sock")},
        "axis": axes,
    }
    plant = {"bus": {"channel": channel}, "axis": drives}
    paths = folder / "controller.toml", folder / "plant.toml"
    for path, tables in zip(paths, (controller, plant), strict=True):
        path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    return paths


def attempt(folder: Path, controller: Path, plant: Path) -> tuple[subprocess.CompletedProcess[str], bool]:
    """One run of the daemon on a fresh plant; and whether the machine stood still meanwhile, as the plant says."""
    tsa = [sys.executable, "-m", "tsa_ctrl"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with (folder / "plant.err").open("w+", encoding="utf-8") as errors:
        machine = subprocess.Popen(
            [*tsa, "plant", str(plant), "--record", str(folder / "truth.csv")],
            stdout=subprocess.PIPE, stderr=errors, text=True, env=environment, cwd=ROOT,
        )  # fmt: skip
        try:
            assert machine.stdout is not None
            while "ready" not in (line := machine.stdout.readline()):
                assert line, "the plant ended"
            run = subprocess.run(
                [*tsa, "run", str(controller), "--seconds", str(SECONDS), "--json"],
                capture_output=True, text=True, timeout=120, env=environment, cwd=ROOT, check=False,
            )  # fmt: skip
        finally:
            machine.terminate()
            machine.wait(30)
        errors.seek(0)
        return run, "not followed" in errors.read()


def test_three_makes_on_one_bus_at_500_hz(tmp_path: Path, vcan: str) -> None:
    """Each comes up with its own profile, pulls, and is off at the end. A machine that stood still tries again."""
    controller, plant = files(tmp_path, vcan)
    for _ in range(ATTEMPTS):
        run, stood_still = attempt(tmp_path, controller, plant)
        if run.returncode == 0 or not stood_still:
            break
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    assert summary["cause"] == f"{SECONDS:g} s are over"
    for make in MAKES:
        assert f"axis '{make}' drive node" in run.stderr
    rows = [line.split(",") for line in (tmp_path / "truth.csv").read_text(encoding="utf-8").splitlines()]
    head = {name: place for place, name in enumerate(rows[0])}
    for number in range(len(MAKES)):
        mine = [row for row in rows[1:] if int(float(row[head["axis"]])) == number]
        assert max(abs(float(row[head["command"]])) for row in mine) > 0.1
        assert float(mine[-1][head["enabled"]]) == 0.0
