"""`tsa tune` on a simulated rig on a vcan: the whole procedure, and interruption at several stages."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.tune import rig
from tsa_ctrl.demo.rig import BusChoice
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.model.parameters import load_tendon_sheath
from tsa_ctrl.system.process_supervisor import plant, tsa

RATE = 500.0  # Hz
PATIENCE = 120.0  # s
TRUTH = "plant/truth.csv"  # the plant's own record
SHORT = ("--seconds", "12", "--verify-seconds", "6")

pytestmark = [pytest.mark.vcan, pytest.mark.hil, pytest.mark.slow, pytest.mark.soak]


@pytest.fixture
def folder(tmp_path: Path, vcan: str) -> Iterator[Path]:
    """Yield the folder of a rig whose plant is running."""
    rig.write(tmp_path, BusChoice("socketcan", vcan), RATE)
    (tmp_path / TRUTH).parent.mkdir()
    with plant(tmp_path, TRUTH):
        yield tmp_path


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.02)


def test_the_whole_procedure_writes_a_file_that_compensates_a_weight_too(tmp_path: Path, vcan: str) -> None:
    """The joint has a weight that the nominal file does not contain. `--extended` identifies and compensates it."""
    amplitude = 0.35  # N*m
    effects = {"effects": {"gravity_load": {"amplitude": amplitude, "phase": 0.3}}}
    rig.write(tmp_path, BusChoice("socketcan", vcan), RATE, axis=effects)
    command = tsa("tune", rig.CONTROLLER, "--yes", "--json", "--extended", "--out", "out", *SHORT)
    with plant(tmp_path):
        run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr
    data = json.loads(run.stdout)
    assert "gravity_load" in data["effects"]
    assert data["parameters"]["gravity_load.amplitude"]["value"] == pytest.approx(amplitude, rel=0.1)
    reduction = data["verification"]["reduction_percent"]
    assert reduction["after"] > max(75.0, reduction["before"] + 10.0)
    loop = data["calibration"]["combinations"]["half_loop_torque"]
    assert loop["low"] < loop["value"] < loop["high"]
    assert (tmp_path / "out" / "report.html").stat().st_size > 50_000
    assert not list(tmp_path.glob(".tune-*"))
    assert data["written"] is not None
    assert "gravity_load" in load_tendon_sheath(tmp_path / rig.MODEL).effects


@pytest.mark.parametrize(
    ("number", "stage", "with_torque"),
    [
        (signal.SIGINT, "controller-probe-1.toml", False),
        (signal.SIGTERM, "probe-1.csv", True),
        (signal.SIGINT, "controller-excitation.toml", True),
        (signal.SIGTERM, "excitation.mcap", False),
    ],
)
def test_an_interruption_leaves_the_drive_disabled_and_the_files_as_they_were(
    folder: Path, number: signal.Signals, stage: str, with_torque: bool
) -> None:
    """The stages are startup, torque of probe and excitation, and estimate. The plant's record shows its response."""
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    process = subprocess.Popen(
        tsa("tune", rig.CONTROLLER, "--yes", *SHORT),
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    until(lambda: bool(list(folder.glob(f"**/.tune-*/{stage}"))) or process.poll() is not None)
    until(lambda: not with_torque or _enabled(folder) or process.poll() is not None)
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1, errors
    assert "interrupted" in errors
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    assert not list(folder.glob("**/.tune-*"))
    assert not _daemons()
    time.sleep(0.5)  # the plant's record is delayed by a quarter of a second
    assert not _enabled(folder)


def _enabled(folder: Path) -> bool:
    """Return True if the power stage was on in the last row of the plant's own record."""
    rows = (folder / TRUTH).read_bytes()[-4096:].split(b"\n")
    return len(rows) > 2 and rows[-2].split(b",")[5] == b"1"


def _daemons() -> list[str]:
    """Return the command lines of daemons that are still running."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
            if "tsa_ctrl run" in line:
                found.append(line)
    return found


def test_two_values_are_compared_on_a_running_daemon(folder: Path) -> None:
    """Little compensation is compared with most of it. The verdict is clear, and the previous value is restored."""
    daemon = subprocess.Popen(
        tsa("run", rig.CONTROLLER), cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        path = str(folder / "tune.sock")
        until(lambda: (folder / "tune.sock").exists() and status(path) == "operation_enabled")
        command = tsa("set", "compensation", "0.9", "--against", "0.2", "--socket", path, "--json")
        blocks = ("--blocks", "6", "--block-seconds", "2")
        run = subprocess.run([*command, *blocks], capture_output=True, text=True, timeout=PATIENCE, check=False)
        assert run.returncode == 0, run.stderr
        assert json.loads(run.stdout)["better"] == "a"
        until(lambda: value(path) == pytest.approx(rig.COMPENSATION))
    finally:
        daemon.terminate()
        daemon.wait(30.0)


def status(path: str) -> str:
    with Client(path) as client:
        return str(client.ask(protocol.Status())["axes"][0]["state"])


def value(path: str) -> float:
    with Client(path) as client:
        return float(client.ask(protocol.Status())["axes"][0]["parameters"]["compensation"]["value"])
