"""The loop step by step: its axes, bus and log are told, so that each of its times and turns is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from tsa_ctrl.bus.settings import SupervisionSettings
from tsa_ctrl.config import ControllerSection
from tsa_ctrl.daemon import loop as module
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.daemon.events import Events
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.ipc.mailbox import RECOVER, RELEASE, Command
from tsa_ctrl.safety.causes import Cause, Fault
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.safety.release import ReleaseBudget
from tsa_ctrl.safety.supervisor import Phase, Request
from tsa_ctrl.system.histogram import BINS

START = 5_000_000_000  # ns
MS = 1_000_000  # ns
STEP = 20_000  # ns that each look at the clock costs
SETTLED = 3  # cycles


class Law:
    """Record the lateness of each cycle, s."""

    def __init__(self) -> None:
        self.told: list[float] = []

    def __setattr__(self, name: str, value: object) -> None:
        if name == "late":
            assert isinstance(value, float)
            self.told.append(value)
        else:
            super().__setattr__(name, value)


class Axis:
    """What the loop sees of one, and what it did with it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.reason = Reason.DISABLED
        self.did: list[object] = []
        self.image = SimpleNamespace(fresh=True)
        self.supervisor = SimpleNamespace(phase=Phase.ENABLED, faults=[], needs_bring_up=False)
        self.limiter = SimpleNamespace(reset=lambda: self.did.append("released"))
        self.guard = SimpleNamespace(count=0, words="took back")
        self.compensation_limit = SimpleNamespace(count=0, words="less friction")
        self.law = Law()
        self.request: object = None
        self.at_rest = self.is_off = True

    def connect(self, source: Callable[[], object]) -> None:
        self.source = source

    def enable(self) -> None:
        self.did.append("enable")

    def stop(self) -> None:
        self.did.append("stop")

    def pass_over(self, periods: int) -> None:
        self.did.append(periods)

    def fault(self, detail: str, time: float = 5.25) -> None:
        self.supervisor.faults = [*self.supervisor.faults, Fault(Cause.STALE_PDO, detail, time)]


class Log:
    """Telemetry and notices: every call, by name."""

    def __init__(self, *given: object) -> None:
        self.given = given
        self.calls: list[tuple[Any, ...]] = []

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *given: self.calls.append((name, *given))

    def of(self, name: str) -> list[tuple[Any, ...]]:
        return [call[1:] for call in self.calls if call[0] == name]


class Bench:
    """A loop of two axes at 1 kHz whose clock is ours; `at` is done after that many cycles."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> None:
        self.now = START
        self.axes = [Axis("knee"), Axis("hip")]
        self.set: list[tuple[object, ...]] = []
        self.at: dict[int, Callable[[], object]] = {}
        self.late: dict[int, int] = {}  # ns by which a wake-up comes late, by cycle
        self.commands: list[Command] = []
        self.mailbox = SimpleNamespace(
            lateness=[0] * BINS, work=[0] * BINS, stop_requested=False, wanted=lambda index: ("wanted", index),
            take=lambda: self.commands.pop(0) if self.commands else None,
        )  # fmt: skip
        self.telemetry = Log()
        self.events = Events()
        self.cycle_calls: list[tuple[Any, ...]] = []
        self.tuners = [self.tuner(0), self.tuner(1)]
        monkeypatch.setattr(module, "Notices", Log)
        monkeypatch.setattr(module, "run_cycle", self.cycle)
        monkeypatch.setattr(module, "follow_up", lambda *given: self.cycle_calls.append(("after", *given)))
        self.rig = SimpleNamespace(wait=self.wait)
        self.waited: list[float] = []
        given = ControllerSection(**{"settle_cycles": SETTLED, **settings})
        self.loop = Loop(
            self.rig, self.axes, self.tuners, self.mailbox, self.telemetry, self.events, given,  # type: ignore[arg-type]
            SupervisionSettings(disable_timeout=0.25, reset_timeout=0.125), self.clock,
        )  # fmt: skip

    def tuner(self, axis: int) -> Any:
        return SimpleNamespace(
            set=lambda *given: self.set.append((axis, *given)), update=lambda: self.set.append((axis, "update"))
        )

    def clock(self) -> int:
        self.now += STEP
        return self.now

    def wait(self, until: float) -> float:
        self.waited.append(until)
        self.now = max(self.now, round(until * 1e9) + self.late.get(len(self.waited), 0))
        return self.now * 1e-9

    def cycle(self, *given: Any) -> None:
        self.cycle_calls.append(("cycle", *given))
        self.at.pop(len(self.waited), lambda: None)()

    def run(self, cycles: int, seconds: float = math.inf, first: LoopPhase = LoopPhase.SETTLING) -> None:
        """Until it ends; it is told to stop in this cycle from now."""
        last = len(self.waited) + cycles
        before = self.at.get(last)

        def stop() -> None:
            if before is not None:
                before()
            self.loop.stop("the test")

        self.at[last] = stop
        self.at[last + 4000] = lambda: pytest.fail("it does not end")
        self.loop.run(seconds, first)

    def texts(self) -> list[tuple[float, str, str, bool]]:
        return [(round(event.t, 9), event.axis, event.text, event.fault) for event in self.events.all]

    def did(self) -> list[list[object]]:
        return [axis.did for axis in self.axes]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_the_first_who_asks_for_the_end_is_its_cause(bench: Bench) -> None:
    bench.mailbox.stop_requested = True
    assert bench.loop.stop_asked == "tsa stop"
    bench.loop.stop("one")
    bench.loop.stop("other")
    assert bench.loop.stop_asked == "one"


def test_cycles_come_on_the_grid_and_are_told(bench: Bench) -> None:
    """Woken 0.02 ms later than planned but for one; a look at the clock after each cycle."""
    bench.late[5] = 100_000
    bench.run(8)
    loop, begin = bench.loop, START + STEP + MS
    assert loop.start == begin * 1e-9
    assert bench.waited[:8] == [(begin + n * MS) * 1e-9 for n in range(8)]
    name, rig, axes, now, until = bench.cycle_calls[0]
    assert (name, rig, axes, now) == ("cycle", bench.rig, bench.axes, begin * 1e-9)
    assert until - now == pytest.approx(0.6e-3)
    assert bench.cycle_calls[1] == ("after", bench.rig, bench.axes, begin * 1e-9)
    assert bench.axes[0].law.told[:6] == pytest.approx([0.0, 0.0, 0.0, 0.0, 100e-6, 0.0])
    records = bench.telemetry.of("record")
    assert [record[1] for record in records[:8]] == list(range(8))
    assert records[3] == pytest.approx((0.003, 3, 0.0, 20e-6))
    assert records[4] == pytest.approx((0.004, 4, 100e-6, 20e-6))
    measured = bench.telemetry.of("measure")
    assert measured[0] == (begin * 1e-9, 0, LoopPhase.SETTLING.value)
    assert measured[4] == (pytest.approx((begin + 4 * MS + 100_000) * 1e-9), 4, LoopPhase.RUNNING.value)
    assert sum(bench.mailbox.lateness) == sum(bench.mailbox.work) == loop.cycles
    assert (bench.mailbox.lateness[20], bench.mailbox.work[4]) == (1, loop.cycles)
    assert (loop.late, loop.skipped, loop.overruns, loop.planned) == (0, 0, 0, loop.cycles)


@pytest.mark.parametrize(("late", "counted"), [(500_000, 0), (500_100, 1)])
def test_later_than_half_a_period_is_late(bench: Bench, late: int, counted: int) -> None:
    bench.late[5] = late
    bench.run(8)
    assert bench.loop.late == counted


def test_periods_that_were_lost_are_told_to_every_axis(bench: Bench) -> None:
    bench.late[5] = 3_200_000
    bench.run(8)
    assert (bench.loop.skipped, bench.loop.overruns, bench.loop.late) == (3, 1, 1)
    assert bench.loop.planned == bench.loop.cycles + 3
    assert [[done for done in axis.did if isinstance(done, int)] for axis in bench.axes] == [[3], [3]]
    assert [record[1] for record in bench.telemetry.of("record")][4:6] == [4, 8]


@pytest.mark.parametrize(("rate", "every"), [(1000.0, 20), (30.0, 1)])
def test_the_status_is_told_fifty_times_a_second_and_its_helpers_looked_after_once(
    monkeypatch: pytest.MonkeyPatch, rate: float, every: int
) -> None:
    """The same number of cycles at any rate between two looks: 50 tellings."""
    bench = Bench(monkeypatch, rate=rate)
    bench.run(101 * every)
    loop, told = bench.loop, bench.telemetry.of("publish")
    period = round(1e9 / rate)
    begin = START + STEP + period
    assert len(told) == loop.cycles // every + 1
    planned, start, counts, phase, *_ = told[0]
    assert (planned, start) == pytest.approx(((begin + (every - 1) * period) * 1e-9, begin * 1e-9))
    assert (counts, phase) == ((every, every, 0, 0), (LoopPhase.SETTLING if every == 1 else LoopPhase.RUNNING).value)
    assert told[-1][3] == LoopPhase.ENDED.value
    looks = (50 * every, 100 * every)
    times = [(n - 1) * period * 1e-9 for n in looks]
    assert bench.telemetry.of("check_log") == [(pytest.approx(t), 2 * n) for t, n in zip(times, looks, strict=True)]
    for name in ("check_sensors", "check_bus", "check_server"):
        assert bench.telemetry.of(name) == [(pytest.approx(t),) for t in times]


def test_what_the_status_counts(bench: Bench) -> None:
    bench.late[5] = 3_200_000
    bench.run(19)
    _, _, counts, *_ = bench.telemetry.of("publish")[-1]
    assert counts == (bench.loop.cycles, bench.loop.cycles + 3, 3, 1)


def test_commands_are_taken_while_it_runs(bench: Bench) -> None:
    bench.at[6] = lambda: bench.commands.append(Command(1, 4, 0.5))
    bench.run(10)
    assert bench.set[2 * 5] == (1, 4, 0.5)
    assert len(bench.set) == 2 * bench.loop.cycles + 1


def test_a_stop_waits_at_most_for_ramp_confirmation_and_2_s(bench: Bench) -> None:
    """0.3 s of ramp, 0.25 s of the drive's confirmation, and 2 s."""
    bench.axes[1].at_rest = False
    bench.run(8)
    assert bench.loop.phase is LoopPhase.ENDED
    assert bench.loop.cycles == pytest.approx(8 + 2550, abs=2)
    assert bench.did() == [["enable", "stop"], ["enable", "stop"]]


@pytest.mark.parametrize("fails", [False, True])
def test_the_time_of_torque_or_fault_ends_a_run(bench: Bench, fails: bool) -> None:
    if fails:
        bench.at[SETTLED + 1] = lambda: bench.axes[0].fault("x")
    bench.run(500, seconds=0.05)
    assert bench.loop.cause == "0.05 s are over"
    assert bench.loop.cycles == pytest.approx(SETTLED + 50, abs=4)


def test_a_start_without_answers_is_given_up_after_3_s(bench: Bench) -> None:
    bench.axes[0].image.fresh = False
    bench.run(3500)
    text = f"the nodes do not answer every SYNC; {Cause.STALE_PDO.remedy}"
    assert bench.loop.cause == text
    assert bench.loop.cycles == pytest.approx(3000 + SETTLED, abs=4)
    assert [event[1:] for event in bench.texts()] == [("", text, True)]


def test_a_reset_that_takes_longer_than_its_time_is_a_fault_again(bench: Bench) -> None:
    """0.125 s of the supervisors' own, and half a second."""
    bench.axes[0].supervisor.phase = Phase.RESETTING
    bench.run(700, first=LoopPhase.RESETTING)
    phases = [phase for *_, phase in bench.telemetry.of("measure")]
    assert phases.index(LoopPhase.FAULTED.value) == pytest.approx(625, abs=2)


def recover(bench: Bench, at: int) -> None:
    bench.at[at] = lambda: bench.commands.append(Command(0, RECOVER, 0.0))


def test_a_recovery_waits_until_every_axis_is_off_resets_and_runs_again(bench: Bench) -> None:
    one, other = bench.axes

    def fails() -> None:
        one.fault("x")
        one.supervisor.phase = Phase.FAULT
        other.is_off = False

    def off() -> None:
        assert bench.loop.phase is LoopPhase.FAULTED
        other.is_off = True

    def reset() -> None:
        assert bench.loop.phase is LoopPhase.RESETTING
        assert [axis.request for axis in bench.axes] == [Request.RESET, Request.DISABLE]
        one.supervisor.phase = other.supervisor.phase = Phase.STANDBY

    bench.at |= {10: fails, 30: off, 35: reset}
    recover(bench, 20)
    bench.run(60)
    assert bench.did() == [["enable", "stop", "released", "enable", "stop"]] * 2
    assert not bench.loop.faulty
    *_, (recovered, failed, _) = bench.telemetry.of("publish")[-1]
    assert (recovered, failed) == (1, 0)
    assert (0.019, "", "recovery number 1 on request", False) in bench.texts()


def test_a_recovery_that_needs_a_bring_up_ends_the_run_and_asks_for_it(bench: Bench) -> None:
    bench.at[10] = lambda: bench.axes[1].fault("x")
    bench.axes[1].supervisor.needs_bring_up = True
    recover(bench, 20)
    bench.run(60)
    assert (bench.loop.recover, bench.loop.phase, bench.loop.cycles) == (True, LoopPhase.FAULTED, 20)


def test_a_guard_is_released_from_a_latch_alone_and_within_the_budget(bench: Bench) -> None:
    released = []
    guard = bench.axes[1].guard
    guard.latched, guard.release = False, lambda: released.append(1)

    def ask(latched: bool) -> None:
        guard.latched = latched
        bench.commands.append(Command(1, RELEASE, 1.0))

    bench.at |= {10: lambda: ask(False), 20: lambda: ask(True), 30: lambda: ask(True)}
    bench.run(40)
    assert released == [1]
    assert [text for _, axis, text, _ in bench.texts() if axis == "hip"] == [
        "release of the guard's latch number 1 on request",
        "release of the guard's latch rejected: the next one is permitted in 1.99 s; find the cause of the fault first",
    ]


def test_the_budget_permits_one_release_in_2_s_and_ten_in_ten_minutes() -> None:
    budget = ReleaseBudget()
    assert [second for second in range(700) if budget.take(float(second))] == [*range(0, 20, 2), *range(600, 620, 2)]


def test_faults_and_what_the_guard_took_back_become_events_once(bench: Bench) -> None:
    def happens() -> None:
        bench.axes[0].fault("one", bench.loop.start + 0.25)
        bench.axes[0].fault("two", bench.loop.start + 0.5)
        bench.axes[1].guard.count = 1
        bench.axes[0].compensation_limit.count = 1

    bench.at[10] = happens
    bench.run(20)
    assert bench.texts() == [
        (0.25, "knee", "stale PDO: one", True), (0.5, "knee", "stale PDO: two", True),
        (0.009, "knee", "less friction", False), (0.009, "hip", "took back", False),
    ]  # fmt: skip
    assert bench.did() == [["enable", "stop", "stop"], ["enable", "stop", "stop"]]


@pytest.mark.parametrize(
    ("after", "at", "says"),
    [
        ("wait", 10, "the test"),
        ("exit", 10, "fault: stale PDO: x"),
        ("exit", 2, f"fault: stale PDO: x; {Cause.STALE_PDO.remedy}"),
        ("wait", 2, f"fault: stale PDO: x; {Cause.STALE_PDO.remedy}"),
    ],
)
def test_a_fault_ends_a_start_and_where_that_is_wanted_a_run(
    monkeypatch: pytest.MonkeyPatch, after: str, at: int, says: str
) -> None:
    bench = Bench(monkeypatch, after_fault=after)
    bench.at[at] = lambda: bench.axes[1].fault("x")
    bench.run(20)
    assert bench.loop.cause == says
    bench.loop.last_words(["knee"])
    ((_, said, unconfirmed),) = bench.telemetry.of("last_words")
    assert (said, unconfirmed) == (says, ["knee"])
