"""The supervisor compared with a small model of it, for any sequence of events (stateful tests of hypothesis).

The model tracks if a fault is latched, if the nodes must be configured again, if a request for torque would count, and
if torque is allowed. It does not use the supervisor's own phases.
"""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from tests.safety.test_supervisor import Bench
from tsa_ctrl.bus.canopen.cia301 import NmtState
from tsa_ctrl.bus.canopen.cia402 import Controlword, PowerState, decode
from tsa_ctrl.bus.wire.bus import BusFault
from tsa_ctrl.safety.causes import Cause, Fault
from tsa_ctrl.safety.supervisor import Phase, Request

BRING_UP = {  # events that invalidate the nodes' configuration
    "bus-off": Cause.BUS_FAULT,
    "intruder": Cause.SECOND_MASTER,
    "altered": Cause.ALTERED,
    "boot-up": Cause.BOOT_UP,
    "silent": Cause.HEARTBEAT_LOST,
    "left": Cause.NMT_STATE,
}
ALONE = {
    "emergency": Cause.EMERGENCY,
    "stop": Cause.EMERGENCY_STOP,
    "stale": Cause.STALE_PDO,
    "dropped": Cause.COMMAND_DROPPED,
}


class Model(RuleBasedStateMachine):
    """The allowed and the required behaviour."""

    @initialize()
    def begin(self) -> None:
        self.bench = Bench()
        self.latched: Fault | None = None
        self.configure = False  # required before a reset can have an effect
        self.armed = False  # a request other than ENABLE came since the start or since the last fault
        self.request = Request.DISABLE

    def cycle(self, request: Request) -> None:
        """Run one cycle, and update the model with the request."""
        bench = self.bench
        before = bench.supervisor.fault
        bench.step(request)
        now = bench.supervisor.fault
        if before is None and now is not None:
            self.latched = now
            self.configure = now.cause.needs_bring_up
        elif before is not None and now is None:
            assert not self.configure, "a reset did what only a bring-up may"
            self.latched, self.armed = None, False
        if now is not None:
            self.armed = False
        elif before is None and request is not Request.ENABLE:
            self.armed = True
        self.request = request

    # actions of the operator

    @rule(request=st.sampled_from(Request), cycles=st.integers(1, 30))
    def ask(self, request: Request, cycles: int) -> None:
        for _ in range(cycles):
            self.cycle(request)

    @rule()
    def want_torque(self) -> None:
        """Disable, then enable. Without a fault, this must enable the torque."""
        for request, cycles in ((Request.DISABLE, 5), (Request.ENABLE, 10)):
            for _ in range(cycles):
                self.cycle(request)
        if self.latched is None:
            assert self.bench.permitted

    @precondition(lambda self: self.latched is not None)
    @rule()
    def recover(self) -> None:
        """Configure the nodes if required, then reset. The fault is cleared, and torque waits for a request."""
        bench = self.bench
        bench.configure()
        self.configure = False
        for request, cycles in ((Request.DISABLE, 2), (Request.RESET, 60)):
            for _ in range(cycles):
                self.cycle(request)
        assert bench.supervisor.fault is None
        assert not bench.permitted

    @precondition(lambda self: self.latched is not None and self.configure)
    @rule()
    def reset_alone(self) -> None:
        """A reset alone has no effect while the nodes must be configured."""
        self.bench.heal()
        for request, cycles in ((Request.DISABLE, 2), (Request.RESET, 60), (Request.DISABLE, 2), (Request.ENABLE, 20)):
            for _ in range(cycles):
                self.cycle(request)
        assert self.bench.supervisor.fault is not None

    # events

    @rule(what=st.sampled_from(sorted(BRING_UP | ALONE)), node=st.integers(0, 2))
    def happen(self, what: str, node: int) -> None:
        """An event latches a fault in its cycle, for any request. The first fault remains the reported one."""
        image, before = self.bench.image, self.bench.supervisor.fault
        health = image.nodes[node]
        if what == "bus-off":
            image.bus_fault = BusFault.BUS_OFF
        elif what == "intruder":
            image.intruder = 0x201
        elif what == "altered":
            image.altered = "drive node 1: another"
        elif what == "stop":
            image.pressed = "drive node 1: bit 3"
        elif what == "boot-up":
            health.boot_ups += 1
            image.events += 1
        elif what == "left":
            health.nmt_state = NmtState.PRE_OPERATIONAL
            image.events += 1
        elif what == "silent":
            image.silent = health
        elif what == "emergency":
            self.bench.emergency(node)
        elif what == "stale":
            health.misses = image.misses = 3
        else:
            image.drops = 3
        self.cycle(self.request)
        supervisor = self.bench.supervisor
        if before is None:
            assert supervisor.fault is not None
            assert supervisor.fault.cause is (BRING_UP | ALONE)[what]
        elif what in BRING_UP:
            assert supervisor.needs_bring_up
        self.configure = self.configure or what in BRING_UP
        self.bench.heal()

    @rule(cycles=st.integers(1, 3))
    def lose_the_power_stage(self, cycles: int) -> None:
        """The drive leaves operation enabled on its own. Without torque this is not a fault."""
        had, self.bench.state = self.bench.permitted, PowerState.SWITCH_ON_DISABLED
        for _ in range(cycles):
            self.cycle(self.request)
        if had and self.request is Request.ENABLE:
            assert self.bench.supervisor.fault is not None

    @rule(statusword=st.integers(0, 65535), mode=st.sampled_from([10, 8, 0]), fresh=st.booleans())
    def lie(self, statusword: int, mode: int, fresh: bool) -> None:
        """For one cycle, the drive reports any statusword and mode."""
        bench = self.bench
        bench.words[bench.state] = statusword
        bench.image.mode, bench.image.fresh = mode, fresh
        self.cycle(self.request)
        self.torque_only_when_everything_agrees()
        bench.heal()

    @rule(obeys=st.booleans(), state=st.sampled_from(PowerState), request=st.sampled_from(Request))
    def go_astray(self, obeys: bool, state: PowerState, request: Request) -> None:
        """The drive may change to any state, and may ignore commands for 20 cycles."""
        bench = self.bench
        bench.state = state if state in bench.words else bench.state
        bench.obeys = obeys
        for _ in range(20):
            self.cycle(request)
            self.torque_only_when_everything_agrees()
        bench.obeys = True

    # invariants

    @invariant()
    def torque_only_when_everything_agrees(self) -> None:
        bench = self.bench
        if bench.permitted:
            assert bench.supervisor.phase is Phase.ENABLED
            assert self.latched is None
            assert self.armed
            assert self.request is Request.ENABLE
            assert decode(bench.image.statusword) is PowerState.OPERATION_ENABLED
            assert bench.image.statusword & 0x1210 == 0x1210
            assert (bench.image.mode, bench.image.misses < 3) == (10, True)
            assert bench.controlword == Controlword.ENABLE_OPERATION

    @invariant()
    def a_fault_stays_the_same_and_takes_the_drive_off(self) -> None:
        assert self.bench.supervisor.fault == self.latched
        if self.latched is not None:
            assert self.bench.controlword in (Controlword.DISABLE_VOLTAGE, Controlword.FAULT_RESET)
            assert self.bench.supervisor.needs_bring_up or not self.configure


TestSupervisor = Model.TestCase
TestSupervisor.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)
