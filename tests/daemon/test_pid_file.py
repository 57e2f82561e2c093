"""Test `tsa stop` for a daemon whose socket server is dead or hangs. A reused process id is not signalled."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tsa_ctrl.cli import cli
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc import server_process

# Behaves like a socket server that hangs: the kernel accepts connections, but no request is answered.
DAEMON = """
import os, signal, socket, sys
def end(number, frame):
    os.write(1, b"told to stop\\n")  # print fails if the signal interrupts a print
    os._exit(0)
signal.signal(signal.SIGTERM, end)
listener = socket.socket(socket.AF_UNIX)
if sys.argv[2] == "hangs":
    listener.bind(sys.argv[1])
    listener.listen(1)
print("up", flush=True)
signal.pause()
"""


@pytest.fixture(params=["hangs", "dead"])
def daemon(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    path = str(tmp_path / "tsa.sock")
    process = subprocess.Popen([sys.executable, "-c", DAEMON, path, request.param], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    server_process.write(path, process.pid)
    yield path, process
    process.kill()
    process.wait()


def test_stop_ends_a_daemon_whose_socket_does_not_answer(
    daemon: tuple[str, subprocess.Popen[str]],
) -> None:
    path, process = daemon
    result = CliRunner().invoke(cli, ["stop", "--socket", path])
    assert process.communicate(timeout=30)[0] == "told to stop\n"
    assert f"process {process.pid} got SIGTERM instead" in result.output
    assert "stopped: the daemon has ended" in result.output


def test_stop_ends_a_daemon_that_rejects_it(daemon: tuple[str, subprocess.Popen[str]]) -> None:
    """If the daemon rejects the stop request, its process gets a signal."""

    def reject() -> dict[str, Any]:
        raise UsageError("daemon: 16 clients are connected already")

    path, process = daemon
    assert server_process.stop(path, reject)["signalled"] == process.pid
    assert process.communicate(timeout=30)[0] == "told to stop\n"


def test_stop_ends_a_suspended_daemon(daemon: tuple[str, subprocess.Popen[str]]) -> None:
    """A suspended daemon would not handle the signal, so it is also resumed."""
    path, process = daemon
    process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, process.pid, os.WSTOPPED)
    found = server_process.stop(path, lambda: {"waiting_for": None})
    assert (found["signalled"], "is suspended" in found["reason"]) == (process.pid, True)
    assert process.communicate(timeout=30)[0] == "told to stop\n"


def test_a_user_who_may_only_watch_keeps_the_rejection(tmp_path: Path) -> None:
    def reject() -> dict[str, Any]:
        raise UsageError("daemon: stop: user 12345 may only watch here")

    with pytest.raises(UsageError, match="may only watch"):
        server_process.stop(str(tmp_path / "tsa.sock"), reject)


def test_only_who_wrote_it_takes_it_away(tmp_path: Path) -> None:
    """A folder that cannot be written costs the file alone."""
    path = str(tmp_path / "tsa.sock")
    server_process.write(path, os.getpid())
    server_process.remove(path, os.getpid() + 1)
    assert server_process.running(path) == os.getpid()
    server_process.remove(path, os.getpid())
    assert list(tmp_path.iterdir()) == []
    server_process.write(str(tmp_path / "none/tsa.sock"), os.getpid())
    assert server_process.running(str(tmp_path / "none/tsa.sock")) is None


def test_neither_another_process_nor_a_file_that_others_may_write_is_the_daemon(tmp_path: Path) -> None:
    """The process id was reused, so its start time differs. A file that others may write is not trusted."""
    path = str(tmp_path / "tsa.sock")
    server_process.write(path, os.getpid())
    place = server_process.place(path)
    number, start = place.read_text().split()
    place.chmod(0o666)
    assert server_process.running(path) is None
    place.chmod(0o600)
    assert server_process.running(path) == os.getpid()
    place.write_text(f"{number} {int(start) - 1}\n")
    assert server_process.running(path) is None
    assert server_process.terminate(path) is None


def test_a_file_that_says_nothing_stops_nobody(tmp_path: Path) -> None:
    path = str(tmp_path / "tsa.sock")
    for text in ("", "7", "x y", "-1 -1", "1 2 3", "99999999999999999999 1"):
        server_process.place(path).write_text(text)
        assert server_process.running(path) is None, text
    assert isinstance(CliRunner().invoke(cli, ["stop", "--socket", path]).exception, BusError)


def test_a_daemon_that_ended_is_not_signalled(tmp_path: Path) -> None:
    path = str(tmp_path / "tsa.sock")
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    server_process.write(path, process.pid)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert server_process.terminate(path) is None
