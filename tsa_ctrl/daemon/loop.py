"""Real-time loop: wait for an absolute deadline, run and record a cycle, take a command, and react to faults."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial

from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import SupervisionSettings
from tsa_ctrl.config import ControllerSection
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.cycle import after_commands, run_cycle
from tsa_ctrl.control.live_parameters import Tuner
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.daemon.monitoring import SecondChannel
from tsa_ctrl.daemon.notices import Events, Notices
from tsa_ctrl.daemon.summary import TorqueErrorCounter
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.ipc.mailbox import RECOVER, RELEASE, Mailbox
from tsa_ctrl.ipc.protocol import STATUS_RATE
from tsa_ctrl.safety.causes import REMEDIES, Cause
from tsa_ctrl.safety.release import ReleaseBudget
from tsa_ctrl.safety.supervisor import Phase, Request
from tsa_ctrl.system.histogram import count
from tsa_ctrl.system.realtime import Ticker

SETTLE_TIME = 3.0  # s beyond the settling cycles after which startup is abandoned
RESET_TIME = 0.5  # s beyond the supervisors' own time-out
STOP_TIME = 2.0  # s beyond ramp and confirmation after which the loop ends in any case


class Loop:
    """Run cycles until a stop is requested; `cause` is the first reason to end."""

    def __init__(
        self,
        rig: Rig,
        axes: Sequence[ControlAxis],
        tuners: Sequence[Tuner],
        mailbox: Mailbox,
        telemetry: Telemetry,
        events: Events,
        settings: ControllerSection,
        supervision: SupervisionSettings,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.phase = LoopPhase.SETTLING
        self.cause: str | None = None
        self.events = events
        self.cycles = 0
        self.late = 0  # cycles that began more than half a period late
        self.stop_began = math.inf  # s on the log's clock, at which the final ramp of the torque to 0 began
        self.channel = SecondChannel()  # the monitor process, if there is one
        self.recover = False  # the bus must be brought up again before `run` continues
        self._clock = clock
        self._rig = rig
        self._axes = axes
        self._tuners = tuners
        self._mailbox = mailbox
        self._telemetry = telemetry
        self._settings = settings
        self._period = 1.0 / settings.rate
        self.torque_errors = [TorqueErrorCounter(axis, self._period) for axis in axes]
        self._collect = settings.collect / settings.rate
        self._ticker = Ticker(round(1e9 / settings.rate), 0)
        self._start = 0
        self._publish_every = max(1, round(settings.rate / STATUS_RATE))
        self._check_every = self._publish_every * round(STATUS_RATE)
        self._settled = 0
        self._ran = False
        self._since = 0.0
        self._stop_time = settings.stop_time + supervision.disable_timeout + STOP_TIME
        self._recovery_asked = math.inf  # s
        self._releases = ReleaseBudget()
        self._recovered = self._failed = 0  # recoveries that ended with torque, and with a fault
        self._over = 0  # number of the first event after the last recovery
        self.faulty = False  # a fault occurred after the last recovery
        self._recovering = False
        self._reset_time = supervision.reset_timeout + RESET_TIME
        self._stop: str | None = None
        self._faults = [0] * len(axes)
        self._back_offs = [0] * len(axes)
        self._limited = [0] * len(axes)
        self._notices = Notices(axes, events, self._ticker.history)
        for index, axis in enumerate(axes):
            axis.image.overruns = self._ticker.history
            axis.connect(partial(mailbox.wanted, index))

    def attach(self, channel: SecondChannel) -> None:
        """Follow the monitor of this run from now on."""
        self.channel = self._telemetry.channel = channel
        self._rig.monitor_acted = channel.acted

    @property
    def start(self) -> float:
        """Return the monotonic time of the first cycle, s."""
        return self._start * 1e-9

    @property
    def planned(self) -> int:
        """Return the number of periods that were run or skipped."""
        return self.cycles + self.skipped

    @property
    def overruns(self) -> int:
        return self._ticker.overruns

    @property
    def skipped(self) -> int:
        return self._ticker.skipped

    def stop(self, cause: str) -> None:
        """Request the end of the run; the first cause is kept. Safe in a signal handler."""
        if self._stop is None:
            self._stop = cause

    @property
    def stop_asked(self) -> str | None:
        """Return the origin of the stop request, or None; also valid before `run`."""
        return self._stop or ("tsa stop" if self._mailbox.stop_requested else None)

    def note(self, text: str) -> None:
        """Store an event that occurred outside the cycles."""
        self.events.add((self._clock() - self._start) * 1e-9, "", text)

    def last_words(self, unconfirmed: Sequence[str]) -> None:
        """Log the reason for the end of the run, after the drives were shut down."""
        if self._start:
            self._telemetry.last_words(self._t(self._clock()), self.cause or "an error", unconfirmed)

    def run(self, seconds: float = math.inf, first: LoopPhase = LoopPhase.SETTLING) -> None:
        """Run until stopped, or for `seconds` of torque or fault; after a new bring-up with another `first` phase."""
        ticker, telemetry = self._ticker, self._telemetry
        clock, wait = self._clock, self._rig.wait
        ticker.deadline = clock() + ticker.period
        if self._start == 0:
            self._start = ticker.deadline
            self._notices.begin()
        else:  # stay on the time grid of the log; a bring-up leaves a hole in it
            ticker.deadline += -(ticker.deadline - self._start) % ticker.period
        self.recover = False
        ticker.history.clear()
        self._enter(first, ticker.deadline)
        self._settled = 0
        lateness, work = self._mailbox.lateness, self._mailbox.work
        start, period, half = self._start, ticker.period, ticker.period // 2
        while self.phase is not LoopPhase.ENDED and not self.recover:
            planned = ticker.deadline
            now = wait(planned * 1e-9)
            woke = round(now * 1e9)
            late = (woke - planned) * 1e-9
            for axis in self._axes:
                axis.law.late = late
            run_cycle(self._rig, self._axes, now, now + self._collect)
            done = clock()
            after_commands(self._rig, self._axes, now)
            count(lateness, woke - planned)
            if woke - planned > half:
                self.late += 1
            count(work, done - woke)
            for counter in self.torque_errors:
                counter.update()
            telemetry.record(
                (planned - start) * 1e-9, (planned - start) // period, (woke - planned) * 1e-9, (done - woke) * 1e-9
            )
            telemetry.measure(now, (planned - start) // period, self.phase.value)
            self.cycles += 1
            self._take_command(planned)
            self._judge(planned, seconds)
            if self.cycles % self._publish_every == 0:
                self.publish(planned)
            gone = ticker.advance(clock())
            if gone:
                for axis in self._axes:
                    axis.skip_cycles(gone)
        self.publish(ticker.deadline)

    def publish(self, planned: int) -> None:
        """Write the status for the socket server; once a second, check log, sensors, bus, server and losses."""
        ticker = self._ticker
        if self.cycles % self._check_every == 0:
            self._telemetry.check(self._t(planned), self.cycles * len(self._axes))
            self._notices.update_losses(self._t(planned), self.cycles)
        if self.phase in (LoopPhase.SETTLING, LoopPhase.RUNNING):
            self._notices.update_skipped(self._t(planned), planned * 1e-9, self._settings.rate)
        self._notices.update(self._t(planned))
        counts = (self.cycles, self.planned, ticker.skipped, ticker.overruns)
        recovery = (self._recovered, self._failed, self._over)
        self._telemetry.publish(planned * 1e-9, self._start * 1e-9, counts, self.phase.value, self._releases, recovery)

    def _take_command(self, planned: int) -> None:
        """Process at most one command, and move every changing parameter by one step."""
        command = self._mailbox.take()
        if command is not None:
            if command.parameter == RECOVER:
                self._ask_for_recovery(planned)
            elif command.parameter == RELEASE:
                self._release(self._axes[command.axis], planned)
            else:
                self._tuners[command.axis].set(command.parameter, command.value)
        for tuner in self._tuners:
            tuner.update()

    def _judge(self, planned: int, seconds: float) -> None:
        """Update the phase of the loop. The supervisors have already acted on the torque."""
        now = planned * 1e-9
        self._stop = self.stop_asked
        self._follow_monitor(planned)
        self._note_faults(planned)
        phase = self.phase
        if self._stop is not None and phase is not LoopPhase.STOPPING:
            self.cause = self.cause or self._stop
            self.stop_began = self._t(planned)
            for axis in self._axes:
                axis.stop()
            self._enter(LoopPhase.STOPPING, planned)
        elif now - self._since >= seconds and phase in (LoopPhase.RUNNING, LoopPhase.FAULTED):
            self.stop(f"{seconds:g} s are over")
        elif phase is LoopPhase.SETTLING:
            self._settle(planned)
        elif phase is LoopPhase.RESETTING:
            self._reset(planned)
        elif phase is LoopPhase.FAULTED:
            self._begin_recovery(planned)
        elif phase is LoopPhase.STOPPING and (
            all(axis.at_rest for axis in self._axes) or now - self._since > self._stop_time
        ):
            self._enter(LoopPhase.ENDED, planned)

    def _settle(self, planned: int) -> None:
        """Enable the axes after all answers have arrived in enough consecutive cycles."""
        self._settled = self._settled + 1 if all(axis.image.fresh for axis in self._axes) else 0
        if self._settled >= self._settings.settle_cycles:
            for axis in self._axes:
                axis.enable()
            self._ran = True
            self._enter(LoopPhase.RUNNING, planned)
        elif planned * 1e-9 - self._since > self._settings.settle_cycles * self._period + SETTLE_TIME:
            text = f"the nodes do not answer every SYNC; {Cause.STALE_PDO.remedy}"
            self.events.add(self._t(planned), "", text, Cause.STALE_PDO)
            self.faulty = True
            self.stop(text)

    def _reset(self, planned: int) -> None:
        """Hold the reset until every supervisor is back in standby, then settle again."""
        standby = all(axis.supervisor.phase is Phase.STANDBY for axis in self._axes)
        if not standby and planned * 1e-9 - self._since < self._reset_time:
            return
        for index, axis in enumerate(self._axes):
            axis.request = Request.DISABLE
            self._faults[index] = len(axis.supervisor.faults)
        self._settled = 0
        self._enter(LoopPhase.SETTLING if standby else LoopPhase.FAULTED, planned)

    def _ask_for_recovery(self, planned: int) -> None:
        """Begin a recovery from a latched fault if the budget of releases permits one."""
        if self.phase is LoopPhase.FAULTED and self._permits("recovery", "", planned):
            self._recovery_asked = planned * 1e-9

    def _release(self, axis: ControlAxis, planned: int) -> None:
        """Release the latch of an axis' guard if the budget of releases permits it."""
        if axis.guard.latched and self._permits("release of the guard's latch", axis.name, planned):
            axis.guard.release()

    def _permits(self, what: str, axis: str, planned: int) -> bool:
        """Return True if the budget permits a release; count it, and report either result as an event."""
        now = planned * 1e-9
        permitted = self._releases.take(now)
        wait = max(0.0, self._releases.next - now)
        text = (
            f"{what} number {self._releases.count} on request"
            if permitted
            else f"{what} rejected: the next one is permitted in {wait:.3g} s; find the cause of the fault first"
        )
        self.events.add(self._t(planned), axis, text)
        return permitted

    def _begin_recovery(self, planned: int) -> None:
        """Reset the faults that can be reset, or start a bring-up, after a request and once no axis has torque.

        The loop waits for an axis that still ramps to 0 because of another axis' fault, and until its drive reports
        that it is off. A drive that does not report it needs a bring-up, which switches it off before the reset.
        """
        waited = planned * 1e-9 - self._recovery_asked
        if not waited >= 0.0 or (not all(axis.is_off for axis in self._axes) and waited < self._stop_time):
            return
        self._recovery_asked = math.inf
        self._recovering = True
        self.recover = self.channel.failed or any(axis.supervisor.needs_bring_up for axis in self._axes)
        if not self.recover:
            self.reset_faults()
            self._enter(LoopPhase.RESETTING, planned)

    def reset_faults(self) -> None:
        """Release every latch, and request a reset from every supervisor in fault."""
        self._ticker.history.clear()
        for axis in self._axes:
            axis.limiter.reset()
            axis.request = Request.RESET if axis.supervisor.phase is Phase.FAULT else Request.DISABLE

    def _follow_monitor(self, planned: int) -> None:
        """Latch a stop by the monitor, or ramp the torque to 0 if the monitor has failed."""
        finding = self.channel.latch_stop(planned * 1e-9, self._axes)
        if finding is not None:
            self.events.add(self._t(planned), "", str(finding), finding.cause)
            self._fault(planned)

    def _note_faults(self, planned: int) -> None:
        """Report new faults and back-offs as events."""
        for index, axis in enumerate(self._axes):
            faults = axis.supervisor.faults
            if len(faults) > self._faults[index]:
                for fault in faults[self._faults[index] :]:
                    self.events.add(fault.time - self._start * 1e-9, axis.name, str(fault), fault.cause)
                self._faults[index] = len(faults)
                self._fault(planned)
            for seen, source in ((self._back_offs, axis.guard), (self._limited, axis.compensation_limit)):
                if source.count > seen[index]:
                    seen[index] = source.count
                    self.events.add(self._t(planned), axis.name, source.words)

    def _fault(self, planned: int) -> None:
        """Ramp all axes to 0 after a fault of one axis, because they move the same limb."""
        self.faulty = True
        for axis in self._axes:
            axis.stop()
        if self._settings.after_fault == "exit" or not self._ran:  # waiting makes no sense after a failed startup
            first = self.events.faults[0]
            remedy = "" if self._ran else f"; {REMEDIES[first.cause_id]}"
            self.stop(f"fault: {first.text}{remedy}")
        if self.phase not in (LoopPhase.STOPPING, LoopPhase.RESETTING):
            self._enter(LoopPhase.FAULTED, planned)

    def _t(self, planned: int) -> float:
        return (planned - self._start) * 1e-9

    def _enter(self, phase: LoopPhase, planned: int) -> None:
        self.phase = phase
        if phase is not LoopPhase.FAULTED:
            self._recovery_asked = math.inf
        if phase is LoopPhase.RUNNING:
            self._notices.restart_losses(self.cycles)
        if self._recovering and phase in (LoopPhase.RUNNING, LoopPhase.FAULTED):
            self._recovering = False
            if phase is LoopPhase.RUNNING:
                self._recovered += 1
                self._over = self.events.next_number
                self.faulty = False
            else:
                self._failed += 1
        self._since = planned * 1e-9
