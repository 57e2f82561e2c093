"""Publish a record per axis and cycle and a status snapshot, and monitor the processes that receive them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter

from tsa_ctrl.bus.canopen.cia402 import decode
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import Role
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.live_parameters import Tuner
from tsa_ctrl.daemon.build import STATE_CODE, LoopPhase
from tsa_ctrl.daemon.monitoring import SecondChannel
from tsa_ctrl.daemon.notices import AxisSensors, Events, ProcessNotices
from tsa_ctrl.ipc.mailbox import General, Mailbox, Parameters, Row
from tsa_ctrl.ipc.server_process import ServerProcess
from tsa_ctrl.log.mcap_file import Note
from tsa_ctrl.log.process import LogProcess
from tsa_ctrl.log.ring import RingWriter
from tsa_ctrl.safety.release import ReleaseBudget
from tsa_ctrl.signals import Place, signals_of
from tsa_ctrl.system.process_supervisor import Notifier

_record, _status, _measured = (
    attrgetter(*(signal.source for signal in signals_of(place))) for place in (Place.LOG, Place.STATUS, Place.CLIENT)
)
_STATE = tuple(STATE_CODE[decode(statusword)] for statusword in range(0x80))
LEASE_APART = 1.0  # s between two events about the lease


class Telemetry:
    """Write records, status and measurements to shared memory, so that no receiver can delay the loop."""

    def __init__(
        self,
        rig: Rig,
        axes: Sequence[ControlAxis],
        tuners: Sequence[Tuner],
        mailbox: Mailbox,
        ring: RingWriter | None,
        log: LogProcess | None,
        events: Events,
        sensors: AxisSensors | None = None,
        notifier: Notifier | None = None,
    ) -> None:
        """Prepare the telemetry of a rig.

        `ring` and `log` are None without a log, `sensors` without serial sensors, `notifier` without a service manager.
        """
        self.log_lost = 0
        self.channel = SecondChannel()
        self._rig = rig
        self._axes = tuple(enumerate(axes))
        self._tuners = tuners
        self._mailbox = mailbox
        self._push = None if ring is None else ring.push
        self._note = None if ring is None else ring.note
        self._noted = 0
        self._error_frames = 0
        self._warnings: dict[tuple[int, int], int] = {}  # number of reported warnings of each node
        self._processes: list[ProcessNotices] = []
        if ring is not None and log is not None:
            self._processes.append(
                ProcessNotices(
                    "log",
                    lambda: log.alive,
                    lambda: ring.heard,
                    lambda: ring.replaced,
                    "the loop goes on, records wait in memory for some seconds",
                    "the loop went on; the log goes on in another file (-2, -3 and so on in its name)",
                    "the loop goes on, records are lost from here; end the run and start it again for a new log",
                )
            )
        self._log = log
        self._sensors = sensors
        self._notifier = notifier
        self._log_alive = log is not None
        self._trouble = ""
        self._written = 0
        self._lease_told = -LEASE_APART
        self._events = events
        self._heard = [[-math.inf] * len(axis.image.nodes) for axis in axes]  # s of the log, last PDOs of each node

    def record(self, t: float, cycle: float, lateness: float, work: float) -> None:
        """Write one record per axis; `t` (s) is the planned time, and SYNC was sent `lateness` s later."""
        push = self._push
        for index, axis in self._axes:
            terms = axis.terms
            terms.t, terms.cycle, terms.lateness, terms.work = t, cycle, lateness, work
            terms.state = _STATE[axis.image.statusword & 0x7F]
            if push is not None:
                push(index, _record(axis))

    def publish(
        self,
        now: float,
        start: float,
        counts: tuple[int, int, int, int],
        phase: int,
        releases: ReleaseBudget,
        recovery: tuple[int, int, int] = (0, 0, 0),
    ) -> None:
        """Write the status.

        Args:
            now: monotonic time, s.
            start: monotonic time of the first cycle, s.
            counts: numbers of cycles run, periods planned, periods skipped, overruns.
            phase: code of the phase.
            releases: budget of the releases.
            recovery: number of recoveries that ended with torque, number that ended with a fault, and number of the
                first event after the last recovery.
        """
        cycles, planned, skipped, overruns = counts
        general = General(
            time=now,
            start=start,
            cycles=cycles,
            planned=planned,
            skipped=skipped,
            overruns=overruns,
            dropped=self._rig.bus.counters.dropped,
            log_lost=self.log_lost,
            log_silent=self._processes[0].silent if self._log_alive and self._processes else 0.0,
            phase=phase,
            releases=releases.count,
            release_next=releases.next,
            recovered=recovery[0],
            failed=recovery[1],
            first_fault=recovery[2],
            monitor=self.channel.state,
        )
        for notice in self.channel.news():
            self._events.add(now - start, "", f"monitor: {notice}")
        if self._notifier is not None:
            loop = LoopPhase(phase)
            self._notifier.update(now, loop.name.lower(), loop.up, loop.ending)
        for process in self._processes:
            process.update(now - start, now, self._events)
        self._mailbox.publish(general, [self._values(index, axis, now - start) for index, axis in self._axes])
        self._tell_lease(now - start, start)
        if self._events.changed:
            self._events.changed = False
            self._mailbox.publish_text(self._events.encoded())
            self._note_events()

    def measure(self, now: float, cycle: int, phase: int) -> None:
        """Publish the measurements of this cycle for clients that use them for control; `now` is monotonic, s."""
        self._mailbox.measure(now, cycle, phase, [_measured(axis) for _, axis in self._axes])

    def _tell_lease(self, t: float, start: float) -> None:
        """Add an event when the owner of the set-point changes, with the server's text, at most once a second."""
        if t - self._lease_told >= LEASE_APART and (found := self._mailbox.told()) is not None:
            self._lease_told = t
            self._events.add(found[0] - start, "", found[1])

    def last_words(self, t: float, cause: str, unconfirmed: Sequence[str]) -> None:
        """Log the reason for the end of the run, and the drives that did not confirm that they are off."""
        self._note_events()
        if self._note is not None:
            for line in unconfirmed:
                self._note(Note(t, "", line, fault=True).encoded())
            self._note(Note(t, "", f"ended: {cause}", fault=False).encoded())

    def _note_events(self) -> None:
        """Pass new events to the log, so that it holds the cause of a stop."""
        for event in self._events.since(self._noted):
            self._noted = event.number + 1
            if self._note is not None:
                self._note(Note(event.t, event.axis, event.text, event.fault).encoded())

    def _values(self, index: int, axis: ControlAxis, t: float) -> tuple[Row, Parameters]:
        """Return the status of an axis and its live parameters; `t` in s of the log, for the ages."""
        terms, heard = axis.terms, self._heard[index]
        ages = {Role.TORQUE_SENSOR: 0.0}
        for place, node in enumerate(axis.image.nodes):
            if node.misses == 0:
                heard[place] = t
            ages[node.role] = t - heard[place]
        terms.drive_age = ages[Role.DRIVE]
        terms.joint_age = ages.get(Role.ENCODER, terms.drive_age)
        terms.sensor_age = ages[Role.TORQUE_SENSOR]
        return _status(axis), tuple(parameter.value for parameter in self._tuners[index].parameters)

    def check(self, t: float, records: int) -> None:
        """Add events about log, sensors and bus; called about once a second.

        `records` is the number of records that were passed to the log.
        """
        self._check_log(t, records)
        if self._sensors is not None:
            self._sensors.check(t, self._events)
        self._check_bus(t)

    def _check_bus(self, t: float) -> None:
        """Add an event for new error frames, and for each new emergency that the profile classifies as a warning."""
        for index, axis in self._axes:
            for place, health in enumerate(axis.image.nodes):
                key = (index, place)
                more = health.warnings - self._warnings.get(key, 0)
                self._warnings[key] = health.warnings
                if more > 0:
                    times = f", {more} times" if more > 1 else ""
                    self._events.add(t, axis.name, f"warning of {health}: {health.warning}{times}")
        more = self._rig.error_frames - self._error_frames
        if more:
            self._error_frames += more
            self._events.add(t, "", f"error frames: {more}, the last one: {self._rig.last_error}")

    def watch_server(self, server: ServerProcess) -> None:
        """Monitor the socket server as well."""
        mailbox = self._mailbox
        self._processes.append(
            ProcessNotices(
                "socket",
                lambda: server.alive,
                lambda: mailbox.heard,
                lambda: mailbox.replaced,
                "the loop goes on, a signal (SIGTERM) ends it; a process in its place follows",
                "the loop went on; clients connect again",
                "the loop goes on, no client can connect; end the run with tsa stop or SIGTERM, and start it again",
            )
        )

    def _check_log(self, t: float, records: int) -> None:
        """Add an event when the log writer fails, and count the lost records."""
        log = self._log
        if log is None or not self._log_alive:
            self.log_lost += records - self._written if log is not None else 0
            self._written = records
            return
        health = log.health()
        self.log_lost = health.lost
        if health.trouble != self._trouble:
            text = (
                f"log: {health.trouble}; the loop goes on, records may be lost"
                if health.trouble
                else "log: written again"
            )
            self._events.add(t, "", text)
            self._trouble = health.trouble
        if not log.alive:
            self._log_alive = False
            self._written = health.written + health.lost
