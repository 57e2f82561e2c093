"""Test the client for external controllers with a server process. The test takes the place of the loop."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.daemon.serving import PATIENCE, Serving
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.errors import BusError, LeaseLostError, UsageError
from tsa_ctrl.ipc.client import Client, Lease
from tsa_ctrl.ipc.mailbox import Reading

EVENT = {"number": 4, "t": 1.5, "axis": "knee", "text": "heartbeat lost", "fault": True}


def stream(lease: Lease) -> str:
    """Send set-points until the lease is lost, and return the reason."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            lease.send({"knee": 0.1})
        except LeaseLostError as lost:
            assert not lease.held
            return str(lost)
        time.sleep(0.005)
    raise AssertionError("it was not lost")


def test_a_measurement_has_types(serving: Serving) -> None:
    """A measurement contains typed values, and None for a value that is not measured."""
    with Client(serving.path) as client:
        assert client.measure().age is None
        reading = Reading(q_j=0.5, omega_j=-2.0, tau_j=float("nan"), permitted=1.0)
        serving.mailbox.measure(time.monotonic(), 9, 2, [reading, Reading()])
        measured = client.measure()
    assert measured.age is not None
    assert measured.age >= 0.0
    assert (measured.cycle, measured.phase) == (9, "running")
    knee = measured["knee"]
    assert (knee.q_j, knee.omega_j, knee.tau_j, knee.permitted, knee.limit_reason) == (0.5, -2.0, None, True, "none")
    with pytest.raises(KeyError, match="toe"):
        measured["toe"]


def test_values_are_streamed_without_waiting_for_an_answer(serving: Serving) -> None:
    """The client sends more values than any queue can hold. The loop gets the newest one with its time stamp."""
    with Client(serving.path) as client, client.lease() as lease:
        for n in range(1000):
            lease.send({"knee": n * 1e-3}, wanted := time.monotonic())
        client.measure()  # answered after all of the values
        assert serving.mailbox.wanted(0) == (0.999, wanted)
        assert lease.held


def test_a_lease_is_given_back_with_what_was_wanted(serving: Serving) -> None:
    """When its block ends, even by an exception, the lease is released and the set-point is 0.

    Another client can then get the lease immediately.
    """
    with Client(serving.path) as client, Client(serving.path) as other:
        with contextlib.suppress(ZeroDivisionError), client.lease(10.0) as lease:
            lease.send({"knee": 0.5})
            with pytest.raises(UsageError, match=rf"held by process {os.getpid()} \(.*\) of user {os.getuid()}"):
                other.lease()
            raise ZeroDivisionError
        found = serving.mailbox.wanted(0)
        assert found is not None
        assert found[0] == 0.0
        other.lease()
        with pytest.raises(LeaseLostError, match="given back"):
            lease.send({"knee": 0.5})


def test_a_client_that_is_silent_for_too_long_learns_it_at_its_next_value(serving: Serving) -> None:
    with Client(serving.path) as client, client.lease(0.05) as lease:
        lease.send({"knee": 0.1})
        time.sleep(0.2)
        assert "no set-point came for 0.05 s" in stream(lease)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("end", "the daemon has ended"),
        ("SIGKILL", "the daemon closed the connection"),
        ("SIGSTOP", "no value was confirmed for"),
    ],
)
def test_a_daemon_that_goes_or_hangs_ends_the_lease(serving: Serving, how: str, words: str) -> None:
    """The error contains the reason. Other requests on this connection raise a BusError."""
    with Client(serving.path, timeout=0.2) as client, client.lease(0.2) as lease:
        lease.send({"knee": 0.1})
        if how == "end":
            serving.end()
        else:
            os.kill(serving.worker if how == "SIGSTOP" else serving.process.pid, getattr(signal, how))
        assert words in stream(lease)
        with pytest.raises(BusError, match=r"lease is lost|does not answer"):
            client.measure()


def test_a_server_that_reads_no_more_ends_the_lease_at_once_when_its_buffer_is_full(serving: Serving) -> None:
    """A small write still fits into the buffer. The next one ends the lease, and later calls raise the same error."""
    with Client(serving.path) as client, client.lease(10.0) as lease:
        os.kill(serving.worker, signal.SIGSTOP)
        client.stream(b"", 0.05)
        with pytest.raises(LeaseLostError, match="does not read any longer"):
            client.stream(b" " * 10_000_000, 0.05)
        with pytest.raises(LeaseLostError, match="does not read any longer"):
            lease.send({"knee": 0.1})
        with pytest.raises(LeaseLostError, match="does not read any longer"):
            client.measure()


def test_a_late_answer_is_never_taken_for_that_of_another_request(serving: Serving) -> None:
    """A measurement of cycle 1 times out and arrives late. Each later request returns its own, new answer."""
    with Client(serving.path, timeout=0.5) as client:
        serving.mailbox.measure(time.monotonic(), 1, 2, [Reading(), Reading()])
        os.kill(serving.worker, signal.SIGSTOP)
        with pytest.raises(BusError, match="does not answer"):
            client.measure()
        os.kill(serving.worker, signal.SIGCONT)
        time.sleep(0.3)
        serving.mailbox.measure(time.monotonic(), 2, 2, [Reading(), Reading()])
        assert client.measure().cycle == 2
        assert client.events() == []


def test_a_stop_does_not_wait_for_a_late_answer(serving: Serving) -> None:
    """A command waits for the loop, and times out. A stop request reaches the mailbox at once."""
    with Client(serving.path, timeout=0.5) as client:
        with pytest.raises(UsageError, match="no fault is latched, the phase is running"):
            client.recover()
        serving.publish(LoopPhase.FAULTED)
        with pytest.raises(BusError, match="does not answer"):
            client.recover()
        client.stop()
        assert serving.mailbox.stop_requested
    with Client(serving.path) as client, pytest.raises(UsageError, match="did not take the command"):
        client.recover()


def test_after_a_restart_a_new_client_takes_a_new_lease(serving: Serving) -> None:
    """After a restart of the daemon the old lease remains lost, and a new client can get a lease."""
    with Client(serving.path) as client:
        lease = client.lease()
        serving.end()
        stream(lease)
        again = Serving(Path(serving.path), ["knee"])
        with Client(again.path) as other, other.lease() as new:
            new.send({"knee": 0.25})
            other.measure()
            assert (again.mailbox.wanted(0) or (0.0,))[0] == 0.25
        with pytest.raises(LeaseLostError):
            lease.send({"knee": 0.5})
        again.end()


def test_what_is_no_number_is_not_sent(serving: Serving) -> None:
    wrong: dict[str, Any] = {
        "not a finite number": {"knee": float("nan")},
        "send: found a float; give the torques in N": 0.1,
        "send: axis 'knee': found None; give a number": {"knee": None},
    }
    with Client(serving.path) as client, client.lease() as lease:
        for words, values in wrong.items():
            with pytest.raises(UsageError, match=words):
                lease.send(values)
        client.measure()
        assert serving.mailbox.wanted(0) in (None, (0.0, -float("inf")))


def test_a_value_that_is_refused_is_told_at_a_later_one(serving: Serving) -> None:
    """A rejected value raises an error in a later call, and the lease continues."""
    with Client(serving.path) as client, client.lease(10.0) as lease:
        with contextlib.suppress(UsageError):  # raised by the first call after the rejection arrives
            lease.send({"knee": 0.5}, client.clock() - 5.0)
            client.measure()
            lease.send({"knee": 0.5})
            raise AssertionError("it was not refused")
        lease.send({"knee": 0.25})
        client.measure()
        assert (serving.mailbox.wanted(0) or (0.0,))[0] == 0.25


def test_events_come_once_and_do_not_disturb_the_requests_of_the_holder(serving: Serving) -> None:
    with Client(serving.path) as client, client.lease(10.0) as lease:
        assert client.events() == []
        serving.mailbox.publish_text(msgspec.json.encode([EVENT]))
        for _ in range(20):
            lease.send({"knee": 0.1})
            assert client.measure().cycle == 0
            time.sleep(0.005)
        told = [(event.number, event.axis, event.text, event.fault) for event in client.events()]
        assert told == [(4, "knee", "heartbeat lost", True)]
        assert client.events() == []


def test_a_daemon_of_another_version_is_one_line(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    with Client(serving.path) as client:
        monkeypatch.setattr(client, "ask", lambda request: {"cycle": "seven"})
        for asks in (client.measure, client.events):
            with pytest.raises(BusError, match="the daemon is of another version"):
                asks()


def test_cycles_keep_their_grid_and_leave_out_what_has_passed(serving: Serving) -> None:
    """At 200 Hz, the third cycle takes 12 ms. The periods that have passed are skipped."""
    now = [10.0]
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    serving.mailbox.measure(time.monotonic(), 9, 2, [Reading(), Reading()])
    with Client(serving.path, clock=lambda: now[0], sleep=sleep) as client:
        for n, _ in zip(range(5), client.cycles(200.0), strict=False):
            now[0] += 0.012 if n == 2 else 0.001
    assert slept[:4] == pytest.approx([0.004, 0.004, 0.003, 0.004])


def test_cycles_begin_with_the_loops_first_and_have_a_rate_that_it_has(serving: Serving) -> None:
    """The first cycle of the client waits for the first measurement of the loop."""
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 3:
            serving.mailbox.measure(time.monotonic(), 1, 1, [Reading(q_j=0.5), Reading()])

    with Client(serving.path, sleep=sleep) as client:
        assert next(client.cycles(1000.0))["knee"].q_j == 0.5
        assert len(slept) == 3
        for rate in (0.0, -1.0, 1e9, float("nan")):
            with pytest.raises(UsageError, match="allowed is above 0 to 4000"):
                next(client.cycles(rate))
