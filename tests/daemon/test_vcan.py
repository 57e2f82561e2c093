"""Test plant and daemon as processes on a real vcan: normal operation and each kind of shutdown."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tsa_ctrl.errors import BusError
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.protocol import Status
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.plant.process import ask

pytestmark = [pytest.mark.vcan, pytest.mark.hil, pytest.mark.slow]

CONFIG = Path(__file__).resolve().parents[2] / "config"
STARTED = 120.0  # s; the first start on a machine includes compilation
PATIENCE = 60.0  # s
PATIENT = (  # a busy machine may delay a process for some time
    ("rate = 1000.0", "rate = 250.0"),
    ("# [bus.supervision]", "[bus.supervision]"),
    ("# tolerated_misses = 2 ", "tolerated_misses = 60 "),
    ("# lost_share = 0.2 ", "lost_share = 1.0 "),
    ("# rpdo_timeout = 0.02 ", "rpdo_timeout = 1.0 "),
    ("# host_timeout = 0.1 ", "host_timeout = 2.0 "),
    ("# heartbeat_timeout = 0.2 ", "heartbeat_timeout = 2.0 "),
    ("# allow_without = false", "allow_without = true"),
    ("# settle_cycles = 100 ", "settle_cycles = 20 "),
)


def until(condition: Callable[[], Any], patience: float = PATIENCE) -> Any:
    end = time.monotonic() + patience
    while not (found := condition()):
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)
    return found


class Rig:
    """A folder with a configuration, and the processes of a test."""

    def __init__(self, folder: Path, interface: str) -> None:
        self.folder = folder
        self.interface = interface
        self.socket = str(folder / "tsa.sock")
        self.processes: list[subprocess.Popen[str]] = []
        for name in ("controller.toml", "plant.toml", "actuator.toml"):
            shutil.copy(CONFIG / name, folder)
        self.edit(*PATIENT, ('# path = ""', f'path = "{self.socket}"'), ('"vcan0"', f'"{interface}"'))

    def edit(self, *changes: tuple[str, str]) -> None:
        self._edit(self.folder / "controller.toml", *changes)

    def edit_plant(self, *changes: tuple[str, str]) -> None:
        self._edit(self.folder / "plant.toml", *changes)

    def _edit(self, path: Path, *changes: tuple[str, str]) -> None:
        text = path.read_text(encoding="utf-8")
        for before, after in changes:
            assert before in text, before
            text = text.replace(before, after, 1)
        path.write_text(text, encoding="utf-8")

    def start(self, *command: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            ["tsa", *command], cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.processes.append(process)
        return process

    def plant(self) -> subprocess.Popen[str]:
        plant = self.start("plant", "plant.toml", "--control", str(self.folder / "plant.sock"))
        assert plant.stdout is not None
        for line in plant.stdout:
            if "ready" in line:
                return plant
        raise AssertionError(plant.communicate()[1])

    def run(self, *options: str) -> subprocess.Popen[str]:
        return self.start("run", "controller.toml", "--json", *options)

    def torque(self) -> float:
        """Return the motor torque of the plant, N*m."""
        return abs(json.loads(ask(self.folder / "plant.sock", "state"))["axes"][0]["torque_loop"])

    def status(self) -> dict[str, Any] | None:
        try:
            with Client(self.socket) as client:
                return client.ask(Status())
        except BusError:
            return None

    def phase(self, name: str) -> bool:
        status = self.status()
        return status is not None and status["phase"] == name

    def end(self) -> None:
        for process in self.processes:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.terminate()
        for process in self.processes:
            try:
                process.communicate(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()


def ended(process: subprocess.Popen[str]) -> tuple[dict[str, Any], str, int]:
    """Wait for the daemon to end, and return its summary, stderr and exit code."""
    out, err = process.communicate(timeout=PATIENCE)
    return (json.loads(out) if out else {}), err, process.returncode


@pytest.fixture
def rig(tmp_path: Path, vcan: str) -> Iterator[Rig]:
    made = Rig(tmp_path, vcan)
    yield made
    made.end()


def columns(summary: dict[str, Any], *names: str) -> list[np.ndarray]:
    log = LogFile(Path(summary["log"]))
    found = log.columns(log.axes[0], names)
    return [found[name] for name in names]


def test_signal_ramps_down_and_disables(rig: Rig) -> None:
    """After SIGINT the torque ramps to 0 and the drive confirms the disable. A second signal changes nothing."""
    rig.plant()
    daemon = rig.run()
    until(lambda: rig.phase("running"), STARTED)
    until(lambda: abs(rig.status()["axes"][0]["tau_m_cmd"]) > 0.05)  # type: ignore[index]
    daemon.send_signal(signal.SIGINT)
    daemon.send_signal(signal.SIGTERM)
    summary, err, code = ended(daemon)
    assert code == 0, err
    assert summary["cause"] == "SIGINT"
    assert not summary["unconfirmed"]
    (command,) = columns(summary, "tau_m_cmd")
    assert command[-1] == 0.0
    assert np.max(np.abs(np.diff(command[-80:]))) < 0.2


def test_killed_children_do_not_stop_the_loop(rig: Rig) -> None:
    """The loop continues without its log writer and its socket server, and reports both.

    The log can be read. SIGHUP, the signal of a closed terminal, then ends the daemon.
    """
    rig.plant()
    daemon = rig.run()
    until(lambda: rig.phase("running"), STARTED)
    until(lambda: any(rig.folder.glob("logs/*.mcap")))
    time.sleep(1.0)  # some records are written before the writer is killed
    kill_child(daemon, "log.writer")
    gone = "its process is gone"
    status = until(lambda: (s := rig.status()) and any(gone in event["text"] for event in s["events"]) and s)
    assert status["phase"] == "running"
    kill_child(daemon, "ipc.server")
    time.sleep(2.0)  # an event reports it after a second of silence
    daemon.send_signal(signal.SIGHUP)
    summary, err, code = ended(daemon)
    assert code == 0, err
    assert summary["cause"] == "SIGHUP"
    assert any(gone in event["text"] and "socket" in event["text"] for event in summary["events"])
    assert not summary["unconfirmed"]
    assert summary["log_records"]["lost"] > 0
    (t,) = columns(summary, "t")
    assert len(t) > 0


def kill_child(daemon: subprocess.Popen[str], module: str) -> None:
    found = subprocess.run(["pgrep", "-o", "-P", str(daemon.pid), "-f", module], capture_output=True, text=True)
    os.kill(int(found.stdout), signal.SIGKILL)


def test_a_flooded_socket_leaves_the_loop_alone_and_a_stopped_loop_loses_its_torque(rig: Rig) -> None:
    """Four clients send requests for a second without a fault. After SIGSTOP, the drive ends the torque itself."""
    rig.plant()
    daemon = rig.run()
    until(lambda: rig.phase("running"), STARTED)
    until(lambda: rig.torque() > 0.1)
    clients = [Client(rig.socket) for _ in range(4)]
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        for client in clients:
            client.ask(Status())
    for client in clients:
        client.close()
    status = rig.status()
    assert status is not None
    assert (status["phase"], status["faults"]) == ("running", [])
    until(lambda: rig.torque() > 0.1)
    daemon.send_signal(signal.SIGSTOP)
    until(lambda: rig.torque() < 0.01, 10.0)
    daemon.send_signal(signal.SIGCONT)
    until(lambda: rig.phase("faulted"))
    assert rig.torque() < 0.01
    daemon.terminate()
    _, err, code = ended(daemon)
    assert code == 1, err
