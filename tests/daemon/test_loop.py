"""Test the loop on a fake bus: start, stop, faults, commands and overruns."""

from __future__ import annotations

import itertools
import math
import re
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.daemon.machine import BARE, CONSTANT, ENABLED, Drive, Machine
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.ipc.mailbox import RELEASE, Command
from tsa_ctrl.safety.causes import Cause, Finding

Build = Callable[..., Machine]


@pytest.fixture
def build(tmp_path: Path) -> Iterator[Build]:
    made: list[Machine] = []

    def make(*edits: tuple[str, str]) -> Machine:
        made.append(Machine(tmp_path, *edits))
        return made[-1]

    yield make
    for machine in made:
        machine.close()


def test_enables_delivers_and_descends(build: Build) -> None:
    """Torque is sent only after the transitions to operation enabled. At the end it is 0 and the drive is disabled.

    Each cycle has a record and a measurement for clients. The loop sends its heartbeat every 20 ms.
    """
    machine = build(CONSTANT, BARE)
    seen: list[tuple[float, int, int, float]] = []

    def look() -> None:
        time, cycle, phase, axes = machine.mailbox.measured()
        seen.append((machine.bus.clock.now - time, cycle, phase, axes[0].tau_j_des))

    machine.drive.at_sync.update(dict.fromkeys((400, 401), look))
    machine.run(seconds=0.5)
    commands = machine.drive.commands
    first = next(n for n, (_, torque) in enumerate(commands) if torque)
    assert [word for word, _ in commands[:first]].index(0x0F) > [word for word, _ in commands[:first]].index(0x07)
    assert max(machine.drive.torques) == pytest.approx(400, abs=2)  # 0.5 N*m times r_M/r_J
    assert commands[-1] == (0x06, 0)
    assert machine.drive.statusword != ENABLED
    assert machine.loop.phase is LoopPhase.ENDED
    assert not machine.events.faults

    records = machine.records()
    assert len(records["t"]) == machine.loop.cycles
    assert records["t"][:3] == pytest.approx([0.0, 1e-3, 2e-3], abs=1e-9)
    assert records["tau_j_des"][-400] == 0.5
    assert records["tau_m_cmd"][-400] == pytest.approx(0.4)
    assert records["tau_m"][-400] == pytest.approx(0.4, abs=1e-3)
    assert math.isnan(records["temperature"][0])

    (age, cycle, phase, wanted), (_, after, *_) = seen
    assert 0.0 < age < 1.5e-3
    assert (after, phase, wanted) == (cycle + 1, LoopPhase.RUNNING.value, 0.5)

    beats = [n for n, (can_id, _) in enumerate(machine.bus.sent) if can_id == 0x77F]
    assert len(beats) == pytest.approx(machine.loop.cycles / 20, abs=3)


def test_no_torque_before_all_answers_come(build: Build) -> None:
    """If a node does not answer, the drive is not enabled and the startup ends with a fault."""
    machine = build(CONSTANT)
    machine.drive.silent.add(0x1A0)
    machine.run()
    assert not any(machine.drive.torques)
    assert all(word != 0x0F for word, _ in machine.drive.commands)
    assert machine.events.first_fault is not None


def test_stop_ramps_within_the_stop_time(build: Build) -> None:
    """After a stop, the torque falls monotonically to 0 within stop_time. A second stop does not change the cause."""
    machine = build(CONSTANT)
    machine.drive.at_sync[500] = lambda: machine.loop.stop("SIGTERM")
    machine.drive.at_sync[600] = lambda: machine.loop.stop("SIGINT")
    machine.run()
    torques = machine.drive.torques
    last = max(n for n, torque in enumerate(torques) if torque)
    assert last - 500 == pytest.approx(300, abs=5)
    assert torques[500:] == sorted(torques[500:], reverse=True)
    assert machine.loop.cause == "SIGTERM"


def test_stop_over_the_mailbox(build: Build) -> None:
    """A stop request in the mailbox ends the run with the cause "tsa stop"."""
    machine = build(CONSTANT)
    machine.drive.at_sync[250] = machine.mailbox.request_stop
    machine.run()
    assert machine.loop.cause == "tsa stop"
    assert machine.drive.commands[-1] == (0x06, 0)


def test_stop_before_any_torque_enables_nothing(build: Build) -> None:
    """If the loop is stopped while it settles, the drive is never enabled."""
    machine = build(CONSTANT)
    machine.loop.stop("SIGINT")
    machine.run()
    assert all(word != 0x0F for word, _ in machine.drive.commands)


def silence(machine: Machine) -> None:
    machine.drive.heartbeat = False


def run_away(machine: Machine) -> None:
    """Exceed the motor's speed limit, as with a torn tendon."""
    machine.drive.velocity = round(45.0 * 60.0 / (2.0 * math.pi) * 1e3)  # 45 rad/s in mrpm


@pytest.mark.parametrize(
    ("act", "within", "words"),
    [
        (lambda machine: machine.drive.fail(), 0, "drive fault.*0x2310"),
        (run_away, 0, "over-speed"),
        (lambda machine: setattr(machine.axis.law, "compensation", math.nan), 1, "not finite"),
        (lambda machine: machine.drive.extra.append((0x201, struct.pack("<Hh", 15, 100))), 2, "second master"),
        (lambda machine: machine.drive.extra.append((0x701, b"\x00")), 2, "booted"),
        (silence, 300, "heartbeat lost"),
    ],
    ids=["drive", "over-speed", "not-finite", "second-master", "boot-up", "heartbeat"],
)
def test_a_fault_takes_the_torque_and_stays_latched(
    build: Build, act: Callable[[Machine], None], within: int, words: str
) -> None:
    """The torque command is 0 from the SYNC whose answer shows the fault, or `within` cycles of it.

    Set-point and friction term are reset. No torque remains to be ramped down, so a stop ends the run at once.
    """
    machine = build(CONSTANT)
    machine.drive.at_sync[500] = lambda: act(machine)
    machine.drive.at_sync[1000] = lambda: machine.loop.stop("SIGTERM")
    machine.run()
    assert machine.drive.torques[498] != 0
    assert not any(machine.drive.torques[499 + within :])
    assert re.search(words, str(machine.events.first_fault))
    records = machine.records()
    assert records["tau_j_des"][-1] == records["friction_term"][-1] == 0.0
    assert machine.drive.beats < 1010


def test_fault_ends_the_run_where_so_configured(build: Build) -> None:
    """With after_fault = "exit" the run ends and reports the fault."""
    machine = build(CONSTANT, ('# after_fault = "wait" ', 'after_fault = "exit" '))
    machine.drive.at_sync[400] = machine.drive.fail
    machine.run()
    assert machine.loop.cause is not None
    assert machine.loop.cause.startswith("fault: drive fault")


def test_set_moves_smoothly(build: Build) -> None:
    """A parameter moves to its new value at its configured rate."""
    machine = build(CONSTANT)
    index = machine.names.index("setpoint_gain")
    machine.drive.at_sync[500] = lambda: machine.mailbox.put(Command(0, index, 0.5)) and None
    seen: list[float] = []
    machine.drive.at_sync.update({n: lambda: seen.append(machine.axis.set_point.gain) for n in range(510, 1600, 100)})
    machine.run(seconds=1.7)
    assert seen[0] == pytest.approx(0.995, abs=0.005)
    assert all(0.0 <= a - b <= 0.0501 for a, b in itertools.pairwise(seen))
    assert machine.axis.set_point.gain == 0.5


def test_value_out_of_bounds_in_the_mailbox_is_ignored(build: Build) -> None:
    """The loop itself checks the bounds of a value and ignores an invalid one."""
    machine = build(CONSTANT)
    for value in (math.nan, math.inf, -3.0, 99.0):
        machine.mailbox.put(Command(0, machine.names.index("compensation"), value))
    machine.run(seconds=0.2)
    assert machine.axis.law.compensation == 0.95


def test_flood_of_commands_is_taken_one_per_cycle(build: Build) -> None:
    """The loop takes one command per cycle from a full queue."""
    machine = build(CONSTANT)
    while machine.mailbox.put(Command(0, machine.names.index("slew"), 50.0)) is not None:
        pass
    left: list[bool] = []
    machine.drive.at_sync[64] = lambda: left.append(machine.mailbox.taken(62))
    machine.drive.at_sync[65] = lambda: left.append(machine.mailbox.taken(63))
    machine.run(seconds=0.2)
    assert left == [True, True]


def test_socket_set_point_expires(build: Build) -> None:
    """A value from the socket is active for its timeout. It then falls to 0, and the friction term fades out.

    The torque sensor of this rig reads 0 throughout, so the direction stays while the set-point falls.
    """
    machine = build(('kind = "sine"  ', 'kind = "socket"  '))
    machine.axis.polarity_check.ceiling = math.inf  # polarity cannot be checked on this stiff rig
    machine.drive.at_sync[500] = lambda: machine.mailbox.want(0, 0.5, machine.bus.clock.now)
    machine.run(seconds=1.5)
    torques = machine.drive.torques
    half_loop = 2.0 * 45.0 * 0.020 * math.tanh(0.26)
    assert 400 < torques[690] < 400 + 1e3 * half_loop
    assert (np.diff(torques[720:]) <= 0).all()
    assert max(torques[720:]) < 1e3 * half_loop
    assert max(torques[1100:]) < 10
    assert not any(torques[-100:])


def test_overrun_skips_periods_and_is_counted(build: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wake-up that is three periods late skips three periods and counts as late. The log keeps its time grid.

    The loop passes the number of skipped periods to the axis. Otherwise velocities would be too high.
    """
    machine = build(CONSTANT)
    told: list[int] = []
    monkeypatch.setattr(machine.axis, "skip_cycles", told.append)
    machine.wake_late(300, 3.2e-3)
    machine.run(seconds=0.5)
    assert (machine.loop.skipped, machine.loop.overruns, machine.loop.late, told) == (3, 1, 1, [3])
    steps = [b - a for a, b in itertools.pairwise(machine.records()["cycle"])]
    assert sorted(steps)[-2:] == [1.0, 4.0]


def test_one_missed_answer_does_not_stop(build: Build) -> None:
    """A single missed answer is tolerated: the last values are used again, and the miss is counted."""
    machine = build(CONSTANT)
    machine.drive.at_sync[300] = lambda: machine.drive.silent.add(0x181)
    machine.drive.at_sync[301] = machine.drive.silent.clear
    machine.run(seconds=0.5)
    assert all(machine.drive.torques[250:450])
    assert machine.axis.image.missed == 1
    assert not machine.events.faults


def test_set_point_without_torque_is_forgotten(build: Build) -> None:
    """A set-point that is received while the axis is disabled is discarded at the enable."""
    machine = build(('kind = "sine"  ', 'kind = "socket"  '))
    machine.mailbox.want(0, 0.5, machine.bus.clock.now)
    machine.run(seconds=0.5)
    assert not any(machine.drive.torques)


def test_what_the_socket_tells_of_its_lease_becomes_events_once_a_second(build: Build) -> None:
    """Lease messages come every 10 ms. The first one becomes an event, and then the newest one of each second."""
    machine = build(CONSTANT)
    machine.drive.at_sync.update({n: partial(machine.mailbox.tell, 5.0, f"lease {n}") for n in range(100, 1000, 10)})
    machine.run(seconds=1.2)
    told = [event.text for event in machine.events.all if event.text.startswith("lease")]
    assert len(told) == 2
    assert (told[0], told[-1]) == ("lease 100", "lease 990")


class Disobedient(Drive):
    """A drive that ignores its commands from SYNC 300 on."""

    def _obey(self, controlword: int, target: int) -> None:
        if self.beats < 300:
            super()._obey(controlword, target)


def test_a_drive_that_does_not_obey_is_stopped_by_nmt(tmp_path: Path) -> None:
    """The drive stays enabled after a disable command. The loop repeatedly sends NMT stop to it."""
    machine = Machine(tmp_path, CONSTANT, drive=Disobedient())
    found = Finding(Cause.NOT_FINITE, "a limit")
    machine.drive.at_sync[310] = lambda: machine.axis.supervisor.trip(found, machine.bus.clock.now)
    machine.drive.at_sync[500] = lambda: machine.loop.stop("test")
    machine.run()
    stops = [data for can_id, data in machine.bus.sent if can_id == 0x000]
    machine.close()
    assert len(stops) >= 3
    assert set(stops) == {b"\x02\x01"}


def test_a_latched_guard_is_released_on_request_within_the_budget(build: Build) -> None:
    """A release has no effect before the guard is latched. A second one within two seconds is rejected."""
    machine = build(CONSTANT)
    guard = machine.axis.guard
    released: list[bool] = []

    def ask(latch: bool) -> None:
        guard.latched = latch
        machine.mailbox.put(Command(0, RELEASE, 1.0))

    machine.drive.at_sync.update({300: partial(ask, False), 310: partial(ask, True), 400: partial(ask, True)})
    machine.drive.at_sync.update(dict.fromkeys((320, 410), lambda: released.append(not guard.latched)))
    machine.run(seconds=0.5)
    assert released == [True, False]
    assert [event.text.partition(";")[0] for event in machine.events.all if "latch" in event.text] == [
        "release of the guard's latch number 1 on request",
        "release of the guard's latch rejected: the next one is permitted in 1.91 s",
    ]
