"""Test the protocol of the service manager on a socket, and the unit file."""

from __future__ import annotations

import configparser
import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.system.process_supervisor import LONGEST, Notifier

UNIT = ROOT / "config" / "tsa.service"


class Manager:
    """The service manager's end of the socket, which returns the messages in order."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.setblocking(False)

    def heard(self) -> list[str]:
        found = []
        while True:
            try:
                found.append(self.socket.recv(4096).decode())
            except BlockingIOError:
                return found


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    made = Manager(str(tmp_path / "notify"))
    yield made
    made.socket.close()


def asked(tmp_path: Path, **more: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": str(tmp_path / "notify"), **more}


def update(notifier: Notifier, now: float, phase: LoopPhase) -> None:
    notifier.update(now, phase.name.lower(), phase.up, phase.ending)


def test_ready_comes_once_and_only_with_torque_or_a_latched_fault(manager: Manager, tmp_path: Path) -> None:
    """READY is not sent during bring-up or settling. It is sent for a startup that ends in a latched fault."""
    notifier = Notifier(asked(tmp_path))
    update(notifier, 0.0, LoopPhase.SETTLING)
    assert manager.heard() == []
    update(notifier, 0.1, LoopPhase.RUNNING)
    update(notifier, 0.2, LoopPhase.FAULTED)
    update(notifier, 0.3, LoopPhase.RUNNING)
    assert manager.heard() == ["READY=1\nSTATUS=running"]
    notifier.close()


def test_signs_of_life_come_four_times_per_interval(manager: Manager, tmp_path: Path) -> None:
    """WATCHDOG_USEC requests them. At 50 updates per second, 4 are sent in 2 s."""
    notifier = Notifier(asked(tmp_path, WATCHDOG_USEC="2000000", WATCHDOG_PID=str(os.getpid())))
    for look in range(100):
        update(notifier, 0.02 * look, LoopPhase.SETTLING)
    assert manager.heard() == ["WATCHDOG=1"] * 4
    notifier.close()


@pytest.mark.parametrize(
    "more", [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "9", "WATCHDOG_PID": "1"}]
)
def test_no_signs_of_life_for_somebody_else(manager: Manager, tmp_path: Path, more: dict[str, str]) -> None:
    """Nothing is sent if the variable is absent or invalid, or is meant for another process."""
    notifier = Notifier(asked(tmp_path, **more))
    update(notifier, 0.0, LoopPhase.SETTLING)
    assert manager.heard() == []
    notifier.close()


def test_a_bring_up_may_take_longer(manager: Manager, tmp_path: Path) -> None:
    """The watchdog time is extended while no loop runs, and then restored."""
    notifier = Notifier(asked(tmp_path, WATCHDOG_USEC="2000000"))
    with notifier.no_loop():
        assert manager.heard() == [f"WATCHDOG_USEC={round(LONGEST * 1e6)}\nWATCHDOG=1"]
    assert manager.heard() == ["WATCHDOG_USEC=2000000\nWATCHDOG=1"]
    notifier.close()


@pytest.mark.parametrize("phase", [LoopPhase.STOPPING, LoopPhase.ENDED])
def test_stopping_is_said_once(manager: Manager, tmp_path: Path, phase: LoopPhase) -> None:
    """STOPPING is sent once, with or without a ramp to 0, and the watchdog time is extended."""
    notifier = Notifier(asked(tmp_path, WATCHDOG_USEC="2000000"))
    for look in range(3):
        update(notifier, 0.02 * look, phase)
    assert manager.heard()[:2] == ["STOPPING=1\nSTATUS=stopping", f"WATCHDOG_USEC={round(LONGEST * 1e6)}\nWATCHDOG=1"]
    notifier.close()


@pytest.mark.parametrize("address", ["", "/nowhere/notify", "@tsa-nobody"])
def test_nobody_there_is_no_matter(address: str) -> None:
    """A missing manager never stops the loop."""
    notifier = Notifier({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000"})
    update(notifier, 0.0, LoopPhase.RUNNING)
    notifier.close()


def test_a_manager_that_does_not_read_is_not_waited_for(manager: Manager, tmp_path: Path) -> None:
    """If the queue is full, messages are dropped and the call returns."""
    notifier = Notifier(asked(tmp_path, WATCHDOG_USEC="4"))
    for look in range(5000):
        update(notifier, 1e-3 * look, LoopPhase.RUNNING)
    assert 0 < len(manager.heard()) < 5000
    notifier.close()


def test_unit_says_what_the_daemon_keeps_to() -> None:
    """The unit file has type, watchdog, limits, and a policy that never restarts the drives automatically."""
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string(UNIT.read_text(encoding="utf-8"))
    service = unit["Service"]
    assert service["Type"] == "notify"
    assert float(service["WatchdogSec"]) > 0.0
    assert service["Restart"] == "no"
    assert service["KillMode"] == "process"  # the monitor outlives the daemon until the torque is off
    assert int(service["LimitRTPRIO"]) >= 80  # [realtime] priority
    assert service["LimitMEMLOCK"] == "infinity"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze: install systemd")
def test_unit_is_good_for_systemd_itself(tmp_path: Path) -> None:
    """systemd-analyze verify reports no problem if command and user exist on this machine."""
    text = UNIT.read_text(encoding="utf-8").replace("/opt/tsa/bin/tsa", "/bin/true").replace("User=tsa", "User=root")
    unit = tmp_path / "tsa.service"
    unit.write_text(text.replace("Group=tsa", "Group=root"), encoding="utf-8")
    run = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr.strip()) == (0, "")
