"""Test the local socket: strict, bounded, and owned by one user. No client delays another client or the loop."""

from __future__ import annotations

import contextlib
import errno
import grp
import json
import math
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.daemon.serving import Serving, loop_taking, until
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc import server_process
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.connection import Peer, listen
from tsa_ctrl.ipc.mailbox import SLOTS, Command, Mailbox
from tsa_ctrl.ipc.protocol import Set, SetPointValue, Status, make_private
from tsa_ctrl.ipc.report import EventPrinter


def raw(serving: Serving, data: bytes) -> list[dict[str, Any]]:
    """Send bytes on a new connection and return the decoded lines of the answer."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(10.0)
        connection.connect(serving.path)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            connection.sendall(data)
        answer = b""
        with contextlib.suppress(OSError):
            while not answer.endswith(b"\n"):
                part = connection.recv(65536)
                if not part:
                    break
                answer += part
    return [json.loads(line) for line in answer.splitlines()]


REJECTED: list[tuple[Set | SetPointValue, str]] = [
    (Set("compensation", 0.5), "give the axis: knee.compensation, hip.compensation"),
    (Set("toe.compensation", 0.5), "no axis 'toe'; available: knee, hip"),
    (Set("knee.compensatoin", 0.5), "did you mean 'compensation'"),
    (Set("knee.compensation", 1.3), "compensation 1.3 is out of bounds; allowed is 0 to 1.2$"),
    (Set("knee.pretension", 40.0), "cannot be set"),
    (SetPointValue("hip", 0.1), "does not come over the socket"),
]


def test_a_request_reaches_the_loop_unless_it_is_out_of_bounds(serving: Serving) -> None:
    """A rejected request gets a reason, and the mailbox stays empty. A valid one becomes one command for its axis."""
    with Client(serving.path) as client:
        for request, words in REJECTED:
            with pytest.raises(UsageError, match=words):
                client.ask(request)
        assert serving.mailbox.take() is None
        with loop_taking(serving) as taken:
            answer = client.ask(Set("hip.compensation", 0.5))
            now = time.monotonic()
            client.ask(SetPointValue("knee", -0.5, now))
            assert serving.mailbox.wanted(0) == (-0.5, now)
    assert taken == [Command(1, 0, 0.5)]
    assert (answer["before"], answer["value"]) == (0.95, 0.5)


NONSENSE = [
    b"",
    b'{"verb":"status"',
    b'{"verb":"status","extra":1}',
    b'{"verb":"set","name":"knee.compensation","value":NaN}',
    b'{"verb":"set","name":"\xff","value":1}',
    b"x" * 5000,
    b'{"x":' + b"[" * 4000,  # nested too deeply
]


def test_nonsense_is_refused_and_survived(serving: Serving) -> None:
    """An invalid request gets an error, has no effect, and the server continues."""
    for line in NONSENSE:
        answers = raw(serving, line + b"\n")
        assert [answer["ok"] for answer in answers] == [False], line
        assert "not a request" in answers[0]["error"] or len(line) == 5000, line
    assert serving.mailbox.take() is None
    with Client(serving.path) as client:
        assert client.ask(Status())["schema"] == 1


def test_a_set_point_beyond_its_range_is_clamped_and_flagged(serving: Serving) -> None:
    """Each measurement contains the range of the set-point. A larger value is clamped and flagged."""
    with Client(serving.path) as client:
        assert [client.measure()[axis].set_point_limit for axis in ("knee", "hip")] == [2.0, None]
        for value, taken in ((2.1, 2.0), (-7.0, -2.0), (1e12, 2.0)):
            assert client.ask(SetPointValue("knee", value)) == {"axis": "knee", "clamped": taken}
            assert (serving.mailbox.wanted(0) or (0.0,))[0] == taken
            assert client.measure()["knee"].clamped
            assert client.ask(SetPointValue("knee", 0.5)) == {}
            assert not client.measure()["knee"].clamped


def test_a_stream_beyond_its_range_is_clamped_and_flagged_once(serving: Serving) -> None:
    with Client(serving.path) as client, client.lease(10.0) as lease:
        for _ in range(20):
            lease.send({"knee": 3.0})
        assert until(lambda: bool(client.measure()["knee"].clamped))
        assert lease.clamped == {"knee": 2.0}


def test_flood_is_bounded_and_others_are_served(serving: Serving) -> None:
    """One client sends many requests and reads no answers. The queue is bounded, and another client gets its status."""
    line = b'{"verb":"set","name":"knee.compensation","value":0.5}\n'
    with socket.socket(socket.AF_UNIX) as flood:
        flood.connect(serving.path)
        flood.setblocking(False)
        sent = 0
        with contextlib.suppress(BlockingIOError, BrokenPipeError, ConnectionResetError):
            while sent < 4_000_000:
                sent += flood.send(line * 1000)
        with Client(serving.path) as client:
            assert client.ask(Status())["schema"] == 1
        assert sum(serving.mailbox.take() is not None for _ in range(10 * SLOTS)) <= 2 * SLOTS


def test_left_over_socket_is_replaced(tmp_path: Path) -> None:
    """A socket file without a listener, as after a killed daemon, does not prevent a new start."""
    path = tmp_path / "tsa.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    running = Serving(path, ["knee"])
    assert running.ready
    running.end()


@pytest.mark.parametrize("module", ["tsa_ctrl.ipc.server", "tsa_ctrl.log.writer"])
def test_owner_that_is_gone_before_it_asks_is_no_matter(module: str, tmp_path: Path) -> None:
    """If the daemon ends while its processes start, as after Ctrl-C, they end without output."""
    command = [sys.executable, "-m", module, "0", str(tmp_path / "x.mcap")]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


@pytest.mark.slow
def test_server_that_hangs_is_replaced_on_the_same_socket(serving: Serving) -> None:
    """After SIGSTOP a replacement answers, the set-point is withdrawn, and no event is printed twice."""
    event = '{"number":0,"t":1.5,"axis":"knee","text":"heartbeat lost","fault":true}'
    serving.mailbox.publish_text(f"[{event}]".encode())
    serving.mailbox.want(0, 0.5, time.monotonic())
    with Client(serving.path) as client:
        client.ask(Status())
    assert serving.process.stderr is not None
    assert b"heartbeat lost" in serving.process.stderr.readline()
    os.kill(serving.worker, signal.SIGSTOP)
    with Client(serving.path, timeout=30.0) as client:
        assert client.ask(Status())["schema"] == 1
    assert serving.mailbox.replaced == 1
    wanted = serving.mailbox.wanted(0)
    assert wanted is not None
    assert wanted[1] == -math.inf  # the set-points of its clients are withdrawn
    assert "heartbeat lost" not in serving.end()


@pytest.mark.slow
def test_an_event_that_a_hanging_server_did_not_print_is_printed_by_its_replacement(serving: Serving) -> None:
    with Client(serving.path) as client:
        client.ask(Status())
    os.kill(serving.worker, signal.SIGSTOP)
    serving.mailbox.publish_text(b'[{"number":0,"t":1.5,"axis":"knee","text":"heartbeat lost","fault":true}]')
    assert until(lambda: serving.mailbox.replaced == 1)
    assert until(lambda: serving.mailbox.printed == 0)
    assert serving.end().count("heartbeat lost") == 1


def test_a_daemon_without_a_socket_yet_is_named(tmp_path: Path) -> None:
    """A daemon that runs but has not opened its socket yet is reported as starting."""
    socket = str(tmp_path / "tsa.sock")
    server_process.write(socket, os.getpid())
    with pytest.raises(BusError, match=f"process {os.getpid()} is starting"):
        Client(socket)


@pytest.mark.parametrize("step", ["chown", "chmod", "listen"])
def test_socket_that_cannot_be_opened_is_not_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """If the user may not use the group, for example, the error has one line and no socket remains."""

    def denied(*arguments: object) -> None:
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    where = {"chown": "os.chown", "chmod": "pathlib.Path.chmod", "listen": "socket.socket.listen"}
    path = tmp_path / "tsa.sock"
    with monkeypatch.context() as changed:
        changed.setattr(where[step], denied)
        with pytest.raises(UsageError, match=r"\[socket\] .*Operation not permitted") as error:
            listen(str(path), grp.getgrgid(os.getgid()).gr_name)
    assert "\n" not in str(error.value)
    assert not path.exists()


def test_a_path_without_a_place_for_a_socket_is_named(tmp_path: Path) -> None:
    """A file in the way stays."""
    path = tmp_path / "tsa.sock"
    path.write_text("somebody's")
    for place, words in ((path, "cannot listen there"), (tmp_path / ("x" * 120), r"\(AF_UNIX path too long\)")):
        with pytest.raises(UsageError, match=words):
            listen(str(place), None)
    assert path.read_text() == "somebody's"


def test_a_daemon_reached_by_a_shorter_path_keeps_its_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its absolute path is too long to connect to."""
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    monkeypatch.chdir(folder)
    with listen("tsa.sock", None):
        with pytest.raises(UsageError, match=r"cannot connect \(AF_UNIX path too long\); give another path"):
            listen(str(folder / "tsa.sock"), None)
        assert (folder / "tsa.sock").is_socket()


def test_a_terminal_that_is_stopped_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the terminal is paused with Ctrl-S, the output blocks, but `update` does not."""
    resumed = threading.Event()
    monkeypatch.setattr("tsa_ctrl.ipc.report.os.write", lambda descriptor, data: resumed.wait() and len(data))
    mailbox = Mailbox(1, 1)
    printer = EventPrinter(mailbox)
    for number in range(1000):
        mailbox.publish_text(msgspec.json.encode([{"number": number, "axis": "", "t": 0.0, "text": "x"}]))
        printer.update()
    resumed.set()
    mailbox.close()


def test_the_private_folder_is_its_owners_alone_and_no_link(tmp_path: Path) -> None:
    own, trap = tmp_path / "own", tmp_path / "trap"
    for _ in range(2):
        make_private(str(own))
        assert stat.S_IMODE(own.stat().st_mode) == 0o700
    own.chmod(0o750)
    trap.symlink_to(tmp_path)
    for place in (own, trap):
        with pytest.raises(UsageError, match="is not a folder of this user alone"):
            make_private(str(place))


def test_a_socket_that_is_left_over_and_cannot_be_removed_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "tsa.sock"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(place))

    def refuse(self: Path, missing_ok: bool = False) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(UsageError, match="is left over and cannot be removed"):
        listen(str(place), None)


def test_a_daemon_of_somebody_else_at_the_users_own_place_is_not_believed(
    serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tsa_ctrl.ipc.client.default_path", lambda: serving.path)
    monkeypatch.setattr("tsa_ctrl.ipc.client.peer_of", lambda connection: Peer(1, 12345))
    with pytest.raises(BusError, match="user 12345 answers there"):
        Client(serving.path)
