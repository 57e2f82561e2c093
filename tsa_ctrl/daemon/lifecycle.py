"""Run a rig on a bus: bring-up, loop, a new bring-up on request, and a shutdown that every exit passes through.

This module makes no calls to the operating system, and the bus provides the time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.live.rig import Rig, check_startup
from tsa_ctrl.config import Configuration
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.daemon.joint_files import JointFiles
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.daemon.summary import NodeCount, Summary
from tsa_ctrl.errors import StoppedError, TsaError
from tsa_ctrl.ipc.mailbox import Mailbox
from tsa_ctrl.readiness import Nodes, loose_lines
from tsa_ctrl.safety.shut_down import shut_down
from tsa_ctrl.safety.supervisor import Request
from tsa_ctrl.safety.use_class import stop_bit
from tsa_ctrl.system.histogram import coarse, distribution


def ramp_down(rig: Rig, axes: Sequence[ControlAxis], period: float, stop_time: float) -> None:
    """Ramp the last torque to 0 within `stop_time` s, without the control law, after the loop has failed.

    Supervisor and limiter of each axis still apply, so a joint that runs away during the ramp gets no torque.
    """
    steps = max(1, round(stop_time / period))
    last = [axis.terms.tau_m_cmd for axis in axes]
    start = rig.wait(0.0)
    for step in range(1, steps + 1):
        begin = rig.wait(start + step * period)
        rig.sync(begin)
        now = rig.collect(begin + 0.6 * period)
        share = 1.0 - step / steps
        for axis, torque in zip(axes, last, strict=True):
            controlword, permitted, _ = axis.supervisor.update(
                axis.image, now, Request.ENABLE if torque else Request.DISABLE
            )
            image, terms = axis.image, axis.terms
            sent, terms.reason = axis.limiter.update(
                torque * share, permitted, image.pdo_age <= axis.most_age, image.tau_m, image.omega_m, *axis.joint()
            )
            axis.io.command(controlword, sent)
            terms.tau_m_cmd = sent
        rig.heartbeat(now)


Say = Callable[[str], None]
Admit = Callable[[Nodes, bool], None]  # nodes, and True if a drive has digital inputs; raises UsageError


class Lifecycle:
    """Operate an assembled rig for one run; `unconfirmed` lists the drives that did not confirm that they are off."""

    def __init__(
        self,
        configuration: Configuration,
        rig: Rig,
        axes: Sequence[ControlAxis],
        loop: Loop,
        say: Say = lambda line: None,
        no_loop: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext,
        tell: Callable[[str], None] = lambda stage: None,
        simulated: bool = False,
        admit: Admit = lambda nodes, has_inputs: None,
    ) -> None:
        """Prepare the operation of a rig.

        Args:
            configuration: the checked configuration.
            rig: nodes and bus.
            axes: one controlled axis for each axis of the rig.
            loop: the control loop.
            say: receives each line for the user.
            no_loop: context in which a new bring-up runs.
            tell: receives the stage of a bring-up, and an empty text at its end.
            simulated: True if the nodes are simulated.
            admit: called with the nodes of a bring-up; it may reject them.
        """
        self.unconfirmed: list[str] = []
        self._configuration = configuration
        self._rig = rig
        self._axes = axes
        self._loop = loop
        self.node_notes: list[str] = []  # of the last bring-up: limits of the nodes, and checks that were not possible
        self._say = say
        self._no_loop = no_loop
        self._tell = tell
        self._simulated = simulated
        self._admit = admit
        self._joint_files = JointFiles(configuration, simulated)

    def run(self, seconds: float, reset_faults: bool = False, ready: Callable[[], None] = lambda: None) -> None:
        """Bring the rig up, run the loop, bring it up again on request, and shut it down in every case.

        `ready` is called once, directly before the first cycle. An earlier stop request ends the bring-up.

        Raises:
            UsageError: the configuration failed a check before the first cycle.
            BusError: the bus or a node failed before the first cycle.
        """
        period = self._configuration.period
        for line in loose_lines(self._configuration):
            self._say(line)
        try:
            try:
                self._bring_up(reset_faults)
            except StoppedError as stop:
                self._loop.cause = str(stop)
                self._say(f"{stop}: the start ends here; no drive was enabled")
                return
            self._prove(period)
            ready()
            try:
                self._loop.run(seconds)
                while self._loop.recover:
                    self._recover(seconds)
            except Exception:
                with contextlib.suppress(Exception):  # the first error is re-raised, and shut_down follows anyway
                    ramp_down(self._rig, self._axes, period, self._configuration.file.controller.stop_time)
                raise
        finally:
            self.unconfirmed = shut_down(self._rig, period, say=self._say)
            channel = self._loop.channel
            if self.unconfirmed and channel.acted(self._rig.bus.clock()) and channel.confirmed:
                self.unconfirmed = []  # a stopped node answers no SYNC, but it answered the monitor before
                self._say("every drive confirmed to the monitor that it gives no torque")
            self._loop.last_words(self.unconfirmed)

    def _bring_up(self, reset_faults: bool, resets_later: bool = False) -> None:
        configuration = self._configuration
        file = configuration.file
        self._rig.stand_off()
        try:
            report = bring_up(
                self._rig.bus,
                file.bus,
                file.axes,
                configuration.profiles,
                configuration.period,
                reset_faults,
                resets_later,
                self._tell,
                lambda: self._loop.stop_asked,
                self._joint_files.identify,
            )
        finally:
            self._tell("")
        for line in (*report.lines(), *self._joint_files.notes()):
            self._say(line)
        self.node_notes = [f"{node.name}: {text}" for node in report.nodes for text in node.notes]
        self._admit(self._joint_files.nodes, any(node.digital_inputs for node in report.nodes))
        self._rig.look_after(report, stop_bit(file.safety))
        for axis in self._axes:
            axis.trusted = self._joint_files.trusted(axis.name)
        self._rig.start()

    def _prove(self, period: float) -> None:
        self._tell("seeing that every node answers every SYNC")
        try:
            check_startup(self._rig, period)
        finally:
            self._tell("")

    def _recover(self, seconds: float) -> None:
        """Configure all nodes again, as at startup; a failure leaves the fault latched and is logged."""
        loop = self._loop
        self._rig.bus.clear_fault()
        try:
            with self._no_loop():
                loop.channel.renew()
                self._bring_up(reset_faults=False, resets_later=True)  # the supervisors reset the faults
                self._prove(self._configuration.period)
        except TsaError as error:  # for example, an exchanged drive contradicts the configuration
            loop.note(f"recovery failed: {error}")
            loop.run(seconds, LoopPhase.FAULTED)
            return
        for axis in self._axes:
            axis.supervisor.configured(axis.image)
        loop.reset_faults()
        loop.run(seconds, LoopPhase.RESETTING)

    def summary(self, mailbox: Mailbox, rights: str, log: str | None = None, written: int = 0) -> Summary:
        """Return the summary of the run; `log` is the log file, which holds `written` records."""
        configuration, rig, loop = self._configuration, self._rig, self._loop
        return Summary(
            bus=configuration.file.channels,
            rate=configuration.file.controller.rate,
            start=loop.start,
            cause=loop.cause or "ended",
            failed=loop.faulty or bool(self.unconfirmed),
            planned=loop.planned,
            sent=loop.cycles,
            skipped=loop.skipped,
            overruns=loop.overruns,
            late=loop.late,
            dropped=rig.bus.counters.dropped,
            error_frames=rig.error_frames,
            flooded=rig.flooded,
            load=(configuration.load.least, configuration.load.worst),
            rights=rights,
            lateness=distribution(mailbox.lateness),
            work=distribution(mailbox.work),
            lateness_bins=coarse(mailbox.lateness),
            work_bins=coarse(mailbox.work),
            nodes=tuple(
                NodeCount(axis.name, str(node), node.missed, node.late, node.repeated, node.malformed)
                for axis in rig.axes
                for node in axis.image.nodes
            ),
            torque=tuple(counter.result() for counter in loop.torque_errors),
            events=loop.events.all,
            unconfirmed=tuple(self.unconfirmed),
            simulated=self._simulated,
            joints=self._joint_files.nodes,
            log=log,
            log_written=written,
            log_lost=0 if log is None else loop.cycles * len(rig.axes) - written,
        )
