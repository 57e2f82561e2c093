"""Supervision: each duty separately. `test_supervisor_model` tests all of them in random order."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from typing import Any

import pytest

from tsa_ctrl.bus.canopen.cia301 import Emcy, NmtState
from tsa_ctrl.bus.canopen.cia402 import Controlword, PowerState
from tsa_ctrl.bus.live.image import Image, NodeHealth
from tsa_ctrl.bus.settings import Role, SupervisionSettings
from tsa_ctrl.bus.wire.bus import BusFault
from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.safety.supervisor import Phase, Request, Supervisor

WORDS = {
    PowerState.SWITCH_ON_DISABLED: 0x0250,
    PowerState.READY_TO_SWITCH_ON: 0x0231,
    PowerState.SWITCHED_ON: 0x0233,
    PowerState.OPERATION_ENABLED: 0x1237,
    PowerState.FAULT: 0x0218,
}


class Bench:
    """A supervisor, an image, and a drive that obeys each controlword in the next cycle.

    `words` are the statuswords of the drive by its state. The supervisor receives `arguments`.
    """

    def __init__(self, settings: SupervisionSettings | None = None, **arguments: Any) -> None:
        shown = {"reports_following": True, "shows_late": False, "rate": 1000.0}
        self.supervisor = Supervisor(settings or SupervisionSettings(), **(shown | arguments))
        self.image = Image(
            (NodeHealth(Role.DRIVE, 1, 0.2), NodeHealth(Role.ENCODER, 32, 0.2), NodeHealth(Role.TORQUE_SENSOR, 64, 0.2))
        )
        self.image.fresh = True
        self.image.mode = 10
        self.state = PowerState.SWITCH_ON_DISABLED
        self.words = dict(WORDS)
        self.obeys = True
        self.now = 0.0
        self.controlword = self.obeyed = Controlword.DISABLE_VOLTAGE
        self.permitted = False

    def step(self, request: Request, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.now += 1e-3
            self.image.now = self.now
            self.image.statusword = self.words[self.state]
            self.controlword, self.permitted, _ = self.supervisor.update(self.image, self.now, request)
            if self.obeys:
                self.obey()

    def obey(self) -> None:
        before, self.obeyed = self.obeyed, self.controlword
        word = self.controlword
        if self.state is PowerState.FAULT:
            if word & 0x80 and not before & 0x80:
                self.state = PowerState.SWITCH_ON_DISABLED
        elif word == Controlword.DISABLE_VOLTAGE:
            self.state = PowerState.SWITCH_ON_DISABLED
        elif word == Controlword.SHUTDOWN:
            self.state = PowerState.READY_TO_SWITCH_ON
        elif word == Controlword.SWITCH_ON and self.state is PowerState.READY_TO_SWITCH_ON:
            self.state = PowerState.SWITCHED_ON
        elif word == Controlword.ENABLE_OPERATION and self.state is PowerState.SWITCHED_ON:
            self.state = PowerState.OPERATION_ENABLED

    def emergency(self, node: int = 0, code: int = 0x2310) -> None:
        health = self.image.nodes[node]
        health.emcy = Emcy(code, 1, bytes(5))
        health.emcys += 1
        self.image.events += 1

    def heal(self) -> None:
        """Remove the cause of a fault but not its consequences."""
        image = self.image
        image.bus_fault = image.intruder = image.altered = image.pressed = image.silent = None
        image.misses = image.drops = 0
        image.fresh, image.mode = True, 10
        self.words = dict(WORDS)
        for health in image.nodes:
            health.nmt_state, health.boot_ups, health.misses = NmtState.OPERATIONAL, 0, 0

    def configure(self) -> None:
        """Apply the changes of a bring-up."""
        self.heal()
        for health in self.image.nodes:
            health.emcys, health.emcy = 0, None
        self.image.events = 0
        self.supervisor.configured(self.image)

    @property
    def cause(self) -> Cause | None:
        fault = self.supervisor.fault
        return None if fault is None else fault.cause


def enabled(settings: SupervisionSettings | None = None, **arguments: Any) -> Bench:
    bench = Bench(settings, **arguments)
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 10)
    assert bench.permitted
    return bench


def test_enable_walks_through_every_state_and_permits_torque_once_the_drive_has_confirmed() -> None:
    bench = Bench()
    bench.now = 3600.0  # an hour in standby does not count for the time-out of the enable
    bench.step(Request.DISABLE, 3)
    words, permitted = [], []
    for _ in range(6):
        bench.step(Request.ENABLE)
        words.append(int(bench.controlword))
        permitted.append(bench.permitted)
    assert words == [0x06, 0x07, 0x0F, 0x0F, 0x0F, 0x0F]
    assert permitted == [False, False, False, False, True, True]
    assert bench.supervisor.phase is Phase.ENABLED


def test_enable_that_stands_from_the_beginning_enables_nothing() -> None:
    bench = Bench()
    bench.step(Request.ENABLE, 100)
    assert (bench.supervisor.phase, bench.permitted) == (Phase.STANDBY, False)


def refused(bench: Bench) -> set[Controlword]:
    """Request torque until the fault of the time-out. Return the controlwords before it."""
    bench.step(Request.DISABLE, 3)
    words = set()
    while bench.cause is None:
        words.add(bench.controlword)
        bench.step(Request.ENABLE)
        assert bench.now < 3.0
    assert (bench.cause, bench.controlword) == (Cause.ENABLE_TIMEOUT, Controlword.DISABLE_VOLTAGE)
    return words


def test_drive_in_another_mode_is_never_enabled() -> None:
    bench = Bench()
    bench.image.mode = 1
    assert refused(bench) == {Controlword.SHUTDOWN}
    assert "in mode 1 instead of 10 (cyclic torque)" in str(bench.supervisor.fault)


@pytest.mark.parametrize(
    ("state", "fresh", "found"),
    [
        (PowerState.SWITCH_ON_DISABLED, True, "drive is in switch_on_disabled after 2 s"),
        (PowerState.OPERATION_ENABLED, False, "drive is in operation_enabled after 2 s, without fresh PDOs"),
    ],
)
def test_drive_that_never_enables_is_a_fault_with_its_state(state: PowerState, fresh: bool, found: str) -> None:
    bench = Bench()
    bench.obeys = False
    bench.state, bench.image.fresh = state, fresh
    refused(bench)
    assert str(bench.supervisor.fault) == f"drive does not enable: {found}"


@pytest.mark.parametrize("reports_following", [True, False])
def test_bit_12_must_be_seen_before_torque_if_the_drive_reports_it(reports_following: bool) -> None:
    bench = Bench() if reports_following else Bench(reports_following=False)
    bench.words[PowerState.OPERATION_ENABLED] = 0x0237
    bench.step(Request.DISABLE, 3)
    bench.step(Request.ENABLE, 50)
    assert bench.permitted is not reports_following
    bench.words[PowerState.OPERATION_ENABLED] = 0x1237
    bench.step(Request.ENABLE, 2)
    assert bench.permitted


@pytest.mark.parametrize("wrong", ["mode", "fresh"])
def test_enabled_needs_mode_and_fresh_answers_in_the_same_cycle(wrong: str) -> None:
    bench = Bench()
    bench.step(Request.DISABLE, 3)
    bench.step(Request.ENABLE, 3)
    assert bench.state is PowerState.OPERATION_ENABLED
    setattr(bench.image, wrong, {"mode": 8, "fresh": False}[wrong])
    bench.step(Request.ENABLE, 5)
    assert (bench.permitted, bench.supervisor.phase) == (False, Phase.ENABLING)


@pytest.mark.parametrize("request_", [Request.RESET, Request.DISABLE])
def test_anything_but_enable_takes_torque_away_at_once_and_confirms(request_: Request) -> None:
    bench = enabled()
    bench.step(request_)
    assert (bench.permitted, bench.controlword) == (False, Controlword.SHUTDOWN)
    assert bench.supervisor.phase is Phase.DISABLING
    bench.step(request_, 3)
    assert (bench.supervisor.phase, bench.state) == (Phase.STANDBY, PowerState.READY_TO_SWITCH_ON)


def test_drive_that_does_not_disable_within_a_second_is_a_fault() -> None:
    bench = enabled()
    bench.step(Request.ENABLE, 3000)
    bench.obeys = False
    bench.step(Request.DISABLE, 950)
    assert (bench.supervisor.phase, bench.cause) == (Phase.DISABLING, None)
    bench.step(Request.DISABLE, 100)
    assert (bench.cause, bench.controlword) == (Cause.DISABLE_TIMEOUT, Controlword.DISABLE_VOLTAGE)


@pytest.mark.parametrize("state", [PowerState.READY_TO_SWITCH_ON, PowerState.SWITCH_ON_DISABLED])
def test_enable_that_returns_while_disabling_needs_a_disable_after_the_drive_has_confirmed(state: PowerState) -> None:
    bench = enabled()
    bench.obeys = False
    bench.step(Request.DISABLE)
    for _ in range(100):
        bench.step(Request.ENABLE)
        assert (bench.permitted, bench.controlword) == (False, Controlword.SHUTDOWN)
    assert bench.supervisor.phase is Phase.DISABLING
    bench.state, bench.obeys = state, True
    for _ in range(100):
        bench.step(Request.ENABLE)
        assert (bench.permitted, bench.supervisor.phase) == (False, Phase.STANDBY)


def drive_fault(bench: Bench) -> None:
    bench.state = PowerState.FAULT
    bench.image.error_code = 0x2310


def set_attribute(**values: object) -> Callable[[Bench], None]:
    def change(bench: Bench) -> None:
        for name, value in values.items():
            setattr(bench.image, name, value)

    return change


def report(statusword: int) -> Callable[[Bench], None]:
    """Return a change of the statusword that the drive reports in its present state."""

    def change(bench: Bench) -> None:
        bench.words[bench.state] = statusword

    return change


def boot_up(bench: Bench) -> None:
    bench.image.nodes[0].boot_ups += 1
    bench.image.nodes[0].nmt_state = NmtState.BOOT_UP
    bench.image.events += 2


def leave_operational(bench: Bench) -> None:
    bench.image.nodes[1].nmt_state = NmtState.PRE_OPERATIONAL
    bench.image.events += 1


def silence(bench: Bench) -> None:
    bench.image.silent = bench.image.nodes[1]


FAULTS: list[tuple[str, Callable[[Bench], None], Cause, str]] = [
    ("drive fault", drive_fault, Cause.DRIVE_FAULT, r"error 0x2310 \(continuous over-current at the output\)"),
    ("fault reaction", report(0x021F), Cause.DRIVE_FAULT, "error 0x0000"),
    ("emergency", Bench.emergency, Cause.EMERGENCY, r"drive node 1: EMCY 0x2310"),
    ("boot-up", boot_up, Cause.BOOT_UP, r"drive node 1: it lost its configuration"),
    ("pre-operational", leave_operational, Cause.NMT_STATE, r"joint encoder node 32: NMT state 0x7F"),
    ("heartbeat", silence, Cause.HEARTBEAT_LOST, r"joint encoder node 32: none for \d+ ms"),
    ("bus-off", set_attribute(bus_fault=BusFault.BUS_OFF), Cause.BUS_FAULT, "the controller is bus-off"),
    ("interface", set_attribute(bus_fault=BusFault.INTERFACE_DOWN), Cause.BUS_FAULT, "the interface is down"),
    ("intruder", set_attribute(intruder=0x201), Cause.SECOND_MASTER, "0x201"),
    ("altered", set_attribute(altered="drive node 1: 0x1400:5 is 0x0"), Cause.ALTERED, "0x1400:5 is 0x0"),
    ("stop", set_attribute(pressed="drive node 1: bit 3"), Cause.EMERGENCY_STOP, "drive node 1: bit 3"),
    ("stale", set_attribute(misses=3, fresh=False), Cause.STALE_PDO, "3 cycles in a row"),
    ("dropped", set_attribute(drops=3), Cause.COMMAND_DROPPED, "3 in a row"),
]
FAULTS_WHILE_ENABLED: list[tuple[str, Callable[[Bench], None], Cause, str]] = [
    ("mode", set_attribute(mode=8), Cause.WRONG_MODE, "mode 8"),
    ("ignored", report(0x0237), Cause.COMMAND_IGNORED, "bit 12 of statusword 0x0237 is low"),
    ("state", lambda b: setattr(b, "state", PowerState.SWITCHED_ON), Cause.STATE_LOST, "drive is in switched_on"),
    ("voltage", report(0x1227), Cause.STATE_LOST, r"bit 4 \(voltage\)"),
    ("remote", report(0x1037), Cause.STATE_LOST, r"bit 9 \(remote\)"),
]
NEEDS_BRING_UP = {  # a reset alone suffices only if no configuration can be lost
    Cause.ALTERED, Cause.BOOT_UP, Cause.NMT_STATE, Cause.HEARTBEAT_LOST, Cause.BUS_FAULT, Cause.SECOND_MASTER,
}  # fmt: skip


@pytest.mark.parametrize(("name", "break_it", "cause", "text"), FAULTS + FAULTS_WHILE_ENABLED)
def test_fault_takes_torque_away_in_the_same_cycle_and_stays_until_its_reset(
    name: str, break_it: Callable[[Bench], None], cause: Cause, text: str
) -> None:
    bench = enabled()
    break_it(bench)
    bench.step(Request.ENABLE)
    assert (bench.permitted, bench.controlword, bench.cause) == (False, Controlword.DISABLE_VOLTAGE, cause)
    assert bench.supervisor.fault is not None
    assert re.search(text, bench.supervisor.fault.detail)
    bench.heal()
    bench.state = PowerState.OPERATION_ENABLED
    for _ in range(100):
        bench.step(Request.ENABLE)
        assert (bench.permitted, bench.controlword) == (False, Controlword.DISABLE_VOLTAGE)
    assert (bench.supervisor.phase, bench.cause) == (Phase.FAULT, cause)
    bench.step(Request.DISABLE)
    bench.step(Request.RESET, 100)
    assert (bench.supervisor.phase is Phase.FAULT) is (cause in NEEDS_BRING_UP)
    assert bench.supervisor.needs_bring_up is (cause in NEEDS_BRING_UP)


@pytest.mark.parametrize(("name", "break_it", "cause", "text"), FAULTS)
def test_fault_in_the_first_cycle_is_seen(
    name: str, break_it: Callable[[Bench], None], cause: Cause, text: str
) -> None:
    bench = Bench()
    break_it(bench)
    bench.step(Request.DISABLE)
    assert bench.cause is cause


def test_trip_from_outside_latches_like_any_fault() -> None:
    bench = enabled()
    bench.supervisor.trip(Finding(Cause.OVER_SPEED, "31 rad/s, allowed 30"), bench.now)
    bench.step(Request.ENABLE)
    assert (bench.permitted, str(bench.supervisor.fault)) == (False, "over-speed: 31 rad/s, allowed 30")


def test_event_that_is_no_fault_leaves_the_torque() -> None:
    """A node has returned to operational, and the event is evaluated in an unusual cycle."""
    bench = enabled()
    bench.image.events += 1
    bench.step(Request.ENABLE)
    assert (bench.permitted, bench.controlword, bench.cause) == (True, Controlword.ENABLE_OPERATION, None)


@pytest.mark.parametrize("request_", [Request.DISABLE, Request.RESET])
def test_enable_in_the_cycle_after_a_reset_needs_another_request_before_it(request_: Request) -> None:
    bench = enabled()
    bench.state = PowerState.FAULT
    bench.step(Request.DISABLE, 5)
    while bench.supervisor.fault is not None:
        bench.step(Request.RESET)
        assert bench.now < 1.0
    for _ in range(100):
        bench.step(Request.ENABLE)
        assert (bench.permitted, bench.supervisor.phase) == (False, Phase.STANDBY)
    bench.step(request_)
    bench.step(Request.ENABLE, 10)
    assert bench.permitted


def test_reset_request_that_stands_resets_only_what_was_there_before() -> None:
    bench = enabled()
    bench.emergency()
    bench.step(Request.RESET, 50)
    assert bench.supervisor.phase is Phase.STANDBY
    bench.emergency()
    bench.step(Request.RESET, 200)
    assert bench.supervisor.phase is Phase.FAULT


def test_reset_gives_the_drive_a_rising_edge_20_ms_after_bit_7_was_low() -> None:
    bench = enabled()
    drive_fault(bench)
    bench.step(Request.ENABLE, 5)
    words = []
    for _ in range(60):
        bench.step(Request.RESET)
        words.append(int(bench.controlword))
    assert words[:20] == [0x00] * 20
    assert words.index(0x80) in (20, 21)  # 1 ms each
    assert words.count(0x80) == 1
    # the state that standby keeps
    assert (bench.state, bench.supervisor.fault) == (PowerState.READY_TO_SWITCH_ON, None)


@pytest.mark.parametrize(("statusword", "words"), [(0x0218, {0x00, 0x80}), (0x021F, {0x00})])
def test_drive_that_stays_in_its_fault_keeps_the_first_cause(statusword: int, words: set[int]) -> None:
    """The reset waits for the end of a fault reaction (0x021F). Its time-out is 2 s."""
    bench = enabled()
    drive_fault(bench)
    bench.step(Request.ENABLE, 5)
    bench.obeys = False
    bench.words[PowerState.FAULT] = statusword
    seen = set()
    for _ in range(1900):
        bench.step(Request.RESET)
        assert bench.supervisor.phase is Phase.RESETTING
        seen.add(int(bench.controlword))
    assert seen == words
    bench.step(Request.RESET, 200)
    assert bench.supervisor.phase is Phase.FAULT
    assert [fault.cause for fault in bench.supervisor.faults] == [Cause.DRIVE_FAULT, Cause.RESET_TIMEOUT]


@pytest.mark.parametrize("drops", [0, 9])
def test_stale_answers_while_resetting_are_judged_by_its_time_out_and_dropped_commands_at_once(drops: int) -> None:
    bench = enabled()
    bench.emergency()
    bench.step(Request.ENABLE, 5)
    bench.image.fresh = False
    bench.step(Request.RESET, 3)
    bench.image.misses, bench.image.drops = 10, drops
    bench.step(Request.RESET)
    assert bench.supervisor.phase is (Phase.FAULT if drops else Phase.RESETTING)
    if not drops:
        bench.step(Request.RESET, 1900)
        assert bench.supervisor.phase is Phase.RESETTING
        bench.step(Request.RESET, 200)
        assert str(bench.supervisor.faults[1]) == "drive does not leave its fault: no fresh PDO"


def test_first_cause_is_kept_and_what_follows_is_listed_once() -> None:
    bench = enabled()
    bench.image.misses, bench.image.fresh = 3, False
    bench.step(Request.ENABLE, 50)
    silence(bench)
    bench.step(Request.ENABLE, 50)
    boot_up(bench)
    bench.step(Request.ENABLE, 50)
    causes = [fault.cause for fault in bench.supervisor.faults]
    assert causes == [Cause.STALE_PDO, Cause.HEARTBEAT_LOST, Cause.BOOT_UP]
    assert bench.supervisor.needs_bring_up


def test_bring_up_makes_a_reset_possible_and_forgets_old_emergencies() -> None:
    bench = enabled()
    bench.emergency()
    boot_up(bench)
    bench.step(Request.ENABLE, 3)
    bench.step(Request.RESET, 5)
    assert bench.supervisor.phase is Phase.FAULT
    bench.configure()
    bench.step(Request.DISABLE)
    bench.step(Request.RESET, 5)
    bench.image.events += 1  # unrelated news: the emergencies are not counted again
    bench.step(Request.DISABLE)
    assert (bench.supervisor.phase, bench.cause) == (Phase.STANDBY, None)


def test_emergency_right_after_a_bring_up_is_seen() -> None:
    bench = enabled()
    boot_up(bench)
    bench.step(Request.ENABLE, 3)
    seen = bench.image.events
    bench.configure()
    bench.emergency()
    bench.image.events = seen  # the same number of events as before the bring-up does not mean the same events
    bench.step(Request.DISABLE)
    assert [fault.cause for fault in bench.supervisor.faults] == [Cause.BOOT_UP, Cause.EMERGENCY]


def test_emergency_that_was_reset_does_not_come_back_with_other_news() -> None:
    bench = enabled()
    bench.emergency()
    bench.step(Request.DISABLE, 5)
    bench.step(Request.RESET, 100)
    assert bench.supervisor.fault is None
    bench.step(Request.DISABLE)
    bench.image.events += 1  # an unrelated event
    bench.step(Request.ENABLE, 10)
    assert (bench.supervisor.fault, bench.permitted) == (None, True)


@pytest.mark.parametrize("limit", [None, 0, 1, 5])
@pytest.mark.parametrize(("name", "cause"), [("misses", Cause.STALE_PDO), ("drops", Cause.COMMAND_DROPPED)])
def test_one_drop_or_miss_more_than_tolerated_stops(name: str, cause: Cause, limit: int | None) -> None:
    """Two are tolerated by default."""
    bench = enabled(SupervisionSettings(**({} if limit is None else {f"tolerated_{name}": limit})))
    tolerated = 2 if limit is None else limit
    for count in range(tolerated + 1):
        setattr(bench.image, name, count)
        bench.step(Request.ENABLE)
        assert bench.permitted
    setattr(bench.image, name, tolerated + 1)
    bench.step(Request.ENABLE)
    assert (bench.permitted, bench.cause) == (False, cause)


def lose(bench: Bench, seconds: float, answers: int = 0, commands: int = 0, skips: int = 0) -> float | None:
    """Lose answers or commands, or skip a period before a cycle, in every n-th cycle (0: never).

    Return the time until the fault (s), or None.
    """
    begin, cycle, image = bench.now, 0, bench.image
    while bench.now < begin + seconds:
        cycle += 1
        if skips and cycle % skips == 0:
            bench.now += 0.001
            image.skipped += 1
            image.overruns.add(bench.now, 1, 1.5 * 0.001)
        elif answers and cycle % answers == 0:
            image.nodes[1].missed += 1
            image.missed += 1
        elif commands and cycle % commands == 0:
            image.dropped += 1
        bench.step(Request.ENABLE)
        if not bench.permitted:
            return bench.now - begin
    return None


@pytest.mark.parametrize(("what", "node"), [("answers", "joint encoder node 32"), ("commands", "commands")])
@pytest.mark.parametrize(("every", "seconds"), [(6, None), (5, 1.0), (2, 0.4), (1, 0.2)])
def test_a_fifth_of_a_second_s_cycles_lost_is_a_fault_in_a_row_or_not(
    every: int, seconds: float | None, what: str, node: str
) -> None:
    bench = enabled()
    found = lose(bench, 3.0, **{what: every})
    if seconds is None:
        assert found is None
        return
    assert found == pytest.approx(seconds, abs=1e-6)
    assert bench.cause is Cause.STALE_PDO
    assert re.search(f"200 cycles within a second lost .*{node} 200", str(bench.supervisor.fault))


@pytest.mark.parametrize(("every", "seconds"), [(5, None), (4, 0.999), (1, 0.4)])
def test_a_fifth_of_a_second_s_periods_skipped_is_a_fault_of_the_loop(every: int, seconds: float | None) -> None:
    bench = enabled()
    found = lose(bench, 3.0, skips=every)
    if seconds is None:
        assert found is None
        return
    assert found == pytest.approx(seconds, abs=0.01)
    assert bench.cause is Cause.SKIPPED
    assert "200 of 1000 periods had no cycle: a cycle takes 1.5 ms; set rate = 500 in" in str(bench.supervisor.fault)


@pytest.mark.parametrize(
    ("skips", "answers", "cause"), [(6, 8, Cause.SKIPPED), (10, 6, Cause.STALE_PDO), (12, 12, None)]
)
def test_skipped_periods_and_lost_answers_count_together(skips: int, answers: int, cause: Cause | None) -> None:
    """Neither reaches a fifth of a second alone. The cause is the one that lost more."""
    bench = enabled()
    assert (lose(bench, 3.0, answers, skips=skips) is None) is (cause is None)
    assert bench.cause is cause
    if cause is Cause.STALE_PDO:
        assert "skipped periods" in str(bench.supervisor.fault)


def test_a_loop_that_stood_still_is_the_cause_of_what_the_nodes_did_meanwhile() -> None:
    bench = enabled()
    bench.now += 0.3
    bench.image.skipped += 300
    bench.image.overruns.add(bench.now, 300, 0.3)
    bench.emergency()
    bench.step(Request.ENABLE)
    assert bench.cause is Cause.SKIPPED
    assert "held the loop up for 300 ms at most; look for missing real-time rights" in str(bench.supervisor.fault)
    assert [fault.cause for fault in bench.supervisor.faults] == [Cause.SKIPPED, Cause.EMERGENCY]


def test_a_slow_loop_loses_as_large_a_share_and_never_fewer_than_are_tolerated_in_a_row() -> None:
    for settings, most in ((SupervisionSettings(), 20), (SupervisionSettings(tolerated_misses=50), 51)):
        assert lose(enabled(settings, rate=100.0), 1.0, answers=1) == pytest.approx(1e-3 * most)


@pytest.mark.parametrize("node", [0, 1])
@pytest.mark.parametrize(("rate", "most"), [(1000.0, 50), (100.0, 5), (20.0, 3)])
def test_repeated_pdos_of_a_node_in_a_twentieth_of_the_cycles_are_a_second_node(
    rate: float, most: int, node: int
) -> None:
    """An encoder counts like a drive, because forged angles drive the motor just as forged torques do."""
    bench = enabled(rate=rate)
    for n in range(most):
        assert bench.permitted
        bench.image.nodes[node].repeated += 2
        bench.step(Request.ENABLE)
        assert bench.permitted is (n < most - 1)
    assert (bench.cause, bench.supervisor.needs_bring_up) == (Cause.REPEATED_PDO, True)


def test_answers_that_are_late_by_a_period_are_no_second_drive() -> None:
    """A second answer in a cycle belongs to a cycle that missed its answer. Any further answer is a surplus."""
    bench = enabled(SupervisionSettings(lost_share=1.0))
    drive = bench.image.nodes[0]
    for _ in range(200):
        drive.missed += 1
        bench.image.missed += 1
        bench.step(Request.ENABLE)
        drive.repeated += 1
        bench.step(Request.ENABLE)
        assert bench.permitted
    for _ in range(50):
        drive.repeated += 1
        bench.step(Request.ENABLE)
    assert bench.cause is Cause.REPEATED_PDO


def test_a_new_enable_forgets_what_was_lost_before() -> None:
    bench = enabled()
    assert lose(bench, 0.19, answers=1) is None
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 10)
    assert lose(bench, 0.19, answers=1) is None


@pytest.mark.parametrize(
    ("misses", "late", "text"),
    [
        ((0, 3), {}, "joint encoder node 32: 3 cycles in a row"),
        ((0, 3), {"late": 2}, "joint encoder node 32: 3 cycles in a row (since the start late 2)"),
        (
            (0, 3),
            {"late": 2, "repeated": 1, "malformed": 4},
            "joint encoder node 32: 3 cycles in a row (since the start late 2, repeated 1, wrong length 4)",
        ),
        ((3, 1), {}, "drive node 1: 3 cycles in a row; joint encoder node 32: 1 cycles in a row"),
        (
            (0, 1),
            {},
            "3 cycles in a row without all answers, at the end joint encoder node 32: 1 cycles in a row",
        ),
    ],
    ids=["one node", "late", "all", "one node all the time", "in turn"],
)
def test_stale_answers_name_the_nodes_and_what_came_instead(
    misses: tuple[int, int], late: dict[str, int], text: str
) -> None:
    bench = enabled()
    drive, encoder, _ = bench.image.nodes
    (drive.misses, encoder.misses), bench.image.misses = misses, 3
    bench.image.fresh = False
    for name, count in late.items():
        setattr(encoder, name, count)
    bench.step(Request.ENABLE)
    assert bench.supervisor.fault is not None
    assert bench.supervisor.fault.detail == text


def test_torque_with_those_statuswords_only_that_say_enabled_and_following() -> None:
    """All patterns of bits 0 to 9 and 12 are tested, each with the other bits clear and set."""
    bench = enabled()
    template, image = bench.supervisor, bench.image
    wrong = []
    for statusword in range(0x2000):
        for other in (0x0000, 0xEC00):
            supervisor = copy.copy(template)
            supervisor.faults = []
            image.statusword = statusword & 0x13FF | other
            _, permitted, _ = supervisor.update(image, bench.now, Request.ENABLE)
            if permitted is not (statusword & 0x6F == 0x27 and statusword & 0x1210 == 0x1210):
                wrong.append(image.statusword)
    assert wrong == []


def test_a_power_stage_that_is_off_at_the_next_enable_is_a_lost_state() -> None:
    """A reset while the supply is unstable does not erase what the drive once reported."""
    bench = enabled()
    bench.step(Request.DISABLE, 5)
    assert not bench.permitted
    bench.words[PowerState.OPERATION_ENABLED] = 0x1227
    bench.step(Request.ENABLE, 20)
    assert (bench.permitted, bench.cause) == (False, Cause.STATE_LOST)


def test_a_drive_that_never_shows_voltage_and_remote_runs_without() -> None:
    """Some drives never set bits 4 and 9."""
    bench = Bench()
    bench.words = {state: word & ~0x0210 for state, word in WORDS.items()}
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 15)
    assert bench.permitted


@pytest.mark.parametrize("low", [0x0010, 0x0200])
def test_a_power_stage_that_is_off_at_the_first_enable_is_a_lost_state(low: int) -> None:
    """The supply was present while the drive was ready. An unstable supply may be off just at the enable."""
    bench = Bench()
    bench.words[PowerState.OPERATION_ENABLED] &= ~low
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 10)
    assert (bench.permitted, bench.cause) == (False, Cause.STATE_LOST)


@pytest.mark.parametrize("low", [0x0010, 0x0200])
def test_a_power_stage_that_was_off_until_the_enable_is_watched_from_when_it_is_on(low: int) -> None:
    """An unstable supply may have been off in every cycle before."""
    bench = Bench()
    bench.words = {state: word & ~low for state, word in WORDS.items()}
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 15)
    assert bench.permitted
    bench.words = dict(WORDS)
    bench.step(Request.ENABLE, 5)
    assert bench.permitted
    bench.words[PowerState.OPERATION_ENABLED] &= ~low
    bench.step(Request.ENABLE)
    assert (bench.permitted, bench.cause) == (False, Cause.STATE_LOST)


def cut_offs(bench: Bench, cycles: int) -> list[int]:
    """Return the cycles, counted from 1, in which the drive is stopped by NMT."""
    cut = []
    for cycle in range(1, cycles + 1):
        bench.step(Request.ENABLE)
        if bench.supervisor.cut_off:
            cut.append(cycle)
    return cut


def tripped(obeys: bool) -> Bench:
    bench = enabled()
    assert bench.supervisor.cut_off is False
    bench.obeys = obeys
    bench.supervisor.trip(Finding(Cause.NOT_FINITE, "a limit"), bench.now)
    return bench


def test_a_drive_that_obeys_is_not_cut_off() -> None:
    bench = tripped(obeys=True)
    assert cut_offs(bench, 500) == []
    assert not bench.supervisor.needs_bring_up


def test_a_drive_that_stays_enabled_after_a_fault_is_stopped_by_nmt_again_and_again() -> None:
    """NMT stops the drive 50 ms after the command to leave, and every 50 ms until the drive confirms.

    Then all nodes must be configured again.
    """
    bench = tripped(obeys=False)
    assert cut_offs(bench, 220) == pytest.approx([51, 101, 151, 201], abs=2)
    assert bench.supervisor.needs_bring_up
    bench.state = PowerState.FAULT
    bench.step(Request.ENABLE, 200)
    assert not bench.supervisor.cut_off


def test_drive_that_comes_back_enabled_in_a_fault_has_its_time_to_obey() -> None:
    bench = tripped(obeys=False)
    bench.state = PowerState.SWITCH_ON_DISABLED
    assert cut_offs(bench, 300) == []
    bench.state = PowerState.OPERATION_ENABLED
    assert cut_offs(bench, 40) == []
    assert len(cut_offs(bench, 20)) == 1


def test_further_faults_do_not_put_off_the_cut_off() -> None:
    bench = tripped(obeys=False)
    cut = []
    for _ in range(60):
        bench.supervisor.trip(Finding(Cause.OVER_SPEED, "x"), bench.now)
        cut += cut_offs(bench, 1)
    assert cut
