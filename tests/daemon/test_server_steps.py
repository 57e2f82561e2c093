"""The socket server step by step, in this process and in our time: bounds, turns, waiting, and its way in and out."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.daemon.serving import QUARTERS, description
from tests.daemon.test_lease import COMMAND, SET_POINT, WATCH, Desk, measured
from tsa_ctrl.daemon.build import LoopPhase
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
    made.describe(set_point_timeout=[0.25, 0.25], set_point_limit=[2.0, 1.0])
    made.wanted()
    yield made
    with contextlib.suppress(OSError, ValueError, KeyError, AttributeError, TypeError):  # one that a test has closed
        made.close()


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
    assert client.socket.recv(1) == b""
    monkeypatch.setattr(server, "IDLE", 0.25)
    waiting = desk.client()
    waiting.say(**SET)
    desk.steps()
    desk.now += 0.5
    desk.steps()
    desk.mailbox.take()
    assert waiting.told()[0]["ok"]


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


@pytest.mark.parametrize("half", [b"", b'{"verb":'])
def test_stop_acts_whatever_the_other_clients_do(desk: Desk, half: bytes) -> None:
    """Idle connections, half lines, and a lease whose holder sends more than is answered in a step."""
    holder = desk.client()
    holder.ask("lease", seconds=10.0)
    for _ in range(4 * CLIENTS):
        desk.client().socket.sendall(half)
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


def test_a_value_that_is_set_while_the_axis_starts_is_accepted_and_waits(desk: Desk) -> None:
    """The answer names what is waited for, comes at once, and the loop finds the command with its first cycle."""
    client = desk.client()
    desk.mailbox.publish_stage(desk.now, "node 1")
    client.say(**SET)
    (answer,) = client.told()
    assert (answer["ok"], answer["value"], answer["waiting_for"]) == (True, 0.5, "node 1")
    desk.now += 30.0
    assert client.told() == []
    desk.mailbox.publish_stage(desk.now, "")
    assert desk.mailbox.take() == Command(0, 0, 0.5)


def test_a_full_queue_is_told(desk: Desk) -> None:
    while desk.mailbox.put(Command(0, 0, 0.5)) is not None:
        pass
    client = desk.client()
    client.say(**SET)
    assert client.told() == [{"ok": False, "error": "too many commands are waiting; try again"}]


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
    desk.describe(parameters=[GUARD, GUARD])
    general = General(time=desk.now, phase=2.0, releases=4.0, release_next=desk.now + wait)
    desk.mailbox.publish(general, [(QUARTERS._replace(guard_latched=latched), (0.4, 45.0))] * 2)
    assert words in desk.client(*groups).ask("set", name="knee.back_off", value=value)["error"]


def test_a_release_is_a_command_of_its_own(desk: Desk) -> None:
    desk.describe(parameters=[GUARD, GUARD])
    desk.mailbox.publish(General(time=desk.now, phase=2.0), [(QUARTERS._replace(guard_latched=1.0), (0.4, 45.0))] * 2)
    owner, member = desk.client(), desk.client(COMMAND)
    owner.say(verb="set", name="hip.back_off", value=1.0)
    member.say(verb="set", name="knee.back_off", value=0.2)  # lower, which anyone who commands may do
    desk.steps()
    assert [desk.mailbox.take(), desk.mailbox.take()] == [Command(1, RELEASE, 1.0), Command(0, 0, 0.2)]


def test_a_lease_where_no_axis_listens_is_refused(desk: Desk) -> None:
    client = desk.client()
    desk.describe(set_point_limit=[None, None])
    assert client.ask("lease", seconds=1.0)["error"].startswith("lease: no axis takes its set-point from here")
    desk.describe(set_point_limit=[None, 1.0])
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
    measured(desk, desk.now, phase=LoopPhase[phase.upper()].value)
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


def test_every_line_that_is_told_is_json(desk: Desk) -> None:
    client = desk.client()
    client.say(verb="status")
    desk.steps()
    assert all(json.loads(line) for line in client.socket.recv(1 << 16).splitlines())
