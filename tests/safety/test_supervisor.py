"""Supervision: each duty separately, and all of them in random order."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator

import pytest
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from tsa_ctrl.bus.canopen.cia301 import Emcy, NmtState
from tsa_ctrl.bus.canopen.cia402 import Controlword, PowerState, decode
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
    """A supervisor, an image, and a drive that obeys each controlword in the next cycle."""

    def __init__(self, settings: SupervisionSettings | None = None, reports_following: bool = True) -> None:
        self.supervisor = Supervisor(settings or SupervisionSettings(), reports_following)
        self.image = Image(
            (NodeHealth(Role.DRIVE, 1, 0.2), NodeHealth(Role.ENCODER, 32, 0.2), NodeHealth(Role.TORQUE_SENSOR, 64, 0.2))
        )
        self.image.fresh = True
        self.image.mode = 10
        self.state = PowerState.SWITCH_ON_DISABLED
        self.obeys = True
        self.now = 0.0
        self.controlword = Controlword.DISABLE_VOLTAGE
        self.permitted = False

    def step(self, request: Request, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.now += 1e-3
            self.image.now = self.now
            self.image.statusword = WORDS[self.state]
            before = self.controlword
            self.controlword, self.permitted, _ = self.supervisor.update(self.image, self.now, request)
            if self.obeys:
                self.obey(before)

    def obey(self, before: Controlword) -> None:
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

    @property
    def cause(self) -> Cause | None:
        fault = self.supervisor.fault
        return None if fault is None else fault.cause


def enabled(**arguments: object) -> Bench:
    bench = Bench(**arguments)  # type: ignore[arg-type]
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 10)
    assert bench.permitted
    return bench


def test_request_walks_to_enabled_through_every_state() -> None:
    bench = Bench()
    bench.step(Request.DISABLE, 3)
    words = []
    for _ in range(6):
        bench.step(Request.ENABLE)
        words.append(int(bench.controlword))
    assert words == [0x06, 0x07, 0x0F, 0x0F, 0x0F, 0x0F]
    assert bench.supervisor.phase is Phase.ENABLED


def test_torque_is_permitted_only_after_the_drive_has_confirmed() -> None:
    bench = Bench()
    bench.step(Request.DISABLE, 3)
    seen = []
    for _ in range(8):
        bench.step(Request.ENABLE)
        seen.append((bench.image.statusword == 0x1237, bench.permitted))
    assert (False, True) not in seen
    assert seen[-1] == (True, True)


def test_enable_that_stands_from_the_beginning_enables_nothing() -> None:
    bench = Bench()
    bench.step(Request.ENABLE, 100)
    assert (bench.supervisor.phase, bench.permitted) == (Phase.STANDBY, False)


def test_drive_in_another_mode_is_not_enabled_and_named() -> None:
    bench = Bench()
    bench.image.mode = 1
    bench.step(Request.DISABLE, 3)
    bench.step(Request.ENABLE, 2100)
    assert (bench.cause, bench.state) == (Cause.ENABLE_TIMEOUT, PowerState.SWITCH_ON_DISABLED)


def test_drive_that_never_enables_is_a_fault_with_its_state() -> None:
    bench = Bench()
    bench.obeys = False
    bench.step(Request.DISABLE, 3)
    bench.step(Request.ENABLE, 2100)
    said = str(bench.supervisor.fault)
    assert said == "drive does not enable: drive is in switch_on_disabled after 2 s"


def test_bit_12_must_be_seen_before_torque() -> None:
    bench = Bench()
    bench.step(Request.DISABLE, 3)
    WORDS[PowerState.OPERATION_ENABLED] = 0x0237
    try:
        bench.step(Request.ENABLE, 50)
        assert (bench.supervisor.phase, bench.permitted) == (Phase.ENABLING, False)
    finally:
        WORDS[PowerState.OPERATION_ENABLED] = 0x1237
    bench.step(Request.ENABLE, 2)
    assert bench.permitted


def test_drive_that_does_not_report_bit_12_is_believed_without() -> None:
    bench = Bench(reports_following=False)
    WORDS[PowerState.OPERATION_ENABLED] = 0x0237
    try:
        bench.step(Request.DISABLE, 3)
        bench.step(Request.ENABLE, 10)
        assert bench.permitted
    finally:
        WORDS[PowerState.OPERATION_ENABLED] = 0x1237


def test_disable_takes_torque_away_at_once_and_confirms() -> None:
    bench = enabled()
    bench.step(Request.DISABLE)
    assert (bench.permitted, bench.controlword) == (False, Controlword.SHUTDOWN)
    bench.step(Request.DISABLE, 3)
    assert (bench.supervisor.phase, bench.state) == (Phase.STANDBY, PowerState.READY_TO_SWITCH_ON)


def test_drive_that_does_not_disable_is_a_fault() -> None:
    bench = enabled()
    bench.obeys = False
    bench.step(Request.DISABLE, 1100)
    assert (bench.cause, bench.controlword) == (Cause.DISABLE_TIMEOUT, Controlword.DISABLE_VOLTAGE)


def drive_fault(bench: Bench) -> None:
    bench.state = PowerState.FAULT
    bench.image.error_code = 0x2310


def set_attribute(**values: object) -> Callable[[Bench], None]:
    def change(bench: Bench) -> None:
        for name, value in values.items():
            setattr(bench.image, name, value)

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


def ignore(bench: Bench) -> None:
    WORDS[PowerState.OPERATION_ENABLED] = 0x0237


FAULTS: list[tuple[str, Callable[[Bench], None], Cause, str]] = [
    ("drive fault", drive_fault, Cause.DRIVE_FAULT, r"error 0x2310 \(continuous over-current at the output\)"),
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
    ("mode", set_attribute(mode=8), Cause.WRONG_MODE, "mode 8"),
    ("ignored", ignore, Cause.COMMAND_IGNORED, "bit 12 of statusword 0x0237 is low"),
    ("state", lambda b: setattr(b, "state", PowerState.SWITCHED_ON), Cause.STATE_LOST, "drive is in switched_on"),
]


@pytest.fixture(params=FAULTS, ids=[name for name, *_ in FAULTS])
def failed(request: pytest.FixtureRequest) -> Iterator[tuple[Bench, Cause, str]]:
    """Yield a bench one cycle after a failure while enabled, with the expected cause and text."""
    _, break_it, cause, text = request.param
    bench = enabled()
    break_it(bench)
    bench.step(Request.ENABLE)
    yield bench, cause, text
    WORDS[PowerState.OPERATION_ENABLED] = 0x1237


def test_fault_takes_torque_away_in_the_same_cycle_and_names_its_cause(failed: tuple[Bench, Cause, str]) -> None:
    bench, cause, text = failed
    assert (bench.permitted, bench.controlword, bench.cause) == (False, Controlword.DISABLE_VOLTAGE, cause)
    assert bench.supervisor.fault is not None
    assert re.search(text, bench.supervisor.fault.detail)


def test_fault_stays_when_its_reason_goes_and_enable_stands(failed: tuple[Bench, Cause, str]) -> None:
    bench, cause, _ = failed
    WORDS[PowerState.OPERATION_ENABLED] = 0x1237
    image = bench.image
    image.bus_fault = image.intruder = image.silent = image.altered = image.pressed = None
    image.misses = image.drops = 0
    image.fresh, image.mode = True, 10
    bench.state = PowerState.OPERATION_ENABLED
    for _ in range(500):
        bench.step(Request.ENABLE)
        assert (bench.permitted, bench.controlword) == (False, Controlword.DISABLE_VOLTAGE)
    assert (bench.supervisor.phase, bench.cause) == (Phase.FAULT, cause)


def test_reset_alone_suffices_only_when_no_configuration_can_be_lost(failed: tuple[Bench, Cause, str]) -> None:
    bench, cause, _ = failed
    WORDS[PowerState.OPERATION_ENABLED] = 0x1237
    image = bench.image
    image.bus_fault = image.intruder = image.silent = image.altered = image.pressed = None
    image.misses = image.drops = 0
    image.fresh, image.mode = True, 10
    bench.step(Request.DISABLE)
    bench.step(Request.RESET, 100)
    needed = {
        Cause.ALTERED,
        Cause.REPEATED_PDO,
        Cause.BOOT_UP,
        Cause.NMT_STATE,
        Cause.HEARTBEAT_LOST,
        Cause.BUS_FAULT,
        Cause.SECOND_MASTER,
    }
    assert (bench.supervisor.phase is Phase.FAULT) is (cause in needed)
    assert bench.supervisor.needs_bring_up is (cause in needed)


def test_after_a_reset_torque_needs_a_new_request() -> None:
    bench = enabled()
    bench.emergency()
    bench.step(Request.ENABLE, 10)
    bench.step(Request.RESET, 50)
    assert bench.supervisor.phase is Phase.STANDBY
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


def reset_after_a_drive_fault() -> tuple[Bench, list[int]]:
    """Return the bench, and the 60 controlwords since the reset request."""
    bench = enabled()
    drive_fault(bench)
    bench.step(Request.ENABLE, 5)
    words = []
    for _ in range(60):
        bench.step(Request.RESET)
        words.append(int(bench.controlword))
    return bench, words


def test_reset_gives_the_drive_a_rising_edge() -> None:
    bench, words = reset_after_a_drive_fault()
    assert words[:20] == [0x00] * 20
    assert words.count(0x80) == 1
    # the state that standby keeps
    assert (bench.state, bench.supervisor.fault) == (PowerState.READY_TO_SWITCH_ON, None)


def test_drive_that_stays_in_its_fault_keeps_the_first_cause() -> None:
    bench = enabled()
    drive_fault(bench)
    bench.step(Request.ENABLE, 5)
    bench.obeys = False
    bench.step(Request.RESET, 2500)
    assert bench.supervisor.phase is Phase.FAULT
    assert [fault.cause for fault in bench.supervisor.faults] == [Cause.DRIVE_FAULT, Cause.RESET_TIMEOUT]


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


def test_bring_up_makes_a_reset_possible() -> None:
    bench = enabled()
    boot_up(bench)
    bench.step(Request.ENABLE, 5)
    bench.step(Request.RESET, 5)
    for health in bench.image.nodes:
        health.boot_ups, health.nmt_state = 0, NmtState.OPERATIONAL
    bench.image.events = 0
    bench.supervisor.configured(bench.image)
    bench.step(Request.DISABLE)
    bench.step(Request.RESET, 5)
    assert bench.supervisor.phase is Phase.STANDBY


def test_trip_from_outside_latches_like_any_fault() -> None:
    bench = enabled()
    bench.supervisor.trip(Finding(Cause.OVER_SPEED, "31 rad/s, allowed 30"), bench.now)
    bench.step(Request.ENABLE)
    assert (bench.permitted, str(bench.supervisor.fault)) == (
        False,
        "over-speed: 31 rad/s, allowed 30",
    )


@pytest.mark.parametrize("misses", [1, 2])
def test_tolerated_misses_do_not_stop(misses: int) -> None:
    bench = enabled()
    bench.image.misses, bench.image.fresh = misses, False
    bench.step(Request.ENABLE)
    assert bench.permitted


def lose(bench: Bench, every: int, seconds: float, commands: bool = False) -> float | None:
    """Lose the answers, or the commands, of one cycle in `every`.

    Return the time until the fault (s), or None.
    """
    begin = bench.now
    for n in range(round(1000 * seconds)):
        lost = n % every == 0
        if lost and commands:
            bench.image.dropped += 1
        elif lost:
            bench.image.nodes[1].missed += 1
            bench.image.missed += 1
        bench.step(Request.ENABLE)
        if not bench.permitted:
            return bench.now - begin
    return None


@pytest.mark.parametrize("commands", [False, True])
@pytest.mark.parametrize(("every", "seconds"), [(6, None), (5, 0.996), (2, 0.399), (1, 0.2)])
def test_a_fifth_of_a_second_s_cycles_lost_is_a_fault_in_a_row_or_not(
    every: int, seconds: float | None, commands: bool
) -> None:
    bench = enabled()
    found = lose(bench, every, 5.0, commands)
    if seconds is None:
        assert found is None
        return
    assert found == pytest.approx(seconds, abs=1e-6)
    assert bench.cause is Cause.STALE_PDO
    assert re.search(
        "200 cycles within a second lost .*(commands|joint encoder node 32) 200", str(bench.supervisor.fault)
    )


def skip(bench: Bench, every: int, seconds: float, lost: int = 0) -> float | None:
    """Skip one period after every `every` cycles, and lose the answers of every `lost`-th cycle in between.

    Return the time until the fault (s), or None.
    """
    begin = bench.now
    cycle = 0
    while bench.now < begin + seconds:
        cycle += 1
        if cycle % every == 0:
            bench.now += 0.001
            bench.image.skipped += 1
            bench.image.overruns.add(bench.now, 1, 1.5 * 0.001)
        elif lost and cycle % lost == 0:
            bench.image.nodes[1].missed += 1
            bench.image.missed += 1
        bench.step(Request.ENABLE)
        if not bench.permitted:
            return bench.now - begin
    return None


@pytest.mark.parametrize(("every", "seconds"), [(5, None), (4, 0.999), (1, 0.4)])
def test_a_fifth_of_a_second_s_periods_skipped_is_a_fault_of_the_loop(every: int, seconds: float | None) -> None:
    bench = enabled()
    found = skip(bench, every, 5.0)
    if seconds is None:
        assert found is None
        return
    assert found == pytest.approx(seconds, abs=0.01)
    assert bench.cause is Cause.SKIPPED
    assert "200 of 1000 periods had no cycle: a cycle takes 1.5 ms; set rate = 500 in" in str(bench.supervisor.fault)


@pytest.mark.parametrize(("every", "lost", "cause"), [(6, 8, Cause.SKIPPED), (10, 6, Cause.STALE_PDO), (12, 12, None)])
def test_skipped_periods_and_lost_answers_count_together(every: int, lost: int, cause: Cause | None) -> None:
    """Neither reaches a fifth of a second alone. The cause is the one that lost more."""
    bench = enabled()
    assert (skip(bench, every, 3.0, lost) is None) is (cause is None)
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
    slow = Supervisor(SupervisionSettings(), rate=100.0)
    patient = Supervisor(SupervisionSettings(tolerated_misses=50), rate=100.0)
    for supervisor, most in ((slow, 20), (patient, 51)):
        bench = Bench()
        bench.supervisor = supervisor
        bench.step(Request.DISABLE, 5)
        bench.step(Request.ENABLE, 10)
        assert lose(bench, 1, 1.0) == pytest.approx(1e-3 * most)


@pytest.mark.parametrize("node", [0, 1])
@pytest.mark.parametrize(("rate", "most"), [(1000.0, 50), (100.0, 5), (20.0, 3)])
def test_repeated_pdos_of_a_node_in_a_twentieth_of_the_cycles_are_a_second_node(
    rate: float, most: int, node: int
) -> None:
    """An encoder counts like a drive, because forged angles drive the motor just as forged torques do."""
    bench = Bench()
    bench.supervisor = Supervisor(SupervisionSettings(), rate=rate)
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 10)
    for n in range(most):
        assert bench.permitted
        bench.image.nodes[node].repeated += 2
        bench.step(Request.ENABLE)
        assert bench.permitted is (n < most - 1)
    assert (bench.cause, bench.supervisor.needs_bring_up) == (Cause.REPEATED_PDO, True)


def test_answers_that_are_late_by_a_period_are_no_second_drive() -> None:
    """A second answer in a cycle belongs to a cycle that missed its answer. Any further answer is a surplus."""
    bench = Bench()
    bench.supervisor = Supervisor(SupervisionSettings(lost_share=1.0), rate=1000.0)
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 10)
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
    assert lose(bench, 1, 0.19) is None
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 10)
    assert lose(bench, 1, 0.19) is None


def test_no_miss_is_tolerated_when_told_so() -> None:
    bench = enabled(settings=SupervisionSettings(tolerated_misses=0))
    bench.image.misses, bench.image.fresh = 1, False
    bench.step(Request.ENABLE)
    assert (bench.permitted, bench.cause) == (False, Cause.STALE_PDO)


def test_torque_with_none_of_the_65536_statuswords_but_those_that_say_enabled_and_following() -> None:
    bench = enabled()
    template, image = bench.supervisor, bench.image
    wrong = []
    for statusword in range(65536):
        supervisor = copy.copy(template)
        supervisor.faults = []
        image.statusword = statusword
        _, permitted, _ = supervisor.update(image, bench.now, Request.ENABLE)
        if permitted is not (statusword & 0x6F == 0x27 and statusword & 0x1210 == 0x1210):
            wrong.append(statusword)
    assert wrong == []


@pytest.mark.parametrize(("low", "words"), [(0x1227, "bit 4 (voltage)"), (0x1037, "bit 9 (remote)")])
def test_a_power_stage_that_goes_off_while_the_state_says_enabled_is_a_lost_state(low: int, words: str) -> None:
    """One cycle is enough, because an unstable supply is off half of the time but never for long."""
    bench = enabled()
    before = WORDS[PowerState.OPERATION_ENABLED]
    try:
        WORDS[PowerState.OPERATION_ENABLED] = low
        bench.step(Request.ENABLE)
    finally:
        WORDS[PowerState.OPERATION_ENABLED] = before
    assert not bench.permitted
    fault = bench.supervisor.fault
    assert fault is not None
    assert (fault.cause, words in fault.detail) == (Cause.STATE_LOST, True)


def test_a_power_stage_that_is_off_at_the_next_enable_is_a_lost_state() -> None:
    """A reset while the supply is unstable does not erase what the drive once reported."""
    bench = enabled()
    bench.step(Request.DISABLE, 5)
    assert not bench.permitted
    before = WORDS[PowerState.OPERATION_ENABLED]
    try:
        WORDS[PowerState.OPERATION_ENABLED] = 0x1227
        bench.step(Request.ENABLE, 20)
    finally:
        WORDS[PowerState.OPERATION_ENABLED] = before
    assert (bench.permitted, bench.cause) == (False, Cause.STATE_LOST)


def test_a_drive_that_never_shows_voltage_and_remote_runs_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some drives never set bits 4 and 9."""
    for state, word in WORDS.items():
        monkeypatch.setitem(WORDS, state, word & ~0x0210)
    bench = enabled()
    bench.step(Request.ENABLE, 5)
    assert bench.permitted


@pytest.mark.parametrize("low", [0x0010, 0x0200])
def test_a_power_stage_that_is_off_at_the_first_enable_is_a_lost_state(
    monkeypatch: pytest.MonkeyPatch, low: int
) -> None:
    """The supply was present while the drive was ready. An unstable supply may be off just at the enable."""
    monkeypatch.setitem(WORDS, PowerState.OPERATION_ENABLED, WORDS[PowerState.OPERATION_ENABLED] & ~low)
    bench = Bench()
    bench.step(Request.DISABLE, 5)
    bench.step(Request.ENABLE, 10)
    assert (bench.permitted, bench.cause) == (False, Cause.STATE_LOST)


@pytest.mark.parametrize("low", [0x0010, 0x0200])
def test_a_power_stage_that_was_off_until_the_enable_is_watched_from_when_it_is_on(
    monkeypatch: pytest.MonkeyPatch, low: int
) -> None:
    """An unstable supply may have been off in every cycle before."""
    good = dict(WORDS)
    for state, word in good.items():
        monkeypatch.setitem(WORDS, state, word & ~low)
    bench = enabled()
    bench.step(Request.ENABLE, 5)
    assert bench.permitted
    monkeypatch.setitem(WORDS, PowerState.OPERATION_ENABLED, good[PowerState.OPERATION_ENABLED])
    bench.step(Request.ENABLE, 5)
    assert bench.permitted
    monkeypatch.setitem(WORDS, PowerState.OPERATION_ENABLED, good[PowerState.OPERATION_ENABLED] & ~low)
    bench.step(Request.ENABLE)
    assert (bench.permitted, bench.cause) == (False, Cause.STATE_LOST)


def test_an_event_that_is_no_fault_leaves_the_torque() -> None:
    """A node has returned to operational, and the event is evaluated in an unusual cycle."""
    bench = enabled()
    bench.image.events += 1
    bench.step(Request.ENABLE)
    assert bench.permitted
    assert bench.controlword == Controlword.ENABLE_OPERATION


def test_a_drive_that_obeys_is_not_cut_off() -> None:
    assert Supervisor(SupervisionSettings()).cut_off is False
    bench = enabled()
    bench.supervisor.trip(Finding(Cause.NOT_FINITE, "a limit"), bench.now)
    cut = []
    for _ in range(500):
        bench.step(Request.ENABLE)
        cut.append(bench.supervisor.cut_off)
    assert not any(cut)
    assert not bench.supervisor.needs_bring_up


def test_a_drive_that_stays_enabled_after_a_fault_is_stopped_by_nmt_again_and_again() -> None:
    """NMT stops the drive 50 ms after the command to leave, and every 50 ms until the drive confirms.

    Then all nodes must be configured again.
    """
    bench = enabled()
    bench.obeys = False
    bench.supervisor.trip(Finding(Cause.NOT_FINITE, "a limit"), bench.now)
    begin = bench.now
    at = []
    for _ in range(220):
        bench.step(Request.ENABLE)
        if bench.supervisor.cut_off:
            at.append(round(bench.now - begin, 3))
    assert at == pytest.approx([0.051, 0.101, 0.151, 0.201], abs=2e-3)
    assert bench.supervisor.needs_bring_up
    bench.state = PowerState.FAULT
    bench.step(Request.ENABLE, 200)
    assert not bench.supervisor.cut_off


def test_bit_12_is_asked_for_unless_the_profile_says_otherwise() -> None:
    supervisor, bench = Supervisor(SupervisionSettings()), Bench()
    bench.supervisor = supervisor
    bench.step(Request.DISABLE, 3)
    WORDS[PowerState.OPERATION_ENABLED] = 0x0237
    try:
        bench.step(Request.ENABLE, 50)
        assert not bench.permitted
    finally:
        WORDS[PowerState.OPERATION_ENABLED] = 0x1237


def test_fault_reset_comes_20_ms_after_bit_7_was_low() -> None:
    _, words = reset_after_a_drive_fault()
    assert words.index(0x80) in (20, 21)  # 1 ms each


def test_emergency_before_the_first_cycle_is_seen() -> None:
    bench = Bench()
    bench.emergency()
    bench.step(Request.DISABLE)
    assert bench.cause is Cause.EMERGENCY


def test_enable_that_returns_while_disabling_gives_no_torque() -> None:
    bench = enabled()
    bench.obeys = False
    bench.step(Request.DISABLE)
    for _ in range(100):
        bench.step(Request.ENABLE)
        assert (bench.permitted, bench.controlword) == (False, Controlword.SHUTDOWN)
    assert bench.supervisor.phase is Phase.DISABLING
    bench.state = PowerState.READY_TO_SWITCH_ON
    bench.step(Request.ENABLE)
    assert bench.supervisor.phase is Phase.STANDBY


def test_enable_that_takes_too_long_is_off_in_the_same_cycle() -> None:
    bench = Bench()
    bench.obeys = False
    bench.step(Request.DISABLE, 3)
    while bench.cause is None:
        bench.step(Request.ENABLE)
        assert bench.now < 3.0
    assert (bench.cause, bench.controlword) == (Cause.ENABLE_TIMEOUT, Controlword.DISABLE_VOLTAGE)


@pytest.mark.parametrize("request_", [Request.RESET, Request.DISABLE])
def test_anything_but_enable_takes_the_torque_away(request_: Request) -> None:
    bench = enabled()
    bench.obeys = False
    bench.step(request_)
    assert (bench.permitted, bench.supervisor.phase) == (False, Phase.DISABLING)


@pytest.mark.parametrize("drops", [1, 2])
def test_tolerated_drops_do_not_stop(drops: int) -> None:
    bench = enabled()
    bench.image.drops = drops
    bench.step(Request.ENABLE)
    assert bench.permitted


@pytest.mark.parametrize("limit", [0, 1, 5])
def test_one_drop_or_miss_more_than_tolerated_stops(limit: int) -> None:
    settings = SupervisionSettings(tolerated_misses=limit, tolerated_drops=limit)
    for attribute, cause in (("misses", Cause.STALE_PDO), ("drops", Cause.COMMAND_DROPPED)):
        bench = enabled(settings=settings)
        setattr(bench.image, attribute, limit)
        bench.step(Request.ENABLE)
        assert bench.permitted
        setattr(bench.image, attribute, limit + 1)
        bench.step(Request.ENABLE)
        assert (bench.permitted, bench.cause) == (False, cause)


def test_fault_reaction_is_a_drive_fault_already() -> None:
    bench = enabled()
    WORDS[PowerState.OPERATION_ENABLED] = 0x021F
    try:
        bench.step(Request.ENABLE)
    finally:
        WORDS[PowerState.OPERATION_ENABLED] = 0x1237
    assert (bench.permitted, bench.cause) == (False, Cause.DRIVE_FAULT)


def rearmed(bench: Bench) -> None:
    """Apply the changes that the rig makes to the image after a bring-up."""
    for health in bench.image.nodes:
        health.boot_ups, health.emcys, health.nmt_state = 0, 0, NmtState.OPERATIONAL
        health.emcy = None
    bench.image.events = 0
    bench.supervisor.configured(bench.image)


def test_after_a_bring_up_old_emergencies_are_forgotten() -> None:
    bench = enabled()
    bench.emergency()
    boot_up(bench)
    bench.step(Request.ENABLE, 3)
    rearmed(bench)
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
    rearmed(bench)
    bench.emergency()
    bench.image.events = seen  # the same number of events as before the bring-up does not mean the same events
    bench.step(Request.DISABLE)
    assert [fault.cause for fault in bench.supervisor.faults] == [Cause.BOOT_UP, Cause.EMERGENCY]


@pytest.mark.parametrize("wrong", ["mode", "fresh"])
def test_enabled_needs_mode_and_fresh_answers_in_the_same_cycle(wrong: str) -> None:
    bench = Bench()
    bench.step(Request.DISABLE, 3)
    bench.step(Request.ENABLE, 3)
    assert bench.state is PowerState.OPERATION_ENABLED
    setattr(bench.image, wrong, {"mode": 8, "fresh": False}[wrong])
    bench.step(Request.ENABLE, 5)
    assert (bench.permitted, bench.supervisor.phase) == (False, Phase.ENABLING)


def test_drive_in_another_mode_is_never_told_to_enable() -> None:
    bench = Bench()
    bench.image.mode = 1
    bench.step(Request.DISABLE, 3)
    words = set()
    for _ in range(100):
        bench.step(Request.ENABLE)
        words.add(bench.controlword)
    assert words == {Controlword.SHUTDOWN}


def test_disabling_has_its_own_time() -> None:
    bench = enabled()
    bench.step(Request.ENABLE, 3000)
    bench.obeys = False
    bench.step(Request.DISABLE, 950)
    assert (bench.supervisor.phase, bench.cause) == (Phase.DISABLING, None)
    bench.step(Request.DISABLE, 100)
    assert bench.cause is Cause.DISABLE_TIMEOUT


@pytest.mark.parametrize("state", [PowerState.READY_TO_SWITCH_ON, PowerState.SWITCH_ON_DISABLED])
def test_either_state_without_power_confirms_the_disable(state: PowerState) -> None:
    bench = enabled()
    bench.obeys = False
    bench.step(Request.DISABLE)
    bench.state = state
    bench.step(Request.DISABLE)
    assert bench.supervisor.phase is Phase.STANDBY


def test_reset_waits_for_the_end_of_the_fault_reaction() -> None:
    bench = enabled()
    drive_fault(bench)
    bench.step(Request.ENABLE, 5)
    bench.obeys = False
    WORDS[PowerState.FAULT] = 0x021F
    try:
        for _ in range(1900):
            bench.step(Request.RESET)
            assert (bench.supervisor.phase, bench.controlword) == (Phase.RESETTING, Controlword.DISABLE_VOLTAGE)
        bench.step(Request.RESET, 200)
    finally:
        WORDS[PowerState.FAULT] = 0x0218
    assert [fault.cause for fault in bench.supervisor.faults] == [Cause.DRIVE_FAULT, Cause.RESET_TIMEOUT]


def test_stale_answers_while_resetting_are_judged_by_its_time_out() -> None:
    bench = enabled()
    bench.emergency()
    bench.step(Request.ENABLE, 5)
    bench.step(Request.DISABLE)
    bench.image.misses, bench.image.fresh = 10, False
    bench.supervisor._enter(Phase.RESETTING, bench.now)
    bench.step(Request.RESET, 1900)
    assert bench.supervisor.phase is Phase.RESETTING
    bench.step(Request.RESET, 200)
    assert str(bench.supervisor.faults[1]) == "drive does not leave its fault: no fresh PDO"


def test_dropped_commands_while_resetting_are_not_excused() -> None:
    bench = enabled()
    bench.emergency()
    bench.step(Request.ENABLE, 5)
    bench.image.fresh = False
    bench.step(Request.RESET, 3)
    bench.image.drops = 9
    bench.step(Request.RESET)
    assert bench.supervisor.phase is Phase.FAULT


def test_stale_answers_in_standby_are_a_fault() -> None:
    bench = Bench()
    bench.step(Request.DISABLE, 3)
    bench.image.misses, bench.image.fresh = 3, False
    bench.step(Request.DISABLE)
    assert bench.cause is Cause.STALE_PDO


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        ({}, "joint encoder node 32: 3 cycles in a row"),
        ({"late": 2}, "joint encoder node 32: 3 cycles in a row (since the start late 2)"),
        (
            {"late": 2, "repeated": 1, "malformed": 4},
            "joint encoder node 32: 3 cycles in a row (since the start late 2, repeated 1, wrong length 4)",
        ),
    ],
)
def test_stale_answers_name_the_node_and_what_came_instead(counts: dict[str, int], words: str) -> None:
    bench = enabled()
    health = bench.image.nodes[1]
    health.misses = bench.image.misses = 3
    bench.image.fresh = False
    for name, count in counts.items():
        setattr(health, name, count)
    bench.step(Request.ENABLE)
    assert bench.supervisor.fault is not None
    assert bench.supervisor.fault.detail == words


def test_stale_answers_of_one_node_all_the_time_are_its_own() -> None:
    bench = enabled()
    bench.image.nodes[0].misses, bench.image.nodes[1].misses, bench.image.misses = 3, 1, 3
    bench.image.fresh = False
    bench.step(Request.ENABLE)
    assert bench.supervisor.fault is not None
    assert bench.supervisor.fault.detail == (
        "drive node 1: 3 cycles in a row; joint encoder node 32: 1 cycles in a row"
    )


def test_stale_answers_of_different_nodes_in_turn_say_how_many_cycles_in_all() -> None:
    bench = enabled()
    bench.image.nodes[1].misses, bench.image.misses = 1, 3
    bench.image.fresh = False
    bench.step(Request.ENABLE)
    assert bench.supervisor.fault is not None
    found = "3 cycles in a row without all answers, at the end joint encoder node 32: 1 cycles in a row"
    assert bench.supervisor.fault.detail == found


def test_news_that_are_no_bad_news_do_not_stop() -> None:
    bench = enabled()
    bench.image.events += 1
    bench.step(Request.ENABLE)
    assert (bench.permitted, bench.controlword, bench.cause) == (True, Controlword.ENABLE_OPERATION, None)


class AnyOrder(RuleBasedStateMachine):
    """Random statuswords, events, requests and resets: torque only if everything is good and torque was requested."""

    @initialize()
    def begin(self) -> None:
        self.bench = Bench()
        self.asked = False  # ENABLE was requested again since the last stop
        self.last = Request.DISABLE

    def cycle(self, request: Request) -> None:
        bench = self.bench
        if request is not Request.ENABLE:
            self.asked = False
        elif self.last is not Request.ENABLE and bench.supervisor.phase is Phase.STANDBY:
            self.asked = True
        bench.step(request)
        self.last = request
        if bench.supervisor.faults:
            self.asked = False

    @rule(request=st.sampled_from(Request), cycles=st.integers(1, 40))
    def run(self, request: Request, cycles: int) -> None:
        for _ in range(cycles):
            self.cycle(request)
            self.torque_only_when_all_is_good()

    @rule(statusword=st.integers(0, 65535))
    def lie(self, statusword: int) -> None:
        bench = self.bench
        bench.now += 1e-3
        bench.image.statusword = statusword
        bench.controlword, bench.permitted, _ = bench.supervisor.update(bench.image, bench.now, self.last)
        if bench.supervisor.faults:
            self.asked = False

    @rule(state=st.sampled_from(list(WORDS)))
    def jump(self, state: PowerState) -> None:
        self.bench.state = state

    @rule(mode=st.sampled_from([10, 10, 8, 0]))
    def change_mode(self, mode: int) -> None:
        self.bench.image.mode = mode

    @rule(misses=st.sampled_from([0, 0, 1, 2, 3, 50]))
    def miss(self, misses: int) -> None:
        self.bench.image.misses = misses
        self.bench.image.fresh = misses == 0

    @rule(node=st.integers(0, 2))
    def emergency(self, node: int) -> None:
        self.bench.emergency(node)

    @rule()
    def boot(self) -> None:
        boot_up(self.bench)

    @precondition(lambda self: self.bench.supervisor.needs_bring_up)
    @rule()
    def bring_up(self) -> None:
        image = self.bench.image
        for health in image.nodes:
            health.boot_ups, health.nmt_state, health.emcys = 0, NmtState.OPERATIONAL, 0
        image.events = 0
        self.bench.supervisor.configured(image)

    @rule(obeys=st.booleans())
    def obey(self, obeys: bool) -> None:
        self.bench.obeys = obeys

    @invariant()
    def torque_only_when_all_is_good(self) -> None:
        bench = getattr(self, "bench", None)
        if bench is None or not bench.permitted:
            return
        image, supervisor = bench.image, bench.supervisor
        assert self.asked
        assert supervisor.phase is Phase.ENABLED
        assert supervisor.faults == []
        assert decode(image.statusword) is PowerState.OPERATION_ENABLED
        assert image.statusword & 0x1000
        assert bench.controlword is Controlword.ENABLE_OPERATION

    @invariant()
    def a_fault_keeps_the_power_stage_off_but_for_its_reset(self) -> None:
        bench = getattr(self, "bench", None)
        if bench is not None and bench.supervisor.phase is Phase.FAULT:
            assert bench.controlword is Controlword.DISABLE_VOLTAGE
            assert bench.supervisor.fault is not None


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = hypothesis_settings(max_examples=60, stateful_step_count=40, deadline=None)


def test_an_hour_of_standby_is_no_time_that_enabling_took() -> None:
    bench = Bench()
    bench.now = 3600.0
    bench.step(Request.DISABLE, 3)
    bench.step(Request.ENABLE, 10)
    assert (bench.permitted, bench.supervisor.fault) == (True, None)


def test_enable_in_the_cycle_after_a_reset_needs_a_disable_before_it() -> None:
    bench = enabled()
    bench.state = PowerState.FAULT
    bench.step(Request.DISABLE, 5)
    for _ in range(200):
        bench.step(Request.RESET)
        if bench.supervisor.fault is None:
            break
    for _ in range(100):
        bench.step(Request.ENABLE)
        assert (bench.permitted, bench.supervisor.phase) == (False, Phase.STANDBY)
    bench.step(Request.DISABLE)
    bench.step(Request.ENABLE, 10)
    assert bench.permitted


def test_enable_that_returned_while_disabling_needs_a_disable_before_it() -> None:
    bench = enabled()
    bench.step(Request.DISABLE)
    assert bench.supervisor.phase is Phase.DISABLING
    for _ in range(100):
        bench.step(Request.ENABLE)
        assert not bench.permitted
    assert bench.supervisor.phase is Phase.STANDBY


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


def test_time_out_of_an_enabled_drive_says_what_is_missing() -> None:
    bench = Bench()
    bench.step(Request.DISABLE, 3)
    bench.obeys = False
    bench.state, bench.image.fresh = PowerState.OPERATION_ENABLED, False
    bench.step(Request.ENABLE, 5000)
    fault = bench.supervisor.faults[0]
    assert fault.cause is Cause.ENABLE_TIMEOUT
    assert fault.detail == "drive is in operation_enabled after 2 s, without fresh PDOs"


def test_drive_that_comes_back_enabled_in_a_fault_has_its_time_to_obey() -> None:
    bench = enabled()
    bench.supervisor.trip(Finding(Cause.OVER_SPEED, "x"), bench.now)
    bench.obeys = False
    bench.state = PowerState.SWITCH_ON_DISABLED
    bench.step(Request.DISABLE, 300)
    bench.state = PowerState.OPERATION_ENABLED
    cut = []
    for _ in range(60):
        bench.step(Request.DISABLE)
        cut.append(bench.supervisor.cut_off)
    assert (any(cut[:40]), sum(cut)) == (False, 1)


def test_further_faults_do_not_put_off_the_cut_off() -> None:
    bench = enabled()
    bench.obeys = False
    cut = []
    for _ in range(60):
        bench.supervisor.trip(Finding(Cause.OVER_SPEED, "x"), bench.now)
        bench.step(Request.DISABLE)
        cut.append(bench.supervisor.cut_off)
    assert any(cut)
