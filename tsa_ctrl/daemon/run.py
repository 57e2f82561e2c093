"""The daemon from start to end: children, rights, bring-up, loop, and the one way down."""

from __future__ import annotations

import contextlib
import math
import signal
from collections.abc import Callable, Iterator
from types import FrameType

from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.live.prove import prove
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.wire.connect import open_bus
from tsa_ctrl.bus.wire.seam import Bus
from tsa_ctrl.config import Configuration
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.daemon.assembly import control_axes, tuners_of
from tsa_ctrl.daemon.children import Children
from tsa_ctrl.daemon.descent import descend
from tsa_ctrl.daemon.events import Events
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.daemon.phase import LoopPhase
from tsa_ctrl.daemon.summary import NodeCount, Summary
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.errors import TsaError, UsageError
from tsa_ctrl.safety.shut_down import shut_down
from tsa_ctrl.system import realtime
from tsa_ctrl.system.histogram import coarse, distribution
from tsa_ctrl.system.notify import Notifier

Say = Callable[[str], None]
STOPPING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


def run(
    configuration: Configuration,
    seconds: float = math.inf,
    say: Say = lambda line: None,
    configured: bool = False,
    reset_faults: bool = False,
    watch: Callable[[Rig], None] = lambda rig: None,
) -> Summary:
    """Run the controller until it is stopped, or for `seconds` of torque; `say` gets a line for whoever watches.

    `configured`: the nodes are operational and mapped as they should be; nothing is written to them. `reset_faults`:
    drives found in fault at the start are reset. `watch` gets the rig before anything is sent.
    Raises UsageError or BusError for what fails before the first cycle; what happens later is in the summary.
    """
    return Daemon(configuration, say, configured, reset_faults, watch).run(seconds)


class Daemon:
    """One run; every way out of it goes through the same descent."""

    def __init__(
        self,
        configuration: Configuration,
        say: Say,
        configured: bool = False,
        reset_faults: bool = False,
        watch: Callable[[Rig], None] = lambda rig: None,
    ) -> None:
        self._configuration = configuration
        self._configured = configured
        self._reset_faults = reset_faults
        self._watch = watch
        self._say = say
        self._loop: Loop | None = None
        self._early_stop: str | None = None
        self._unconfirmed: list[str] = []
        self._notifier = Notifier()

    def run(self, seconds: float) -> Summary:
        configuration = self._configuration
        file = configuration.file
        bus = open_bus(file.bus)
        try:
            rig = Rig(bus, file.bus, file.axes, configuration.profiles, wake_early=file.realtime.wake_early)
            self._watch(rig)
            axes = control_axes(configuration, rig)
            tuners = tuners_of(axes, configuration.period)
            children = Children(configuration, tuners)
            for axis in axes:
                axis.instruments.connect(children.sensors.sources(axis.name))
            try:
                with self._signals():
                    rights = realtime.acquire(file.realtime)
                    for line in rights.missing:
                        self._say(f"going on without: {line}")
                    events = Events()
                    telemetry = Telemetry(
                        rig,
                        axes,
                        tuners,
                        children.mailbox,
                        children.ring,
                        children.log,
                        events,
                        children.sensors,
                        self._notifier,
                    )
                    telemetry.watch_server(lambda: children.server_alive)
                    loop = Loop(
                        rig, axes, tuners, children.mailbox, telemetry, events, file.controller, file.bus.supervision
                    )
                    try:
                        self._operate(bus, rig, axes, loop, seconds)
                    finally:
                        realtime.release()
            finally:
                children.end()
            summary = self._summary(rig, loop, children, str(rights))
            try:
                summary.save()
            except UsageError as error:  # a full disk is no reason to lose the summary itself
                self._say(str(error))
            return summary
        finally:
            bus.close()
            self._notifier.close()

    def _operate(self, bus: Bus, rig: Rig, axes: tuple[ControlAxis, ...], loop: Loop, seconds: float) -> None:
        """Bring up, run, bring up again when asked to; then descend, whatever happened."""
        configuration = self._configuration
        period = configuration.period
        realtime.freeze_garbage()  # slow: between bring-up and loop nothing may keep our heartbeat waiting
        try:
            self._bring_up(bus, rig, self._reset_faults)
            if not self._configured:
                prove(rig, period)
            self._loop = loop
            if self._early_stop is not None:
                loop.stop(self._early_stop)
            try:
                loop.run(seconds)
                while loop.recover:
                    self._recover(bus, rig, axes, loop, seconds)
            except Exception:
                with contextlib.suppress(Exception):  # the first cause is the one to tell, and shut_down follows anyway
                    descend(rig, axes, period, configuration.file.controller.stop_time)
                raise
        finally:
            self._unconfirmed = shut_down(rig, period)
            loop.last_words(self._unconfirmed)

    def _bring_up(self, bus: Bus, rig: Rig, reset_faults: bool) -> None:
        configuration = self._configuration
        file = configuration.file
        if not self._configured:
            report = bring_up(bus, file.bus, file.axes, configuration.profiles, configuration.period, reset_faults)
            for line in report.lines():
                self._say(line)
        rig.start()

    def _recover(self, bus: Bus, rig: Rig, axes: tuple[ControlAxis, ...], loop: Loop, seconds: float) -> None:
        """Configure all nodes anew, as at the start; a failure leaves the fault latched and is told."""
        bus.clear_fault()
        try:
            with self._notifier.no_loop():
                self._bring_up(bus, rig, reset_faults=False)  # the supervisors do it
        except TsaError as error:  # a drive that was exchanged may contradict the configuration, too
            loop.note(f"recovery failed: {error}")
            loop.run(seconds, LoopPhase.FAULTED)
            return
        for axis in axes:
            axis.supervisor.configured(axis.image)
        loop.reset_faults()
        loop.run(seconds, LoopPhase.RESETTING)

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """SIGTERM, SIGINT and SIGHUP (the terminal is gone) ask for the descent; a second one changes nothing."""

        def handle(number: int, frame: FrameType | None) -> None:
            name = signal.Signals(number).name
            if self._loop is not None:
                self._loop.stop(name)
            else:
                self._early_stop = self._early_stop or name

        wanted = [number for number in STOPPING if signal.getsignal(number) is not signal.SIG_IGN]  # nohup stays so
        before = {number: signal.signal(number, handle) for number in wanted}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _summary(self, rig: Rig, loop: Loop, children: Children, rights: str) -> Summary:
        configuration = self._configuration
        mailbox, log = children.mailbox, children.log
        first = loop.events.first_fault
        health = None if log is None else log.health()
        records = loop.cycles * len(rig.axes)
        return Summary(
            bus=configuration.file.bus.channel,
            rate=configuration.file.controller.rate,
            start=loop.start,
            cause=loop.cause or "ended",
            failed=first is not None or bool(self._unconfirmed),
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
            events=loop.events.all,
            unconfirmed=tuple(self._unconfirmed),
            log=None if log is None else str(log.path.resolve()),
            log_written=0 if health is None else health.written,
            log_lost=0 if health is None else records - health.written,
        )
