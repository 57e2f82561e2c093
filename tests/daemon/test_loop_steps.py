"""The loop step by step: its axes, bus and log are told, so that each of its times and turns is known."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from tsa_ctrl.bus.settings import SupervisionSettings
from tsa_ctrl.config import ControllerSection
from tsa_ctrl.daemon import loop as module
from tsa_ctrl.daemon.events import Events
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.daemon.phase import LoopPhase
from tsa_ctrl.ipc.mailbox import RECOVER, RELEASE, Command
from tsa_ctrl.safety.cures import CURES
from tsa_ctrl.safety.release import ReleaseBudget
from tsa_ctrl.safety.supervisor import Cause, Fault, Phase, Request
from tsa_ctrl.system.histogram import BINS

START = 5_000_000_000  # ns
MS = 1_000_000  # ns
STEP = 20_000  # ns that each look at the clock costs
SETTLED = 3  # cycles


class Axis:
    """What the loop sees of one, and what it did with it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.did: list[object] = []
        self.image = SimpleNamespace(fresh=True)
        self.supervisor = SimpleNamespace(phase=Phase.ENABLED, faults=[], needs_bring_up=False)
        self.limiter = SimpleNamespace(reset=lambda: self.did.append("released"))
        self.guard = SimpleNamespace(count=0, words="took back")
        self.compensation_limit = SimpleNamespace(count=0, words="less friction")
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
    """Telemetry, remarks and losses: every call, by name."""

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
        monkeypatch.setattr(module, "Remarks", Log)
        monkeypatch.setattr(module, "Losses", Log)
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

    def judged(self, phase: LoopPhase, ms: float = 1000, since: int = 0, seconds: float = math.inf) -> LoopPhase:
        """The phase after one judgement at `ms` of the log's time, in a phase since `since`."""
        self.loop._start = START
        self.loop._enter(phase, START + since * MS)
        self.loop._judge(START + round(ms * MS), seconds)
        return self.loop.phase

    def texts(self) -> list[tuple[float, str, str, bool]]:
        return [(round(event.t, 9), event.axis, event.text, event.fault) for event in self.events.all]

    def did(self) -> list[list[object]]:
        return [axis.did for axis in self.axes]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_its_times() -> None:
    assert (module.STATUS_RATE, module.SETTLE_TIME, module.RESET_TIME, module.STOP_TIME) == (50.0, 3.0, 0.5, 2.0)


def test_a_loop_that_has_not_begun(bench: Bench) -> None:
    loop = bench.loop
    assert (loop.phase, loop.cause, loop.cycles, loop.late, loop.recover) == (LoopPhase.SETTLING, None, 0, 0, False)
    assert (loop.start, loop.planned, loop.overruns, loop.skipped, loop.stop_began) == (0.0, 0, 0, 0, math.inf)
    assert (loop.stop_asked, loop.events) == (None, bench.events)
    assert [axis.source() for axis in bench.axes] == [("wanted", 0), ("wanted", 1)]
    assert loop._remarks.given == loop._losses.given[:2] == (bench.axes, bench.events)  # type: ignore[attr-defined]
    loop.last_words(["x"])
    assert bench.telemetry.calls == []
    started = Loop(
        bench.rig, bench.axes, bench.tuners, bench.mailbox, bench.telemetry, bench.events,  # type: ignore[arg-type]
        ControllerSection(), SupervisionSettings(),
    )  # fmt: skip
    assert started._clock is time.monotonic_ns


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
    losses, remarks = loop._losses, loop._remarks
    assert losses.of("update") == [(pytest.approx(t), n) for t, n in zip(times, looks, strict=True)]  # type: ignore[attr-defined]
    assert remarks.calls[0] == ("begin",)  # type: ignore[attr-defined]
    assert len(remarks.of("update")) == len(told)  # type: ignore[attr-defined]
    assert remarks.of("update")[0] == (pytest.approx((every - 1) * period * 1e-9),)  # type: ignore[attr-defined]


def test_what_the_status_counts(bench: Bench) -> None:
    bench.late[5] = 3_200_000
    bench.run(19)
    _, _, counts, *_ = bench.telemetry.of("publish")[-1]
    assert counts == (bench.loop.cycles, bench.loop.cycles + 3, 3, 1)


def test_a_run_after_a_bring_up_stays_on_the_grid_and_settles_anew(bench: Bench) -> None:
    bench.run(8)
    begin = round(bench.loop.start * 1e9)
    bench.loop.recover = True
    bench.loop._stop = None
    bench.loop.phase = LoopPhase.ENDED
    bench.now += 12_345_678
    before = len(bench.waited)
    bench.loop._settled = SETTLED
    for axis in bench.axes:
        axis.did.clear()
        axis.supervisor.phase = Phase.RESETTING

    def done() -> None:
        for axis in bench.axes:
            axis.supervisor.phase = Phase.STANDBY

    bench.at[before + 2] = done
    bench.run(10, first=LoopPhase.RESETTING)
    first = round(bench.waited[before] * 1e9)
    assert (first - begin) % MS == 0
    assert 0 < first - (begin + 8 * MS + 12_345_678) < 6 * MS
    assert round(bench.loop.start * 1e9) == begin
    assert bench.did() == [["enable", "stop"], ["enable", "stop"]]
    assert len(bench.loop._remarks.of("begin")) == 1  # type: ignore[attr-defined]
    phases = [phase for *_, phase in bench.telemetry.of("measure")[before:]]
    assert phases[:2] == [LoopPhase.RESETTING.value] * 2
    assert phases[2:5] == [LoopPhase.SETTLING.value] * SETTLED
    assert phases[5] == LoopPhase.RUNNING.value


def test_one_command_a_cycle_and_a_step_of_every_tuner(bench: Bench) -> None:
    bench.commands = [Command(1, 4, 0.5), Command(0, 3, 0.25)]
    bench.loop._take_command(START)
    assert bench.set == [(1, 4, 0.5), (0, "update"), (1, "update")]
    bench.set.clear()
    bench.loop._take_command(START)
    bench.loop._take_command(START)
    assert bench.set == [(0, 3, 0.25), *[(0, "update"), (1, "update")] * 2]


def test_commands_are_taken_while_it_runs(bench: Bench) -> None:
    bench.at[6] = lambda: bench.commands.append(Command(1, 4, 0.5))
    bench.run(10)
    assert bench.set[2 * 5] == (1, 4, 0.5)
    assert len(bench.set) == 2 * bench.loop.cycles + 1


def test_a_stop_ramps_every_axis_once_and_keeps_its_first_cause(bench: Bench) -> None:
    bench.axes[1].at_rest = False
    bench.loop.stop("SIGTERM")
    assert bench.judged(LoopPhase.RUNNING) is LoopPhase.STOPPING
    assert (bench.loop.cause, bench.loop.stop_began) == ("SIGTERM", 1.0)
    bench.loop._judge(START + 1001 * MS, math.inf)
    assert (bench.loop.phase, bench.loop.stop_began, bench.did()) == (LoopPhase.STOPPING, 1.0, [["stop"], ["stop"]])
    bench.axes[1].at_rest = True
    bench.loop._judge(START + 1002 * MS, math.inf)
    assert bench.loop.phase is LoopPhase.ENDED
    bench.loop.cause = "first"
    assert bench.judged(LoopPhase.RUNNING) is LoopPhase.STOPPING
    assert bench.loop.cause == "first"


def test_tsa_stop_is_a_stop(bench: Bench) -> None:
    bench.mailbox.stop_requested = True
    assert bench.judged(LoopPhase.SETTLING) is LoopPhase.STOPPING
    bench.mailbox.stop_requested = False
    assert bench.loop.stop_asked == bench.loop.cause == "tsa stop"


@pytest.mark.parametrize(("rest", "ms", "ends"), [(True, 1, True), (False, 2500, False), (False, 2600, True)])
def test_a_stop_ends_at_rest_or_when_its_time_is_over(bench: Bench, rest: bool, ms: int, ends: bool) -> None:
    """0.3 s of ramp, 0.25 s of the drive's confirmation, and 2 s."""
    bench.axes[0].at_rest = rest
    bench.loop._stop = "x"
    assert bench.judged(LoopPhase.STOPPING, 1000 + ms, 1000) is (LoopPhase.ENDED if ends else LoopPhase.STOPPING)


def test_the_very_time_of_a_stop_is_not_over(bench: Bench) -> None:
    bench.axes[0].at_rest = False
    bench.loop._stop = "x"
    bench.loop._stop_time = 2.5
    assert bench.judged(LoopPhase.STOPPING, 3500, 1000) is LoopPhase.STOPPING


@pytest.mark.parametrize("phase", [LoopPhase.RUNNING, LoopPhase.FAULTED, LoopPhase.SETTLING, LoopPhase.RESETTING])
def test_the_time_of_torque_or_fault_ends_a_run(bench: Bench, phase: LoopPhase) -> None:
    bench.axes[0].image.fresh = False
    bench.axes[0].supervisor.phase = Phase.RESETTING
    bench.judged(phase, 1499, 1000, 0.5)
    assert bench.loop._stop is None
    bench.judged(phase, 1500, 1000, 0.5)
    ends = phase in (LoopPhase.RUNNING, LoopPhase.FAULTED)
    assert bench.loop._stop == ("0.5 s are over" if ends else None)


def test_torque_is_enabled_when_all_answers_came_for_long_enough(bench: Bench) -> None:
    found = []
    bench.loop._enter(LoopPhase.SETTLING, START)
    for n, fresh in enumerate((True, True, False, True, True, True)):
        bench.axes[1].image.fresh = fresh
        bench.loop._judge(START + n * MS, math.inf)
        found.append(bench.loop.phase)
    assert found == [LoopPhase.SETTLING] * 5 + [LoopPhase.RUNNING]
    assert bench.did() == [["enable"], ["enable"]]
    assert bench.loop._ran


@pytest.mark.parametrize(("ms", "given_up"), [(3003, False), (3003.5, True), (2999, False)])
def test_a_start_without_answers_is_given_up_3_s_after_the_cycles_that_it_takes(
    bench: Bench, ms: float, given_up: bool
) -> None:
    bench.axes[0].image.fresh = False
    assert bench.judged(LoopPhase.SETTLING, ms + 500, 500) is LoopPhase.SETTLING
    text = f"the nodes do not answer every SYNC; {CURES['stale PDO']}"
    assert bench.loop._stop == (text if given_up else None)
    assert bench.texts() == ([(pytest.approx((ms + 500) * 1e-3), "", text, True)] if given_up else [])


def test_a_reset_waits_for_every_supervisor_and_begins_anew(bench: Bench) -> None:
    one, other = bench.axes
    one.supervisor.phase, other.supervisor.phase = Phase.STANDBY, Phase.RESETTING
    one.fault("old")
    bench.loop._faults = [1, 0]
    bench.loop._settled = SETTLED
    assert bench.judged(LoopPhase.RESETTING, 1624, 1000) is LoopPhase.RESETTING
    assert one.request is None
    other.supervisor.phase = Phase.STANDBY
    other.supervisor.faults = [1, 2]  # two are known by then
    bench.loop._reset(START + 1100 * MS)
    assert bench.loop.phase is LoopPhase.SETTLING
    assert [axis.request for axis in (one, other)] == [Request.DISABLE, Request.DISABLE]
    assert (bench.loop._faults, bench.loop._settled) == ([1, 2], 0)


@pytest.mark.parametrize(("reset_time", "over"), [(0.625, True), (0.62501, False)])
def test_a_reset_that_takes_too_long_is_a_fault_again(bench: Bench, reset_time: float, over: bool) -> None:
    """0.125 s of the supervisors' own, and half a second."""
    assert bench.loop._reset_time == 0.625
    bench.loop._reset_time = reset_time
    bench.axes[0].supervisor.phase = Phase.RESETTING
    assert bench.judged(LoopPhase.RESETTING, 1625, 1000) is (LoopPhase.FAULTED if over else LoopPhase.RESETTING)


def faulted(bench: Bench, ms: int = 1000) -> None:
    """Latched, and a recovery asked for."""
    bench.loop._start = START
    bench.loop._enter(LoopPhase.FAULTED, START)
    bench.loop._ask_for_recovery(START + ms * MS)


def test_a_recovery_is_asked_for_in_a_fault_alone(bench: Bench) -> None:
    for phase in LoopPhase:
        bench.loop._enter(phase, START)
        bench.commands = [Command(0, RECOVER, 0.0)]
        bench.loop._releases = ReleaseBudget()
        bench.loop._take_command(START + MS)
        assert bench.loop._recovery_asked == (5.001 if phase is LoopPhase.FAULTED else math.inf)
    assert [entry for entry in bench.set if entry[1] != "update"] == []
    bench.loop._enter(LoopPhase.FAULTED, START)
    bench.loop._releases = ReleaseBudget()
    bench.loop._ask_for_recovery(START)
    bench.loop._enter(LoopPhase.FAULTED, START)  # still
    assert bench.loop._recovery_asked == 5.0
    bench.loop._enter(LoopPhase.STOPPING, START)
    assert bench.loop._recovery_asked == math.inf


def test_repeated_recoveries_are_limited_in_rate_and_number(bench: Bench) -> None:
    """Two seconds lie between two of them, and ten fit into ten minutes."""
    asked = []
    for second in range(700):
        bench.loop._enter(LoopPhase.RUNNING, START)
        bench.loop._enter(LoopPhase.FAULTED, START)
        bench.loop._ask_for_recovery(START + 1000 * second * MS)
        if bench.loop._recovery_asked < math.inf:
            asked.append(second)
    assert asked == [*range(0, 20, 2), *range(600, 620, 2)]
    assert "recovery rejected: the next one is permitted in" in bench.texts()[-1][2]


def test_a_guard_is_released_from_a_latch_alone_and_within_the_budget(bench: Bench) -> None:
    released = []
    guard = bench.axes[1].guard
    guard.latched, guard.release = False, lambda: released.append(1)
    for latched in (False, True, True):
        guard.latched = latched
        bench.commands = [Command(1, RELEASE, 1.0)]
        bench.loop._take_command(START)
    assert released == [1]
    assert [text for _, axis, text, _ in bench.texts() if axis == "hip"] == [
        "release of the guard's latch number 1 on request",
        "release of the guard's latch rejected: the next one is permitted in 2 s; find the cause of the fault first",
    ]


def test_a_run_that_ends_after_a_recovery_has_not_failed(bench: Bench) -> None:
    """The fault is over; one that comes later counts again."""
    loop = bench.loop
    loop.faulty = True
    faulted(bench)
    loop._judge(START + 1000 * MS, math.inf)
    loop._enter(LoopPhase.RUNNING, START)
    assert (loop.faulty, loop._recovered, loop._failed) == (False, 1, 0)
    bench.events.add(1.0, "", "over-speed", fault=True)
    loop._fault(START)
    assert loop.faulty


def test_a_recovery_that_ends_in_a_fault_is_counted(bench: Bench) -> None:
    faulted(bench)
    bench.loop._judge(START + 1000 * MS, math.inf)
    bench.loop._enter(LoopPhase.FAULTED, START)
    assert (bench.loop._recovered, bench.loop._failed) == (0, 1)


def test_a_fault_that_nobody_wants_to_recover_from_stays(bench: Bench) -> None:
    bench.loop._start = START
    assert bench.judged(LoopPhase.FAULTED) is LoopPhase.FAULTED
    assert bench.did() == [[], []]


def test_a_recovery_resets_what_is_in_fault(bench: Bench) -> None:
    bench.axes[0].supervisor.phase, bench.axes[1].supervisor.phase = Phase.FAULT, Phase.STANDBY
    faulted(bench)
    bench.loop._judge(START + 1000 * MS, math.inf)
    assert (bench.loop.phase, bench.loop.recover) == (LoopPhase.RESETTING, False)
    assert bench.did() == [["released"], ["released"]]
    assert [axis.request for axis in bench.axes] == [Request.RESET, Request.DISABLE]
    assert bench.loop._recovery_asked == math.inf


def test_a_recovery_that_needs_a_bring_up_asks_for_it(bench: Bench) -> None:
    bench.axes[1].supervisor.needs_bring_up = True
    faulted(bench)
    bench.loop._judge(START + 1000 * MS, math.inf)
    assert (bench.loop.phase, bench.loop.recover, bench.did()) == (LoopPhase.FAULTED, True, [[], []])
    assert bench.loop._recovery_asked == math.inf


@pytest.mark.parametrize(("ms", "begins"), [(10, False), (2499, False), (2500, True)])
def test_a_recovery_waits_until_every_axis_is_off(bench: Bench, ms: int, begins: bool) -> None:
    bench.loop._stop_time = 2.5
    bench.axes[1].is_off = False
    faulted(bench)
    bench.loop._judge(START + (1000 + ms) * MS, math.inf)
    assert bench.loop.phase is (LoopPhase.RESETTING if begins else LoopPhase.FAULTED)
    assert bench.loop._recovery_asked == (math.inf if begins else 6.0)
    bench.axes[1].is_off = True
    bench.loop._judge(START + (1000 + ms) * MS, math.inf)
    assert bench.loop.phase is LoopPhase.RESETTING


def test_faults_and_what_the_guard_took_back_become_events_once(bench: Bench) -> None:
    bench.loop._ran = True
    bench.axes[0].fault("before")
    bench.loop._start = START
    bench.loop._faults = [1, 0]
    bench.axes[0].fault("one", 5.25)
    bench.axes[0].fault("two", 5.5)
    bench.axes[1].guard.count = 1
    for ms in (600, 601):
        bench.loop._note_faults(START + ms * MS)
    assert bench.texts() == [
        (0.25, "knee", "stale PDO: one", True), (0.5, "knee", "stale PDO: two", True), (0.6, "hip", "took back", False),
    ]  # fmt: skip
    assert bench.loop.phase is LoopPhase.FAULTED
    assert bench.loop._stop is None
    assert bench.did() == [["stop"], ["stop"]]
    assert bench.loop._since == pytest.approx(5.6)
    bench.axes[1].guard.count = 2
    bench.loop._note_faults(START + 700 * MS)
    assert bench.texts()[-1] == (0.7, "hip", "took back", False)
    bench.axes[0].compensation_limit.count = 1
    bench.loop._note_faults(START + 800 * MS)
    assert bench.texts()[-1] == (0.8, "knee", "less friction", False)


def test_a_fault_is_met_in_the_cycle_in_which_it_is_there(bench: Bench) -> None:
    bench.loop._ran = True
    bench.axes[1].fault("x")
    assert bench.judged(LoopPhase.RUNNING) is LoopPhase.FAULTED
    assert len(bench.events.faults) == 1


@pytest.mark.parametrize("phase", list(LoopPhase))
def test_a_fault_while_it_stops_or_resets_is_no_other_phase(bench: Bench, phase: LoopPhase) -> None:
    bench.loop._ran = True
    bench.loop._enter(phase, START)
    bench.axes[1].fault("x")
    bench.loop._note_faults(START)
    stays = phase in (LoopPhase.STOPPING, LoopPhase.RESETTING)
    assert bench.loop.phase is (phase if stays else LoopPhase.FAULTED)


@pytest.mark.parametrize(
    ("after", "ran", "says"),
    [
        ("wait", True, None),
        ("exit", True, "fault: stale PDO: x"),
        ("exit", False, f"fault: stale PDO: x; {CURES['stale PDO']}"),
        ("wait", False, f"fault: stale PDO: x; {CURES['stale PDO']}"),
    ],
)
def test_a_fault_ends_a_start_and_where_that_is_wanted_a_run(
    monkeypatch: pytest.MonkeyPatch, after: str, ran: bool, says: str | None
) -> None:
    bench = Bench(monkeypatch, after_fault=after)
    if ran:
        bench.loop._ran = True
    bench.events.add(0.0, "", "something else")
    bench.axes[1].fault("x")
    bench.axes[0].fault("y")
    bench.axes[0].supervisor.faults, bench.axes[1].supervisor.faults = [], bench.axes[1].supervisor.faults
    bench.loop._note_faults(START)
    bench.axes[0].fault("later")
    bench.loop._note_faults(START)
    assert bench.loop._stop == says


def test_what_happens_outside_of_the_cycles_has_the_logs_time(bench: Bench) -> None:
    bench.loop._start = START
    bench.now = START + 250 * MS - STEP
    bench.loop.note("told")
    assert bench.texts() == [(0.25, "", "told", False)]


@pytest.mark.parametrize(("cause", "said"), [(None, "an error"), ("SIGTERM", "SIGTERM")])
def test_the_log_ends_with_why(bench: Bench, cause: str | None, said: str) -> None:
    bench.loop._start = START
    bench.loop.cause = cause
    bench.now = START + 250 * MS - STEP
    bench.loop.last_words(["knee"])
    assert bench.telemetry.of("last_words") == [(0.25, said, ["knee"])]
