"""Test the permissions on the local socket and the lease of the set-point, with a simulated clock."""

from __future__ import annotations

import grp
import json
import math
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.daemon.serving import PATIENCE, QUARTERS, description
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.connection import CLIENTS, Peer, Role, listen, peer_of, role_of
from tsa_ctrl.ipc.mailbox import General, Mailbox, Reading
from tsa_ctrl.ipc.server import HANGS, Server

COMMAND, WATCH = 4001, 4002  # group ids
SET_POINT = {"verb": "setpoint", "axis": "knee"}
GROUP = grp.getgrgid(os.getgid()).gr_name


class Talk:
    """One client. The server handles its requests before the test continues."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(PATIENCE)  # fails if the server accepts no client
        self.socket.connect(desk.path)
        self.socket.setblocking(False)
        desk.steps()

    def say(self, **request: Any) -> None:
        self.socket.sendall(json.dumps(request).encode() + b"\n")

    def told(self) -> list[dict[str, Any]]:
        """Return all lines that have arrived, decoded."""
        self._desk.steps()
        data = b""
        try:
            while part := self.socket.recv(1 << 16):
                data += part
        except BlockingIOError:
            pass
        return [json.loads(line) for line in data.splitlines()]

    def ask(self, verb: str, **more: Any) -> dict[str, Any]:
        self.say(verb=verb, **more)
        return next(line for line in self.told() if "ok" in line)


class Desk:
    """The server with its mailbox and the simulated time."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.path = str(folder / "tsa.sock")
        self.mailbox = Mailbox(2, 2)
        self.mailbox.publish(General(time=self.now, phase=2.0), [(QUARTERS, (0.95, 45.0))] * 2)
        self.peer = Peer(4711, os.getuid(), frozenset())
        self.server = Server(
            listen(self.path, None), self.mailbox, description(Path(self.path), ["knee", "hip"]), lambda: self.now
        )
        self.server._command, self.server._watch = {COMMAND}, {WATCH}
        self._select = self.server._selector.select
        monkeypatch.setattr(self.server._selector, "select", self._look)
        monkeypatch.setattr("tsa_ctrl.ipc.connection.peer_of", lambda connection: self.peer)
        self._talks: list[Talk] = []

    def _look(self, timeout: float) -> list[Any]:
        assert timeout < 1.0, "it would wait, and our time stands still"
        return self._select(timeout)

    def client(self, *groups: int, process: int = 4711) -> Talk:
        """Connect a client of the user who started the daemon, or of another user in these groups."""
        self.peer = Peer(process, 12345 if groups else os.getuid(), frozenset(groups))
        self._talks.append(Talk(self))
        return self._talks[-1]

    def steps(self) -> None:
        for _ in range(30):
            self.server.step(0.0)

    def describe(self, **changes: Any) -> None:
        """Change the server's description of the configuration."""
        self.server._description = msgspec.structs.replace(self.server._description, **changes)

    def fault(self) -> None:
        """Latch a fault in the loop."""
        general = General(time=self.now, phase=float(LoopPhase.FAULTED.value))
        self.mailbox.publish(general, [(QUARTERS, (0.95, 45.0))] * 2)

    def wanted(self) -> tuple[float, float] | None:
        return self.mailbox.wanted(0)

    def said(self) -> str | None:
        """Return the text that the loop would report as an event."""
        found = self.mailbox.told()
        return None if found is None else found[1]

    def close(self) -> None:
        for talk in self._talks:
            talk.socket.close()
        self.server.close()
        self.mailbox.close()


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    made = Desk(tmp_path, monkeypatch)
    made.wanted()  # reads the withdrawal that each new server writes
    yield made
    made.close()


VERBS: dict[str, tuple[dict[str, Any], Role]] = {
    "status": ({}, Role.WATCH),
    "measure": ({}, Role.WATCH),
    "events": ({}, Role.WATCH),
    "set": ({"name": "knee.compensation", "value": 0.5}, Role.COMMAND),
    "setpoint": ({"axis": "knee", "value": 0.1}, Role.COMMAND),
    "lease": ({"seconds": 0.2}, Role.COMMAND),
    "stop": ({}, Role.COMMAND),
    "recover": ({}, Role.OWNER),
}


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("role", Role)
def test_who_may_do_what(desk: Desk, verb: str, role: Role) -> None:
    """A request without permission has no effect, and the error states who has the permission."""
    more, least = VERBS[verb]
    groups = {Role.WATCH: (WATCH,), Role.COMMAND: (COMMAND, WATCH), Role.OWNER: ()}[role]
    desk.fault()
    client = desk.client(*groups)
    client.say(verb=verb, **more)
    refused = [line["error"] for line in client.told() if line.get("ok") is False]
    effects = (desk.mailbox.take(), desk.wanted(), desk.mailbox.stop_requested, desk.said())
    assert bool(refused) is (role < least)
    if refused:
        assert "12345 may only watch here" in refused[0] or "or started the daemon may" in refused[0]
        assert effects == (None, None, False, None)


def test_who_is_in_no_group_is_refused_at_the_door(desk: Desk) -> None:
    stranger = desk.client(99)
    assert stranger.told() == [
        {"ok": False, "error": "user 12345 may not use this socket; see [socket] group and watch_group"}
    ]


@pytest.mark.parametrize("groups", [(WATCH,), (COMMAND,), ()])
def test_connections_of_one_role_leave_the_places_of_the_others(desk: Desk, groups: tuple[int, ...]) -> None:
    first = [desk.client(*other) for other in ((WATCH,), (COMMAND,), ()) if other != groups]
    many = [desk.client(*groups) for _ in range(3 * CLIENTS)]
    assert all(client.ask("status")["ok"] for client in (*first, many[-1]))


def test_the_kernel_says_who_a_peer_is() -> None:
    one, other = socket.socketpair()
    with one, other:
        peer = peer_of(one)
    assert (peer.process, peer.user) == (os.getpid(), os.getuid())
    assert os.getgid() in peer.groups
    assert str(peer).startswith(f"process {os.getpid()} (")
    assert role_of(peer, set(), set()) is Role.OWNER
    assert role_of(Peer(1, 12345, frozenset({1, 2})), {2}, {1}) is Role.COMMAND
    assert role_of(Peer(1, 12345, frozenset({1})), {2}, {1}) is Role.WATCH
    assert role_of(Peer(1, 12345, frozenset({3})), {2}, {1}) is None


@pytest.mark.parametrize(
    ("group", "watch", "mode"), [(None, None, 0o600), (GROUP, None, 0o660), (None, GROUP, 0o660), (GROUP, GROUP, 0o666)]
)
def test_the_socket_file_lets_in_no_more_than_it_must(
    tmp_path: Path, group: str | None, watch: str | None, mode: int
) -> None:
    """A file has only one group. With two groups the file mode permits all users, and the server checks each client."""
    with listen(str(tmp_path / "tsa.sock"), group, watch):
        found = (tmp_path / "tsa.sock").stat()
    assert (stat.S_IMODE(found.st_mode), found.st_gid) == (mode, os.getgid())


@pytest.mark.parametrize("key", ["group", "watch_group"])
def test_a_group_that_is_not_there_is_one_line(tmp_path: Path, key: str) -> None:
    with pytest.raises(UsageError, match=rf"\[socket\] {key} 'no-such': no such group"):
        listen(str(tmp_path / "tsa.sock"), **{"group": None, key: "no-such"})
    assert not (tmp_path / "tsa.sock").exists()


# Lease of the set-point


def test_the_set_point_has_one_owner_whom_a_refusal_names(desk: Desk) -> None:
    owner, other = desk.client(process=4711), desk.client(process=815)
    assert owner.ask("lease", seconds=0.2) == {"ok": True}
    desk.now += 0.15
    for answer in (other.ask("lease", seconds=0.2), other.ask("setpoint", axis="knee", value=0.1)):
        assert "the set-point is held by process 4711" in answer["error"]
        assert "lease of 0.2 s, 0.05 s of it left" in answer["error"]
    assert desk.wanted() is None
    assert owner.ask("status")["lease"] == {
        "process": 4711, "user": os.getuid(), "seconds": 0.2, "left": pytest.approx(0.05)
    }  # fmt: skip


def test_a_value_renews_it_and_silence_ends_it(desk: Desk) -> None:
    """When the lease ends, the holder and the log get the reason, and the set-point is withdrawn.

    Another client can then get the lease.
    """
    owner, other = desk.client(process=4711), desk.client(process=815)
    owner.ask("lease", seconds=0.2)
    assert "process 4711 " in str(desk.said())  # followed by a name if a process with this id exists
    for _ in range(5):
        desk.now += 0.15
        assert owner.ask(**SET_POINT, value=0.5)["ok"]
    assert desk.wanted() == (0.5, desk.now)
    desk.now += 0.201
    assert owner.told() == [{"event": "lease", "held": False, "why": "no set-point came for 0.2 s"}]
    assert desk.wanted() == (0.0, -math.inf)
    assert "no longer holds its lease: no set-point came for 0.2 s" in str(desk.said())
    assert other.ask("status")["lease"] is None
    assert other.ask("lease", seconds=0.2)["ok"]


def test_values_are_confirmed_four_times_in_a_leases_time(desk: Desk) -> None:
    """In a stream of values without answers, the server confirms the newest value four times in each lease time."""
    owner = desk.client()
    owner.ask("lease", seconds=0.2)
    for _ in range(120):
        desk.now += 2e-3
        owner.say(**SET_POINT, value=0.1, time=desk.now, quiet=True)
        desk.steps()
    told = owner.told()
    assert {(line["event"], line["held"]) for line in told} == {("lease", True)}
    assert len(told) == 4  # in 0.24 s; each follows the first value after 0.05 s
    assert told[0]["time"] == pytest.approx(100.05, abs=3e-3)


@pytest.mark.parametrize("quiet", [False, True])
def test_a_time_of_another_clock_or_order_is_refused(desk: Desk, quiet: bool) -> None:
    """A value with an old or future time is rejected. If values have no answers, the rejection comes as an event."""
    owner = desk.client()
    owner.ask("lease", seconds=0.2)
    late = {0.201: "0.201 s ago; allowed is 0.2 s ago to now", -0.101: "0.101 s ahead", -1e9: "ahead", 1e9: "ago"}
    for seconds, words in late.items():
        owner.say(**SET_POINT, value=0.1, time=desk.now - seconds, quiet=quiet)
        told = owner.told()[0]
        assert words in told["error"]
        assert (told.get("event"), told.get("ok")) == (("refused", None) if quiet else (None, False))
    assert desk.wanted() is None
    owner.ask(**SET_POINT, value=0.5, time=desk.now)
    assert "older than the present one" in owner.ask(**SET_POINT, value=0.1, time=desk.now - 1e-3)["error"]
    assert desk.wanted() == (0.5, desk.now)


def measured(desk: Desk, time: float, phase: int = 2, **more: float) -> None:
    desk.mailbox.measure(time, 7, phase, [Reading(**more), Reading()])


@pytest.mark.parametrize("starts", [False, True])
def test_a_loop_that_hangs_is_no_longer_commanded_unless_it_starts(desk: Desk, starts: bool) -> None:
    owner = desk.client()
    owner.ask("lease", seconds=10.0)
    measured(desk, desk.now)
    if starts:
        desk.mailbox.publish_stage(desk.now, "waiting for node 1")
    desk.now += HANGS
    assert owner.told() == []
    desk.now += 0.1
    ended = {"event": "lease", "held": False, "why": "the loop hangs, no cycle for 0.5 s"}
    assert owner.told() == ([] if starts else [ended])


def test_the_end_of_the_daemon_is_told_as_that(desk: Desk) -> None:
    owner = desk.client()
    owner.ask("lease", seconds=10.0)
    measured(desk, desk.now, phase=LoopPhase.STOPPING.value)
    desk.now += 1.0
    assert owner.told() == [{"event": "lease", "held": False, "why": "the daemon has ended"}]


def test_a_value_waits_for_no_more_than_one_request_of_another(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Five other clients have sent 100 requests each. At most one of them is answered before each set-point."""
    asked: list[str] = []
    report = {"schema": 1}
    monkeypatch.setattr("tsa_ctrl.ipc.server.status_report", lambda *_: asked.append("status") or report)
    owner, floods = desk.client(), [desk.client() for _ in range(5)]
    owner.ask("lease", seconds=0.2)
    for flood in floods:
        flood.socket.sendall(b'{"verb":"status"}\n' * 100)
    for _ in range(10):
        owner.say(**SET_POINT, value=0.1, time=desk.now, quiet=True)
        before = len(asked)
        while desk.wanted() is None:
            desk.server.step(0.0)
        assert len(asked) - before <= 1
    for _ in range(600):
        desk.server.step(0.0)
    assert len(asked) == 500  # all requests are answered in the end
