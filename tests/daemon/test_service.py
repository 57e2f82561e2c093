"""Test the daemon as a service on a vcan: notifications, a hang, and a full disk."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.daemon.test_vcan import STARTED, Rig, columns, ended, until
from tests.system.test_notify import Manager

pytestmark = [pytest.mark.vcan, pytest.mark.hil, pytest.mark.slow]

WATCHDOG = 2.0  # s
SIZE = 1 << 20  # bytes of the small disk


@pytest.fixture
def rig(tmp_path: Path, vcan: str) -> Iterator[Rig]:
    made = Rig(tmp_path, vcan)
    yield made
    made.end()


def test_manager_is_told_and_a_hang_shows(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon notifies the service manager of readiness, then of life while it runs, and of a stop at the signal.

    A suspended daemon sends no notification.
    """
    manager = Manager(str(rig.folder / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(rig.folder / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", str(round(1e6 * WATCHDOG)))
    rig.plant()
    daemon = rig.run()
    heard: list[str] = []
    until(
        lambda: heard.extend(manager.heard()) or "READY=1\nSTATUS=running" in heard or daemon.poll() is not None,
        STARTED,
    )
    assert rig.phase("running")
    manager.heard()
    time.sleep(WATCHDOG)
    assert 2 <= manager.heard().count("WATCHDOG=1") <= 6
    daemon.send_signal(signal.SIGSTOP)
    time.sleep(0.1)
    manager.heard()
    time.sleep(0.5 * WATCHDOG)
    assert manager.heard() == []
    daemon.send_signal(signal.SIGCONT)
    daemon.terminate()
    ended(daemon)
    assert manager.heard().count("STOPPING=1\nSTATUS=stopping") == 1
    manager.socket.close()


def test_hung_socket_server_does_not_keep_the_daemon_from_its_end(rig: Rig) -> None:
    """The server's supervisor is suspended and cannot replace it. The daemon still ends and prints its summary."""
    rig.plant()
    daemon = rig.run()
    until(lambda: rig.phase("running"), STARTED)
    listed = subprocess.run(["pgrep", "-o", "-P", str(daemon.pid), "-f", "ipc.server"], capture_output=True, text=True)
    (supervisor,) = map(int, listed.stdout.split())
    os.kill(supervisor, signal.SIGSTOP)
    daemon.terminate()
    summary, error, code = ended(daemon)
    assert (code, summary["cause"]) == (0, "SIGTERM"), error


def test_full_disk_stops_nothing(rig: Rig) -> None:
    """The loop continues and reports the full disk. Once there is space, all stored records are written.

    The log can then be read and contains each cycle once.
    """
    disk = rig.folder / "logs"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(disk)], check=True)
    try:
        rig.plant()
        daemon = rig.run()
        until(lambda: rig.phase("running"), STARTED)
        filler = disk / "filler"
        with filler.open("wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(4096))
            except OSError:
                os.fsync(file.fileno())

        def told(words: str) -> bool:
            status = rig.status()
            return status is not None and any(words in event["text"] for event in status["events"])

        until(lambda: told("No space left on device; the loop goes on"))
        before = rig.status()
        assert before is not None
        time.sleep(1.0)
        after = rig.status()
        assert after is not None
        assert after["phase"] == "running"
        assert after["cycles"]["cycles"] - before["cycles"]["cycles"] > 100
        filler.unlink()
        until(lambda: told("log: written again"))
        daemon.terminate()
        summary, err, code = ended(daemon)
        assert code == 0, err
        assert summary["cause"] == "SIGTERM"
        assert summary["log_records"] == {"written": summary["cycles"]["sent"], "lost": 0}
        (cycle,) = columns(summary, "cycle")
        assert len(cycle) == summary["cycles"]["sent"]
        assert np.all(np.diff(cycle) > 0.0)
    finally:
        subprocess.run(["umount", str(disk)], check=True)
