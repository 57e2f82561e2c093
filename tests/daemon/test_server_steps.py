"""Test single steps of the socket server in this process with a simulated clock."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.daemon.serving import QUARTERS
from tests.daemon.test_lease import COMMAND, SET_POINT, Desk, measured
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.ipc import server
from tsa_ctrl.ipc.connection import CLIENTS
from tsa_ctrl.ipc.mailbox import RELEASE, AxisStatus, Command, General
from tsa_ctrl.ipc.protocol import Range

SET = {"verb": "set", "name": "knee.compensation", "value": 0.5}


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """Yield a server whose times are powers of two, so that sums of times are exact."""
    for name, value in (("LOOK", 2.0**-5), ("AHEAD", 2.0**-3), ("IDLE", 32.0)):
        monkeypatch.setattr(server, name, value)
    made = Desk(tmp_path, monkeypatch)
    made.now = 128.0
    made.describe(set_point_timeout=[0.25, 0.25], set_point_limit=[2.0, 1.0])
    made.wanted()
    yield made
    with contextlib.suppress(OSError, ValueError, KeyError, AttributeError, TypeError):  # if the test has closed it
        made.close()


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
    """A new client replaces the one that has been silent longest.

    The holder of the lease and a client with a recent request stay connected.
    """
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
    """A stop acts in spite of many idle connections or half lines, a client with a lease, and a flood of requests."""
    holder = desk.client()
    holder.ask("lease", seconds=10.0)
    for _ in range(4 * CLIENTS):
        desk.client().socket.sendall(half)
    flooding, stopping = desk.client(), desk.client()
    flooding.socket.sendall(b'{"verb":"status"}\n' * 30)
    stopping.say(verb="stop")
    for _ in range(2):  # the first step accepts, the second one reads
        desk.server.step(0.0)
    assert desk.mailbox.stop_requested


def test_a_value_that_is_set_while_the_axis_starts_is_accepted_and_waits(desk: Desk) -> None:
    """The answer comes immediately with the current stage of the startup. The command waits for the loop."""
    client = desk.client()
    desk.mailbox.publish_stage(desk.now, "node 1")
    client.say(**SET)
    (answer,) = client.told()
    assert (answer["ok"], answer["value"], answer["waiting_for"]) == (True, 0.5, "node 1")
    desk.now += 30.0
    assert client.told() == []
    desk.mailbox.publish_stage(desk.now, "")
    assert desk.mailbox.take() == Command(0, 0, 0.5)


def status(desk: Desk, general: General, axis: AxisStatus) -> dict[str, Any]:
    """Publish these values and return the status that a client gets."""
    desk.mailbox.publish(general, [(axis, (0.95, 45.0))] * 2)
    return desk.client().ask("status")


def test_a_value_that_is_not_known_is_null_and_each_has_its_age(desk: Desk) -> None:
    """A drive that has been silent for 25 s has the state null. Loop and joint encoder still have values.

    A loop that hangs has no values but its parameters.
    """
    dead = QUARTERS._replace(drive_age=25.0, joint_age=0.125)
    axis = status(desk, General(time=desk.now, phase=3.0), dead)["axes"][0]
    assert (axis["state"], axis["tau_m"], axis["tau_j_stretch"], axis["tau_j_model"]) == (None, None, None, None)
    assert (axis["q_j"], axis["tau_j_des"], axis["limit_reason"]) == (0.25, 0.25, "none")
    ages = axis["ages"]
    assert (ages["state"], ages["q_j"], ages["tau_j_des"], ages["tau_j_stretch"]) == (25.0, 0.125, 0.0, 25.0)
    axis = status(desk, General(time=desk.now - 5.0, phase=2.0), QUARTERS)["axes"][0]
    assert {axis[name] for name in ("state", "tau_m", "q_j", "tau_j_des", "limit_reason")} == {None}
    assert axis["parameters"]["compensation"]["value"] == 0.95


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


def test_guard_and_compensation_limit_are_objects_of_an_axis(desk: Desk) -> None:
    seen = QUARTERS._replace(
        guard_energy=0.002, guard_latched=1.0, guard_count=3.0, compensation_limit_withdrawn=0.0
    )._replace(compensation_limit_credit=math.nan, compensation_limit_contradicted=1.0)
    axis = status(desk, General(time=desk.now, phase=2.0), seen)["axes"][0]
    assert axis["guard"] == {"latched": True, "energy": 0.002, "back_off": 0.25, "count": 3}
    assert axis["compensation_limit"] == {
        "share": 0.25, "credit": None, "capacity": 0.25, "withdrawn": False, "contradicted": True
    }  # fmt: skip
    assert axis["guard_energy"] == 0.002


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
    member.say(verb="set", name="knee.back_off", value=0.2)  # a member of the command group may lower it
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
def test_its_holder_alone_hears_from_the_next_event_on(desk: Desk, before: tuple[int, ...], new: int) -> None:
    """A client that sends a set-point without a lease hears nothing."""

    def publish(*numbers: int) -> None:
        desk.mailbox.publish_text(msgspec.json.encode([{"number": n, "text": "x"} for n in numbers]))

    if before:
        publish(*before)
    owner = desk.client()
    owner.ask(**SET_POINT, value=0.5)
    desk.now += 0.125
    assert owner.told() == []
    owner.say(verb="lease", seconds=10.0)
    assert owner.told() == [{"ok": True}]
    desk.now += 1.0
    assert owner.told() == []
    publish(*before, new)
    desk.now += 2.0**-6
    assert owner.told() == []  # events were checked less than LOOK ago
    desk.now += 2.0**-6
    assert owner.told() == [{"event": "told", "number": new, "text": "x"}]
    publish(*before, new, new + 1)
    desk.now += 1.0
    assert owner.told() == [{"event": "told", "number": new + 1, "text": "x"}]
