"""The socket server step by step, in this process and in our time: bounds, turns, waiting, and its way in and out."""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import runpy
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.daemon.serving import QUARTERS, description
from tests.daemon.test_lease import COMMAND, GROUP, SET_POINT, WATCH, Desk, measured
from tsa_ctrl.daemon.phase import LoopPhase
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc import server
from tsa_ctrl.ipc.listener import CLIENTS, listen
from tsa_ctrl.ipc.mailbox import RECOVER, RELEASE, AxisStatus, Command, General, Mailbox
from tsa_ctrl.ipc.protocol import Range
from tsa_ctrl.ipc.report import status_report
from tsa_ctrl.ipc.server import Server

SET = {"verb": "set", "name": "knee.compensation", "value": 0.5}


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """Whose times are whole powers of two, so that what is equal is so to the last bit."""
    for name, value in (("LOOK", 2.0**-5), ("AHEAD", 2.0**-3), ("IDLE", 32.0)):
        monkeypatch.setattr(server, name, value)
    made = Desk(tmp_path, monkeypatch)
    made.now = 128.0
    made.server._description = msgspec.structs.replace(
        made.server._description, set_point_timeout=[0.25, 0.25], set_point_limit=[2.0, 1.0]
    )
    made.wanted()
    yield made
    with contextlib.suppress(OSError, ValueError, KeyError, AttributeError, TypeError):  # one that a test has closed
        made.close()


def ours(desk: Desk) -> list[Any]:
    """The server's ends of its clients."""
    return list(desk.server._clients.values())


def test_its_times_and_bounds() -> None:
    assert (server.IDLE, server.TICK, server.LOOK, server.ANSWER_TIME) == (30.0, 0.005, 0.02, 1.0)
    assert (server.REST, server.NICE, server.HANGS, server.AHEAD, server.REPLACED) == (2.0, -10, 0.5, 0.1, 1.5)
    assert (server.ENDING, server.READY) == (("stopping", "ended"), b"ready\n")


@pytest.mark.parametrize(("group", "watch"), [(None, None), (GROUP, None), (None, GROUP), (GROUP, GROUP)])
def test_its_groups_are_those_of_the_configuration(tmp_path: Path, group: str | None, watch: str | None) -> None:
    said = msgspec.structs.replace(description(tmp_path / "x", ["knee"]), group=group, watch_group=watch)
    mailbox = Mailbox(1, 2)
    made = Server(listen(str(tmp_path / "x"), None), mailbox, said)
    assert made._command == ({os.getgid()} if group else set())
    assert made._watch == ({os.getgid()} if watch else set())
    assert 0.0 <= made._clock() - time.monotonic() + 1.0 <= 1.0
    made.close()
    mailbox.close()


@pytest.mark.parametrize("key", ["group", "watch_group"])
def test_a_group_that_is_not_there_is_named_by_its_key(tmp_path: Path, key: str) -> None:
    said = msgspec.structs.replace(description(tmp_path / "x", ["knee"]), **{key: "no-such"})
    mailbox = Mailbox(1, 2)
    with listen(str(tmp_path / "x"), None) as listener, pytest.raises(UsageError, match=rf"\[socket\] {key} 'no-such'"):
        Server(listener, mailbox, said)
    mailbox.close()


def test_a_descriptor_that_is_watched_is_told(desk: Desk) -> None:
    read, write = os.pipe()
    desk.server.watch(read)
    client = desk.client()
    client.say(verb="status")
    assert desk.server.step(0.0) == []
    os.write(write, b"x")
    assert desk.server.step(0.0) == [read]
    os.close(read)
    os.close(write)


def test_what_a_client_asks_further_waits_until_what_it_asked_was_looked_at(desk: Desk) -> None:
    owner, other = desk.client(), desk.client()
    owner.ask("lease", seconds=10.0)
    desk.server._rests = desk.now + 2.0**-8
    for _ in range(2):
        other.say(verb="status")
        desk.steps()
        assert [len(client.lines) for client in ours(desk)] == [0, 1]
    desk.server._rests = 0.0
    assert len(other.told()) == 2


def test_who_asks_nothing_for_long_is_let_go_but_not_while_he_waits(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = desk.client()
    desk.now += 32.0
    desk.steps()
    client.say(verb="status")
    assert len(client.told()) == 1
    desk.now += 32.5
    desk.steps()
    assert (client.socket.recv(1), ours(desk), desk.server._turn) == (b"", [], [])
    assert len(desk.server._selector.get_map()) == 1  # the listener
    monkeypatch.setattr(server, "IDLE", 0.25)
    waiting = desk.client()
    waiting.say(**SET)
    desk.steps()
    desk.now += 0.5
    desk.steps()
    assert len(ours(desk)) == 1


def test_who_is_gone_is_forgotten(desk: Desk) -> None:
    client = desk.client()
    (end,) = ours(desk)
    assert not end.socket.getblocking()
    client.socket.close()
    desk.steps()
    assert (ours(desk), desk.server._turn, end.socket.fileno()) == ([], [], -1)
    assert len(desk.server._selector.get_map()) == 1


def test_its_end_closes_everything_and_withdraws_nothing_that_is_not_there(desk: Desk) -> None:
    client = desk.client()
    ours(desk)[0].push({"ok": True})
    listener = desk.server._listener
    desk.server.close()
    assert desk.wanted() is None
    assert (client.socket.recv(99), client.socket.recv(99)) == (b'{"ok":true}\n', b"")
    assert listener.fileno() == -1
    assert desk.server._selector.get_map() is None


def test_for_how_long_it_may_wait(desk: Desk) -> None:
    patience, now = desk.server._patience, desk.now
    assert patience(0.75) == 0.75
    owner = desk.client()
    assert patience(0.75) == 0.75
    (end,) = ours(desk)
    end.pending.append((1, now, {}))
    assert (patience(0.75), patience(0.001)) == (server.TICK, 0.001)
    end.lines.append(b"{}")
    desk.server._rests = now + 0.25
    assert patience(0.75) == 0.0
    end.pending.clear()
    end.lines.clear()
    owner.ask("lease", seconds=0.5)
    assert (patience(0.75), patience(0.01)) == (2.0**-5, 0.01)
    desk.now += 0.484375
    assert patience(0.75) == 0.015625
    desk.now += 1.0
    assert patience(0.75) == 0.0
    end.lines.append(b"{}")
    desk.server._rests = desk.now + 0.25
    assert patience(0.75) == 0.25
    desk.server._rests = desk.now - 1.0
    assert patience(0.75) == 0.0


def test_the_client_that_has_been_silent_longest_makes_room(desk: Desk) -> None:
    """The lease's holder and a client that has just spoken keep their connections."""
    holder, speaker, silent = desk.client(), desk.client(), desk.client()
    holder.ask("lease", seconds=10.0)
    others = [desk.client() for _ in range(CLIENTS - 3)]
    desk.now += 1.0
    assert speaker.ask("status")["ok"]
    newest = desk.client()
    assert "closed because 16 others are open" in silent.told()[0]["error"]
    assert silent.socket.recv(1) == b""
    assert all(client.ask("measure")["ok"] for client in (holder, speaker, newest, *others))
    assert len(ours(desk)) == CLIENTS


@pytest.mark.parametrize("half", [b"", b'{"verb":'])
def test_stop_acts_whatever_the_other_clients_do(desk: Desk, half: bytes) -> None:
    """Idle connections, half lines, and a lease whose holder sends more than is answered in a step."""
    holder = desk.client()
    holder.ask("lease", seconds=10.0)
    for _ in range(4 * CLIENTS):
        desk.client().socket.sendall(half)
    desk.server._rests = desk.now + 5.0
    stopping = desk.client()
    stopping.say(verb="stop")
    desk.steps()
    assert desk.mailbox.stop_requested


def test_stop_comes_before_the_requests_of_others(desk: Desk) -> None:
    flooding, stopping = desk.client(), desk.client()
    flooding.socket.sendall(b'{"verb":"status"}\n' * 30)
    stopping.say(verb="stop")
    for _ in range(2):  # one accepts, the other reads
        desk.server.step(0.0)
    assert desk.mailbox.stop_requested


def test_who_is_refused_is_closed(desk: Desk) -> None:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        desk.client(99)
        gc.collect()
    assert told == []


def test_each_has_one_request_in_turn(desk: Desk) -> None:
    first, second = desk.client(), desk.client()
    first.socket.sendall(b'{"verb":"measure"}\n' * 2)
    second.say(verb="measure")
    waiting = []
    for _ in range(3):
        desk.server.step(0.0)
        waiting.append([len(client.lines) for client in ours(desk)])
    assert waiting == [[1, 1], [1, 0], [0, 0]]


def test_others_wait_for_twice_what_one_of_them_took(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """While somebody gives set-points; one request of one client at a time."""

    def slow(*given: object) -> dict[str, object]:
        desk.now += 2.0**-8
        return {}

    monkeypatch.setattr(server, "status_report", slow)
    owner, first, second = desk.client(), desk.client(), desk.client()
    for other in (first, second):
        other.say(verb="status")
    desk.server.step(0.0)
    assert [len(client.lines) for client in ours(desk)] == [0, 0, 1]
    desk.server.step(0.0)  # nobody gives set-points: at once
    assert [len(client.lines) for client in ours(desk)] == [0, 0, 0]
    assert desk.server._rests == desk.now + 2.0**-7
    desk.now += 4.0
    owner.ask("lease", seconds=10.0)
    first.say(verb="status")
    desk.server.step(0.0)
    assert desk.server._rests == desk.now + 2.0**-7
    second.say(verb="status")
    for waits in (1, 1, 0):
        desk.steps()
        assert len(ours(desk)[2].lines) == waits
        desk.now += 2.0**-8


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"{}", "not a request: "),
        (b"\xff", "not a request: "),
        (b'{"x":' + b"[" * 4000, "not a request: nested too deeply; one flat object per line"),
        (b'{"verb":"setpoint","axis":"toe","value":1.0}', "no axis 'toe'"),
    ],
)
def test_what_is_no_request_is_refused_once(desk: Desk, line: bytes, words: str) -> None:
    client = desk.client()
    client.socket.sendall(line + b"\n")
    (told,) = client.told()
    assert (told["ok"], told["error"].startswith(words)) == (False, True)
    assert client.ask("measure")["ok"]


def test_a_command_is_answered_when_the_loop_has_taken_it(desk: Desk) -> None:
    client = desk.client()
    client.say(**SET)
    assert client.told() == []
    desk.now += 1.0
    assert client.told() == []
    assert desk.mailbox.take() == Command(0, 0, 0.5)
    answer = client.told()
    assert answer == [{"ok": True, "axis": "knee", "name": "compensation", "unit": "1", "before": 0.95, "value": 0.5}]
    assert client.told() == []


def test_a_command_that_the_loop_does_not_take_is_refused_after_a_second(desk: Desk) -> None:
    client = desk.client()
    client.say(**SET)
    desk.steps()
    desk.now += 1.0
    assert client.told() == []
    desk.now += 2.0**-10
    assert client.told() == [{"ok": False, "error": "the loop did not take the command within 1 s"}]
    assert client.told() == []


def test_a_full_queue_is_told(desk: Desk) -> None:
    while desk.mailbox.put(Command(0, 0, 0.5)) is not None:
        pass
    client = desk.client()
    client.say(**SET)
    assert client.told() == [{"ok": False, "error": "too many commands are waiting; try again"}]
    assert ours(desk)[0].pending == []


def test_who_stops_is_told_what_is_waited_for(desk: Desk) -> None:
    client = desk.client()
    assert client.ask("stop") == {"ok": True, "waiting_for": None}
    assert desk.mailbox.stop_requested
    desk.mailbox.publish_stage(desk.now, "node 1")
    assert client.ask("stop") == {"ok": True, "waiting_for": "node 1"}


def test_a_recovery_is_its_own_command_and_of_whom_the_set_point_listens_to(desk: Desk) -> None:
    owner, member, other = desk.client(), desk.client(COMMAND), desk.client(COMMAND)
    desk.fault()
    owner.say(verb="recover")
    desk.steps()
    assert desk.mailbox.take() == Command(0, RECOVER, 0.0)
    assert member.ask(**SET_POINT, value=0.5)["ok"]  # which is no lease
    for one in (member, other):
        assert one.ask("recover")["error"].startswith("recover: only who holds the set-point's lease or started")
    member.ask("lease", seconds=1.0)
    assert not other.ask("recover")["ok"]
    member.say(verb="recover")
    assert member.told() == []
    assert desk.mailbox.take() == Command(0, RECOVER, 0.0)
    assert member.told() == [{"ok": True}]


def status(desk: Desk, general: General, axis: AxisStatus) -> dict[str, Any]:
    """The status that a client gets of these values."""
    desk.mailbox.publish(general, [(axis, (0.95, 45.0))] * 2)
    return desk.client().ask("status")


def test_a_value_that_is_not_known_is_null_and_each_has_its_age(desk: Desk) -> None:
    """A drive that has been silent for 25 s has no state, while the loop and the joint encoder still have values."""
    dead = QUARTERS._replace(drive_age=25.0, joint_age=0.125)
    axis = status(desk, General(time=desk.now, phase=3.0), dead)["axes"][0]
    assert (axis["state"], axis["tau_m"], axis["tau_j_stretch"], axis["tau_j_model"]) == (None, None, None, None)
    assert (axis["q_j"], axis["tau_j_des"], axis["limit_reason"]) == (0.25, 0.25, "none")
    ages = axis["ages"]
    assert (ages["state"], ages["q_j"], ages["tau_j_des"], ages["tau_j_stretch"]) == (25.0, 0.125, 0.0, 25.0)


def test_a_loop_that_hangs_has_no_values_but_its_parameters(desk: Desk) -> None:
    axis = status(desk, General(time=desk.now - 5.0, phase=2.0), QUARTERS)["axes"][0]
    assert {axis[name] for name in ("state", "tau_m", "q_j", "tau_j_des", "limit_reason")} == {None}
    assert axis["parameters"]["compensation"]["value"] == 0.95


def test_before_the_first_cycle_nothing_is_known(tmp_path: Path) -> None:
    mailbox = Mailbox(1, 2)
    found = status_report(mailbox, description(tmp_path / "x", ["knee"]), 100.0)
    (axis,) = found["axes"]
    assert found["uptime"] is None
    assert {axis[name] for name in ("state", "tau_j", "tau_m", "omega_j", "missed", "estimate_state")} == {None}
    assert {figures["value"] for figures in axis["parameters"].values()} == {None}
    mailbox.close()


def test_a_fault_before_the_last_recovery_is_an_event_without_a_remedy_to_follow(desk: Desk) -> None:
    told = [{"number": n, "t": 1.0, "axis": "", "text": "stale PDO", "fault": True} for n in (0, 7)]
    desk.mailbox.publish_text(msgspec.json.encode(told))
    found = status(desk, General(time=desk.now, phase=2.0, first_fault=5.0, recovered=1.0), QUARTERS)
    assert [event["number"] for event in found["faults"]] == [7]
    assert [event["number"] for event in found["events"]] == [0]
    assert found["recovery"]["done"] == 1


def test_a_recovery_without_a_fault_is_rejected_with_the_phase(desk: Desk) -> None:
    answer = desk.client().ask("recover")
    assert answer["error"] == "recover: no fault is latched, the phase is running; nothing to do"
    desk.fault()
    measured(desk, desk.now, LoopPhase.RESETTING.value)  # newer than the status
    assert "the phase is resetting" in desk.client().ask("recover")["error"]


GUARD = [Range("back_off", "1", 0.0, 1.0, "of the guard", True), Range("pretension", "N", None, None, "T_p0")]


@pytest.mark.parametrize(
    ("groups", "latched", "value", "wait", "words"),
    [
        ((COMMAND,), 1.0, 1.0, 0.0, "only root and the user who started the daemon"),
        ((), 0.0, 1.0, 0.0, "the guard is not latched"),
        ((), 1.0, 0.6, 0.0, "back_off 0.6 is above 0.4"),
        ((), 1.0, 1.0, 1.5, "4 releases were made; the next one is permitted in 1.5 s"),
    ],
)
def test_a_latch_is_released_by_its_owner_alone_and_not_too_often(
    desk: Desk, groups: tuple[int, ...], latched: float, value: float, wait: float, words: str
) -> None:
    desk.server._description = msgspec.structs.replace(desk.server._description, parameters=[GUARD, GUARD])
    general = General(time=desk.now, phase=2.0, releases=4.0, release_next=desk.now + wait)
    desk.mailbox.publish(general, [(QUARTERS._replace(guard_latched=latched), (0.4, 45.0))] * 2)
    assert words in desk.client(*groups).ask("set", name="knee.back_off", value=value)["error"]


def test_a_release_is_a_command_of_its_own(desk: Desk) -> None:
    desk.server._description = msgspec.structs.replace(desk.server._description, parameters=[GUARD, GUARD])
    desk.mailbox.publish(General(time=desk.now, phase=2.0), [(QUARTERS._replace(guard_latched=1.0), (0.4, 45.0))] * 2)
    owner, member = desk.client(), desk.client(COMMAND)
    owner.say(verb="set", name="hip.back_off", value=1.0)
    member.say(verb="set", name="knee.back_off", value=0.2)  # lower, which anyone who commands may do
    desk.steps()
    assert [desk.mailbox.take(), desk.mailbox.take()] == [Command(1, RELEASE, 1.0), Command(0, 0, 0.2)]


def test_a_lease_where_no_axis_listens_is_refused(desk: Desk) -> None:
    client = desk.client()
    of = desk.server._description
    desk.server._description = msgspec.structs.replace(of, set_point_limit=[None, None])
    assert client.ask("lease", seconds=1.0)["error"].startswith("lease: no axis takes its set-point from here")
    desk.server._description = msgspec.structs.replace(of, set_point_limit=[None, 1.0])
    assert client.ask("lease", seconds=1.0)["ok"]
    assert client.ask(**SET_POINT, value=0.1)["error"].startswith("axis 'knee': its set-point does not come over")


@pytest.mark.parametrize(("before", "new"), [((), 0), ((0,), 1), ((2, 5), 6)])
def test_its_holder_hears_from_the_next_event_on(desk: Desk, before: tuple[int, ...], new: int) -> None:
    def publish(*numbers: int) -> None:
        desk.mailbox.publish_text(msgspec.json.encode([{"number": n, "text": "x"} for n in numbers]))

    if before:
        publish(*before)
    owner = desk.client()
    owner.say(verb="lease", seconds=10.0)
    assert owner.told() == [{"ok": True}]
    desk.now += 1.0
    assert owner.told() == []
    publish(*before, new)
    desk.now += 2.0**-6
    assert owner.told() == []  # looked at a moment ago
    desk.now += 2.0**-6
    assert owner.told() == [{"event": "told", "number": new, "text": "x"}]
    publish(*before, new, new + 1)
    desk.now += 1.0
    assert owner.told() == [{"event": "told", "number": new + 1, "text": "x"}]


def test_the_very_first_event_is_heard(desk: Desk) -> None:
    """There was none before it, and it is looked at as soon as there is one."""
    owner = desk.client()
    owner.ask("lease", seconds=10.0)
    desk.mailbox.publish_text(b'[{"number": 0, "text": "x"}]')
    desk.now += 1.0
    assert owner.told() == [{"event": "told", "number": 0, "text": "x"}]


def test_who_never_asked_for_a_lease_hears_nothing(desk: Desk) -> None:
    owner = desk.client()
    owner.ask(**SET_POINT, value=0.5)
    desk.mailbox.publish_text(b'[{"number": 0, "text": "x"}]')
    desk.now += 0.125
    assert owner.told() == []


@pytest.mark.parametrize(("late", "taken"), [(0.25, True), (0.2501, False), (-0.125, True), (-0.1251, False)])
def test_a_value_counts_from_its_time_to_its_time_out(desk: Desk, late: float, taken: bool) -> None:
    owner = desk.client()
    assert owner.ask(**SET_POINT, value=0.5, time=desk.now - late)["ok"] is taken
    assert desk.wanted() == ((0.5, desk.now - late) if taken else None)


def test_values_of_each_axis_are_its_own(desk: Desk) -> None:
    owner = desk.client()
    owner.ask(**SET_POINT, value=2.0, time=128.0)
    assert owner.ask("setpoint", axis="hip", value=-1.0, time=127.9375)["ok"]
    assert (desk.mailbox.wanted(0), desk.mailbox.wanted(1)) == ((2.0, 128.0), (-1.0, 127.9375))
    assert owner.ask("setpoint", axis="hip", value=1.5) == {"ok": True, "axis": "hip", "clamped": 1.0}
    assert owner.ask(**SET_POINT, value=-2.5) == {"ok": True, "axis": "knee", "clamped": -2.0}
    assert owner.ask(**SET_POINT, value=1.0, time=128.0)["ok"]  # of the same time
    assert "before the one that is there" in owner.ask(**SET_POINT, value=0.5, time=127.9375)["error"]
    owner.ask("release")
    assert owner.ask(**SET_POINT, value=0.5, time=127.9375)["ok"]  # nothing is there any more


def test_a_value_without_a_lease_holds_for_its_time_out(desk: Desk) -> None:
    owner, other = desk.client(), desk.client()
    owner.ask(**SET_POINT, value=0.5)
    assert other.ask("status")["lease"]["seconds"] == 0.25
    desk.now += 0.25
    assert not other.ask(**SET_POINT, value=0.5)["ok"]
    desk.now += 0.125
    assert other.ask(**SET_POINT, value=0.5)["ok"]


def test_values_are_confirmed_by_their_time(desk: Desk) -> None:
    owner = desk.client()
    owner.ask("lease", seconds=1.0)
    desk.now += 0.5
    owner.say(**SET_POINT, value=0.1, time=desk.now - 0.125, quiet=True)
    assert owner.told() == [{"event": "lease", "held": True, "time": desk.now - 0.125}]


@pytest.mark.parametrize(("phase", "why"), [("stopping", "the daemon has ended"), ("ended", "the daemon has ended"),
                                            ("running", "the loop hangs, there was no cycle for 0.5 s")])  # fmt: skip
def test_a_loop_without_cycles_is_followed_no_longer(desk: Desk, phase: str, why: str) -> None:
    owner = desk.client()
    owner.ask("lease", seconds=10.0)
    measured(desk, desk.now, phase=desk.server._description.phases.index(phase))
    desk.now += 0.5
    assert owner.told() == []
    desk.now += 0.0625
    assert owner.told() == [{"event": "lease", "held": False, "why": why}]
    assert desk.said() is not None


def test_who_watches_may_only_watch(desk: Desk) -> None:
    watcher = desk.client(WATCH)
    for verb, more in (("stop", {}), ("lease", {"seconds": 1.0}), ("setpoint", {"axis": "knee", "value": 0.1})):
        assert watcher.ask(verb, **more)["error"].startswith(f"{verb}: user 12345 may only watch here")


# The process


class Streams:
    """What `main` and `serve` are given, and what they did with it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, asked: bytes) -> None:
        self.read, self.write = os.pipe()
        self.did: list[Any] = []
        monkeypatch.setattr(sys, "stdin", self)
        monkeypatch.setattr(sys, "stdout", self)
        self.buffer = io.BytesIO(asked)
        monkeypatch.setattr(os, "setpriority", self._refuse)

    def fileno(self) -> int:
        return self.write

    def _refuse(self, *given: int) -> None:
        self.did.append(("priority", *given))
        raise PermissionError

    def said(self) -> bytes:
        os.close(self.write)
        with os.fdopen(self.read, "rb") as end:
            return end.read()


class Box:
    """In a mailbox' place."""

    made: list[tuple[object, ...]]

    def __init__(self, *given: object) -> None:
        self.given = given
        self.heard = 7.0

    def alive(self) -> None:
        pass

    def replace(self, count: int) -> None:
        pass


ASKED = msgspec.json.encode(description(Path("/x/tsa.sock"), ["knee"])) + b"\n"
PRIORITY = ("priority", os.PRIO_PROCESS, 0, -10)


def prepared(monkeypatch: pytest.MonkeyPatch, asked: bytes) -> Streams:
    streams = Streams(monkeypatch, asked)

    @contextlib.contextmanager
    def listening(*given: object) -> Iterator[str]:
        streams.did.append(given)
        yield "listener"

    def keep(work: Callable[[int], int], alive: Any, heard: Callable[[], float], hangs: float, replaced: Any) -> int:
        streams.did.append((work(0), work(1), alive.__name__, heard(), hangs, replaced.__name__))
        return 5

    def serve(listener: str, mailbox: Box, said: Any, told: bool) -> int:
        streams.did.append((listener, mailbox.given, said.axes, told))
        return 3

    monkeypatch.setattr(server, "ignore", lambda *numbers: streams.did.append(numbers))
    for name, value in (("listening", listening), ("keep", keep), ("serve", serve), ("Mailbox", Box)):
        monkeypatch.setattr(server, name, value)
    monkeypatch.setattr(os, "dup", lambda number: number + 100)
    return streams


def test_who_is_gone_before_it_asked_is_served_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = prepared(monkeypatch, b"")
    assert server.main(["7"]) == 0
    assert streams.did == [(signal.SIGINT, signal.SIGTERM, signal.SIGHUP), PRIORITY]
    assert streams.said() == b""


def test_it_is_ready_when_it_listens_and_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = prepared(monkeypatch, ASKED)
    assert server.main(["7"]) == 5
    assert streams.did[2:] == [
        ("/x/tsa.sock", None, None),
        ("listener", (1, 2, 107), ["knee"], False),
        ("listener", (1, 2, 107), ["knee"], True),
        (3, 3, "alive", 7.0, 1.5, "replace"),
    ]
    assert streams.said() == b"ready\n"


def test_who_no_longer_hears_that_it_is_ready_is_gone_by_stdin(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = prepared(monkeypatch, ASKED)
    os.close(streams.read)
    assert server.main(["7"]) == 5
    os.close(streams.write)


def test_what_cannot_be_listened_on_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = prepared(monkeypatch, ASKED)

    def refuses(*given: object) -> None:
        raise UsageError("another daemon answers there")

    monkeypatch.setattr(server, "listening", refuses)
    assert server.main(["7"]) == UsageError.exit_code
    assert streams.said() == b"another daemon answers there\n"


@pytest.mark.parametrize("fails", [False, True])
def test_it_serves_until_the_daemons_end_closes(monkeypatch: pytest.MonkeyPatch, fails: bool) -> None:
    streams = Streams(monkeypatch, b"")
    did, real = streams.did, server.serve

    class Stub:
        def __init__(self, *given: object) -> None:
            did.append(("server", *given))
            self.steps = 0

        def watch(self, descriptor: int) -> None:
            did.append(("watch", descriptor == streams.write))

        def step(self, timeout: float) -> list[int]:
            self.steps += 1
            did.append(timeout)
            if fails:
                raise UsageError("x")
            return [streams.write] if self.steps == 3 else [-1]

        def close(self) -> None:
            did.append("close")

        def alive(self) -> None:
            did.append("alive")

        def update(self) -> None:
            did.append("update")

        def finish(self, seconds: float) -> None:
            did.append(("finish", seconds))

    monkeypatch.setattr(server, "Server", Stub)
    monkeypatch.setattr(server, "EventPrinter", Stub)
    mailbox = Stub("mailbox")
    did.clear()
    begin = [("server", "listener", mailbox, "said"), ("watch", True), ("server", mailbox, True)]
    if fails:
        with pytest.raises(UsageError):
            real("listener", mailbox, "said", True)  # type: ignore[arg-type]
        assert did == [*begin, 0.2, "close"]
    else:
        assert real("listener", mailbox, "said", True) == 0  # type: ignore[arg-type]
        cycle = [0.2, "alive", "update"]
        assert did == [*begin, *cycle, *cycle, 0.2, "update", ("finish", 0.5), "close"]
    streams.said()


def test_as_a_program_it_takes_the_descriptor_and_gives_its_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = prepared(monkeypatch, ASKED)
    for name, where in (
        ("ignore", "tsa_ctrl.system.signals"), ("keep", "tsa_ctrl.system.keeper"),
        ("listening", "tsa_ctrl.ipc.listener"),
    ):  # fmt: skip
        monkeypatch.setattr(f"{where}.{name}", getattr(server, name))
    given: list[tuple[object, ...]] = []
    monkeypatch.setattr("tsa_ctrl.ipc.mailbox.Mailbox", lambda *more: given.append(more) or Box())  # type: ignore[func-returns-value]
    monkeypatch.setattr("tsa_ctrl.system.keeper.keep", lambda *more: 5)
    monkeypatch.setattr(sys, "argv", ["server", "7", "8"])
    monkeypatch.delitem(sys.modules, "tsa_ctrl.ipc.server")
    with pytest.raises(SystemExit) as end:
        runpy.run_module("tsa_ctrl.ipc.server", run_name="__main__")
    assert end.value.code == 5
    assert given == [(1, 2, 7)]
    assert streams.said() == b"ready\n"


def test_every_line_that_is_told_is_json(desk: Desk) -> None:
    client = desk.client()
    client.say(verb="status")
    desk.steps()
    assert all(json.loads(line) for line in client.socket.recv(1 << 16).splitlines())
