"""Test that the socket opens before the daemon imports slow modules, and that it reports the startup stage."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.serving import description, until
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.mailbox import Mailbox
from tsa_ctrl.ipc.protocol import Set, Status, Stop
from tsa_ctrl.ipc.server_process import ServerProcess


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ServerProcess]:
    made = ServerProcess(str(tmp_path / "tsa.sock"), name="bench")
    yield made
    made.end()


def asked(server: ServerProcess) -> dict[str, object]:
    with Client(server.path) as client:
        return client.ask(Status())


def test_status_reports_each_stage_of_the_start(server: ServerProcess) -> None:
    for stage in ("importing", "compiling for the first use on this machine: 3 functions in 12 s"):
        server.stage(stage)
        assert until(lambda stage=stage: asked(server)["waiting_for"] == stage)  # type: ignore[misc]
    found = asked(server)
    assert (found["name"], found["phase"], found["axes"], found["faults"]) == ("bench", "starting", [], [])


def test_a_change_before_the_daemon_has_read_its_file_is_refused_with_the_stage(server: ServerProcess) -> None:
    server.stage("importing")
    assert until(lambda: asked(server)["waiting_for"] == "importing")
    with Client(server.path) as client, pytest.raises(UsageError, match=r"the daemon is starting \(importing\)"):
        client.ask(Set("compensation", 0.5))


def test_no_client_meets_a_missing_socket_between_start_and_run(server: ServerProcess) -> None:
    """A client sends requests continuously while the server gets its description, and each request is answered."""
    axes, errors, done = [], [], threading.Event()

    def ask() -> None:
        while not done.is_set():
            try:
                axes.append(asked(server)["axes"])
            except (BusError, UsageError) as error:
                errors.append(str(error))

    client = threading.Thread(target=ask)
    client.start()
    assert until(lambda: len(axes) > 20)
    mailbox = Mailbox(1, 2, server.descriptor)
    server.describe(description(Path(server.path), ["knee"]))
    assert until(lambda: axes[-1] != [])
    done.set()
    client.join()
    mailbox.close()
    assert not errors
    assert axes[0] == []


def test_a_second_daemon_on_the_socket_is_one_line(server: ServerProcess) -> None:
    with pytest.raises(UsageError, match="another daemon answers there"):
        ServerProcess(server.path)
    assert asked(server)["phase"] == "starting"


SLOW = """
import sys, time
from tsa_ctrl.ipc.server_process import ServerProcess
server = ServerProcess(sys.argv[1])
server.stage("importing")
print("open", flush=True)
time.sleep(60.0)
"""


def test_a_stop_request_ends_a_daemon_that_still_imports(tmp_path: Path) -> None:
    path = tmp_path / "tsa.sock"
    with subprocess.Popen([sys.executable, "-c", SLOW, str(path)], stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        assert daemon.stdout.readline() == "open\n"
        with Client(str(path)) as client:
            assert client.ask(Stop())["waiting_for"] in ("starting", "importing")
        assert daemon.wait(10.0) == -signal.SIGTERM
    assert until(lambda: not path.exists())


def test_the_socket_is_open_long_before_the_loop_runs(tmp_path: Path) -> None:
    """`tsa run` opens the socket before it rejects the file with a one-line error. The socket is then removed."""
    file, path = tmp_path / "controller.toml", tmp_path / "tsa.sock"
    file.write_text(f'[socket]\npath = "{path}"\n[[axis]]\nname = "knee"\n')
    run = [sys.executable, "-m", "tsa_ctrl", "run", str(file)]
    with subprocess.Popen(run, stderr=subprocess.PIPE, text=True) as daemon:
        seen = False
        while daemon.poll() is None:
            seen = seen or path.exists()
            time.sleep(0.001)
        said = daemon.communicate()[1]
    assert seen
    assert daemon.returncode == 2
    assert said.count("\n") == 1
    assert not path.exists()
