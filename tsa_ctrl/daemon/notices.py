"""Store the events of a run in order, and report facts of the run as events.

`Events` supplies status, summary and clients; nothing here prints. `AxisNotices` compares the state of one axis with
its last state: limits of the rig, and problems without a fault. `Notices` does this for all axes and the loop.
`ProcessNotices` monitors a process next to the loop.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence

import msgspec

from tsa_ctrl.bus.canopen.cia402 import INTERNAL_LIMIT, WARNING
from tsa_ctrl.config import AxisSettings
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.estimator import EstimateState
from tsa_ctrl.ipc.mailbox import TEXT
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.safety.causes import Cause
from tsa_ctrl.safety.debounce import SECOND
from tsa_ctrl.sensors.process import LineState, SerialSensors
from tsa_ctrl.system.realtime import SKIPPED_SHARE, Overruns

MOST = 50  # stored events, including the first fault
LONGEST = 1000  # characters of a text; the first fault always has room in the mailbox
LONGEST_NAME = 100  # characters of an axis' name


class Events:
    """Store the newest events and the first fault, which is never dropped because it is the cause."""

    def __init__(self) -> None:
        self._kept: list[Event] = []
        self._number = 0
        self.changed = False

    def add(self, t: float, axis: str, text: str, cause: Cause | None = None) -> None:
        """Store an event; with a `cause` it is a fault."""
        cause_id = "" if cause is None else cause.id
        self._kept.append(Event(self._number, t, axis[:LONGEST_NAME], text[:LONGEST], cause is not None, cause_id))
        self._number += 1
        self.changed = True
        if len(self._kept) > MOST:
            self._kept.pop(1 if self.first_fault is self._kept[0] else 0)

    @property
    def first_fault(self) -> Event | None:
        return next((event for event in self._kept if event.fault), None)

    @property
    def faults(self) -> tuple[Event, ...]:
        return tuple(event for event in self._kept if event.fault)

    @property
    def all(self) -> tuple[Event, ...]:
        return tuple(self._kept)

    @property
    def next_number(self) -> int:
        """Return the number of the next event."""
        return self._number

    def since(self, number: int) -> tuple[Event, ...]:
        """Return the stored events from this number on."""
        return tuple(event for event in self._kept if event.number >= number)

    def encoded(self) -> bytes:
        """Return JSON of the first fault and of as many of the newest events as fit into the mailbox."""
        kept = list(self._kept)
        cause = self.first_fault
        spared = 0 if cause is None else 1
        while len(text := msgspec.json.encode(kept)) > TEXT and len(kept) > spared:
            kept.pop(1 if cause is not None and kept[0] is cause else 0)
        return text


TOLD = {
    None: "its process is gone; no more values",
    LineState.READING: "values come",
    LineState.SILENT: "open, but no value that can be read comes",
    LineState.LOST: "cannot be opened, or was unplugged",
}


class AxisSensors:
    """Run one process per serial sensor, provide its values to the loop, and report its health as events.

    Create this before real-time scheduling is requested, so that the processes do not inherit it.
    """

    def __init__(self, axes: Sequence[AxisSettings]) -> None:
        self._place = tuple((axis.name, sensor) for axis in axes for sensor in axis.serial)
        self._sensors = SerialSensors([sensor for _, sensor in self._place])
        self._told: dict[int, LineState | None] = {}

    def sources(self, axis: str) -> dict[str, Callable[[float], float]]:
        """Return the function that reads each quantity of the axis `axis`, by the quantity's name."""
        return {
            sensor.quantity: self._sensors.reader(index)
            for index, (name, sensor) in enumerate(self._place)
            if name == axis
        }

    def check(self, t: float, events: Events) -> None:
        """Add an event for each sensor whose state has changed since the last check; call it about once a second."""
        for index, (axis, sensor) in enumerate(self._place):
            state = self._sensors.reading(index).state if self._sensors.alive(index) else None
            if state is not self._told.get(index, LineState.STARTING) and state in TOLD:
                self._told[index] = state
                events.add(t, axis, f"serial {sensor.quantity} on {sensor.port}: {TOLD[state]}")

    def close(self) -> None:
        self._sensors.close()


AGAIN = 10.0  # s between two notices of one kind on one axis; the log has the reason of every cycle
LESS, AS_SAID = 0.93, 0.97  # of the file's friction torque: reported below LESS, and again only after more than AS_SAID
LOST_SHARE = 0.05  # share of the cycles since the last check; a sound bus loses fewer than one in 10,000
LEAST_LOST = 2  # lost commands, or cycles without all answers; a single one may be lost by a bus error
SENSOR_FAILS = 0.3  # s of a contradiction until an event reports it; an unknown effect ends it within 0.2 s
SILENT = 1.0  # s without a sign of life until an event reports it; each process leaves at least five per second
BITS = (  # bits of the statusword that are reported without a stop
    (WARNING, "warns (bit 7 of statusword {:#06x}): temperature or voltage; its display, or 0x603F, has the reason"),
    (
        INTERNAL_LIMIT,
        "is at an internal limit (bit 11 of statusword {:#06x}): it may give less than the command; its current limit, "
        "temperature, and 0x6072 and 0x6080",
    ),
)


class Seldom:
    """Permit one notice in `AGAIN` s."""

    def __init__(self) -> None:
        self._last = -AGAIN  # s

    def permits(self, t: float) -> bool:
        """Return True, and count the notice, if the last one was long enough before `t` in s."""
        if t - self._last < AGAIN:
            return False
        self._last = t
        return True


class AxisNotices:
    """Report changes of one axis as events."""

    def __init__(self, axis: ControlAxis, events: Events) -> None:
        self._axis = axis
        self._events = events
        self._cut = self._repeated = self._missed = self._statusword = 0
        self._slack = self._contradicted = self._less = self._sensor_fails = False
        self._confirmed = True
        self._sensor_since = 0.0  # s, when the torque sensor last was as reported
        self._reason = ""
        self._missing: tuple[str, ...] = ()
        self._read_back = (0, 0)  # commands that were read back, and old ones among them
        self._seldom: dict[str, Seldom] = defaultdict(Seldom)  # by kind of notice

    def _add(self, t: float, text: str) -> None:
        self._events.add(t, self._axis.name, text)

    def begin(self) -> None:
        """Report the limitations of this rig, before the first cycle."""
        axis = self._axis
        self._missing = axis.bending.missing  # joints without an encoder are among the notes of the bound
        for note in (*axis.law.notes, *axis.compensation_limit.bound.notes, axis.joint_torque.unsupported_reason):
            if note:
                self._add(0.0, note)

    def update(self, t: float) -> None:
        """Report changes since the last call; `t` is in s of the log."""
        self._update_torque(t)
        self._update_estimate(t)
        self._update_routing(t)
        self.update_statusword(t)
        self._update_elongation(t)
        image = self._axis.image
        if image.repeated != self._repeated and self._seldom["repeated"].permits(t):
            self._repeated = image.repeated
            nodes = ", ".join(f"{node} {node.repeated}" for node in image.nodes if node.repeated)
            self._add(
                t,
                f"PDOs came more than once in a cycle (since the start: {nodes}); the first of each is used. "
                "Another node may have the same id, or an error on the bus repeats frames",
            )

    def _update_torque(self, t: float) -> None:
        law, known = self._axis.law, self._axis.joint_torque
        cut, self._cut = law.cut > self._cut, law.cut  # a limit that is over by the next report is not reported
        if cut and self._seldom["cut"].permits(t):
            self._add(
                t,
                f"the set-point requires a motor torque outside {_range(law.domain)}, where one tendon goes slack; "
                "the torque is limited to this range (DOMAIN); lower the set-point or raise the pretension",
            )
        fails = self._axis.compensation_limit.proven.contradicted
        if fails is self._sensor_fails:
            self._sensor_since = t
        elif t - self._sensor_since > SENSOR_FAILS:
            self._sensor_fails = fails
            self._add(
                t,
                "the joint torque sensor shows more friction than the tendons' elongation, which counts instead; check "
                "the sensor's cable, sign and gain"
                if fails
                else "the joint torque sensor shows the friction of the tendons' elongation again",
            )
        if known.contradicted is not self._contradicted:
            self._contradicted = known.contradicted
            self._add(
                t,
                f"the joint torque sensor differs from the tendons' stretch, {1e3 * known.difference:+.0f} mN*m in the "
                "mean, beyond the band most of the time: check the sensor's gain and zero, or identify stiffness and "
                "bending (tsa calibrate)"
                if known.contradicted
                else "the joint torque sensor agrees with the tendons' stretch again",
            )

    def _update_estimate(self, t: float) -> None:
        law, estimator = self._axis.law, self._axis.estimator
        if bool(estimator.reason) is not bool(self._reason):
            if estimator.reason:
                self._add(t, f"friction and pretension are not estimated: {estimator.reason}")
            elif estimator.state is EstimateState.ESTIMATED:  # otherwise it was reset by a disable
                self._add(t, "friction and pretension are estimated again")
            self._reason = estimator.reason
        found = estimator.half_loop_ratio if estimator.use else math.nan
        if found < LESS and not self._less:
            self._less = True
            self._add(
                t,
                f"friction and pretension together are about {100.0 * found:.0f} % of the model file's values, by "
                "the estimate in use, which limits the compensation; check the tensioner and the sheath, or calibrate "
                "again",
            )
        elif found > AS_SAID:
            self._less = False
        if law.near_slack is not self._slack:
            self._slack = law.near_slack
            self._add(
                t,
                f"pretension {law.pretension:.3g} N at the present wrap angle: the tendons are "
                f"{'near slack' if law.near_slack else 'no longer near slack'}; the motor torque is limited to "
                f"{_range(law.domain)}",
            )

    def _update_routing(self, t: float) -> None:
        bending, terms = self._axis.bending, self._axis.terms
        straight = bending.routing is not None and terms.permitted and terms.theta <= 0.0
        if bending.routing is not None and straight and self._seldom["straight"].permits(t):
            self._add(
                t,
                "the wrap angle by [routing] is 0 rad or less at the present angle of "
                f"{', '.join(bending.routing.joints)}: 0 is used, and the friction is wrong; correct gains, tables or "
                "[sheath] bending_angle; with limits.travel of these joints, the range is checked before a start",
            )
        missing = bending.missing
        if missing == self._missing or not terms.permitted:
            return
        if missing:
            self._add(
                t,
                f"the angle of joint {', '.join(missing)}, which bends this sheath, is not measured: the friction is "
                "taken at the least wrap angle that the joint allows",
            )
        else:
            self._add(t, "the angles of all joints that bend this sheath are measured again")
        self._missing = missing

    def update_statusword(self, t: float) -> None:
        """Report new bits of the statusword that do not stop the axis; `t` is in s of the log."""
        image = self._axis.image
        word, before = image.statusword, self._statusword
        self._statusword = word
        for bit, words in BITS:
            if word & bit and not before & bit and self._seldom[words].permits(t):
                self._add(t, f"{image.nodes[0]} {words.format(word)}")

    def _update_elongation(self, t: float) -> None:
        stretch = self._axis.joint_torque.stretch
        if stretch is not None and stretch.confirmation.confirmed is not self._confirmed:
            self._confirmed = stretch.confirmation.confirmed
            if not self._confirmed:
                self._add(
                    t,
                    "the tendon elongation is not as the reported motor torque predicts: friction or stiffness has "
                    "changed, or the motor gives another torque than it reports; the band of tau_j_stretch no "
                    "longer uses the reported torque alone",
                )

    def restart_losses(self) -> tuple[int, int, int]:
        """Count losses from now on, and return the lost cycles, reads of 0x6071 and old commands among them so far."""
        image, readback = self._axis.image, self._axis.io.readback
        missed, self._missed = image.missed - self._missed, image.missed
        before, self._read_back = self._read_back, (readback.asked, readback.outdated)
        return missed, readback.asked - before[0], readback.outdated - before[1]

    def update_losses(self, t: float, run: int) -> None:
        """Report lost commands and answers while torque is permitted; `run` counts the cycles since a restart."""
        image, permitted = self._axis.image, self._axis.terms.permitted
        lost, asked, outdated = self.restart_losses()
        if permitted and outdated >= max(LEAST_LOST, LOST_SHARE * asked) and self._seldom["outdated"].permits(t):
            self._add(
                t,
                f"{image.nodes[0]} held an older command {outdated} of the last {asked} times that 0x6071 was read "
                "back: commands are lost; look at the cable, the bus load, and the drive's cycle",
            )
        if permitted and lost >= max(LEAST_LOST, LOST_SHARE * run) and self._seldom["missed"].permits(t):
            nodes = ", ".join(f"{node} {node.missed}" for node in image.nodes if node.missed)
            self._add(
                t,
                f"{lost} of the last {run} cycles were without all answers (since the start: {nodes}); look at the "
                "cable, the bus load, and collect in [controller]",
            )


class Notices:
    """Report changes of all axes and of the loop as events."""

    def __init__(self, axes: Sequence[ControlAxis], events: Events, overruns: Overruns) -> None:
        self._axes = [AxisNotices(axis, events) for axis in axes]
        self._events = events
        self._overruns = overruns
        self._checked = -math.inf  # s, monotonic
        self._may_report_skipped = Seldom()
        self._cycles = 0

    def begin(self) -> None:
        """Report the limitations of this rig, before the first cycle."""
        for axis in self._axes:
            axis.begin()

    def update(self, t: float) -> None:
        """Report changes since the last call; `t` is in s of the log."""
        for axis in self._axes:
            axis.update(t)

    def restart_losses(self, cycles: int) -> None:
        """Count losses from now on, because torque begins; `cycles` is the number of cycles so far."""
        self._cycles = cycles
        for axis in self._axes:
            axis.restart_losses()

    def update_losses(self, t: float, cycles: int) -> None:
        """Report a bus that loses answers or commands, about once a second; `cycles` is the number of cycles so far."""
        run, self._cycles = cycles - self._cycles, cycles
        for axis in self._axes:
            axis.update_losses(t, run)

    def update_skipped(self, t: float, now: float, rate: float) -> None:
        """Report, about once a second, a loop that skipped at least `SKIPPED_SHARE` of the periods of a second.

        Args:
            t: time of the log, s.
            now: monotonic time, s.
            rate: rate of the loop, Hz.
        """
        if now - self._checked < SECOND:
            return
        skipped, begin = self._overruns.worst_second(self._checked)
        self._checked = now
        if skipped and skipped >= SKIPPED_SHARE * rate and self._may_report_skipped.permits(t):
            planned = round(rate * SECOND)
            remedy = self._overruns.remedy(begin, planned)
            self._events.add(t, "", f"{skipped} of {planned} periods within a second had no cycle: {remedy}")


class ProcessNotices:
    """Monitor one process next to the loop, and add an event when it hangs, ends, is replaced, or responds again.

    A check only reads shared memory twice, so that the loop can check with every status.
    """

    def __init__(
        self,
        name: str,
        alive: Callable[[], bool],
        heard: Callable[[], float],
        replaced: Callable[[], int],
        if_hung: str,
        if_replaced: str,
        if_gone: str,
    ) -> None:
        """Prepare the monitoring of one process.

        Args:
            name: name of the process in the events.
            alive: returns False once it has ended.
            heard: returns the time of its last sign of life, s of the monotonic clock, 0 before the first.
            replaced: returns the number of its replacements so far.
            if_hung: consequence of a hanging process, for the events.
            if_replaced: consequence of its replacement.
            if_gone: consequence of its end, and the remedy.
        """
        self.silent = 0.0  # s since the last sign of life if more than `SILENT`, else 0
        self._name = name
        self._alive = alive
        self._heard = heard
        self._replaced = replaced
        self._if_hung, self._if_replaced, self._if_gone = if_hung, if_replaced, if_gone
        self._known = 0
        self._gone = False

    def update(self, t: float, now: float, events: Events) -> None:
        """Check the process and add events; `t` in s of the log, `now` in s of the monotonic clock."""
        heard, replaced = self._heard(), self._replaced()
        if heard == 0.0:  # it has not started yet
            return
        if replaced > self._known:
            self._known = replaced
            events.add(
                t, "", f"{self._name}: its process hung or was gone, and another one took over; {self._if_replaced}"
            )
        age = now - heard
        if age > SILENT and not self._gone and not self._alive():
            self._gone = True
            events.add(t, "", f"{self._name}: its process is gone; {self._if_gone}")
        hangs = age > SILENT and not self._gone
        if hangs and self.silent == 0.0:
            events.add(
                t, "", f"{self._name}: its process hangs, nothing was heard of it for {age:.1f} s; {self._if_hung}"
            )
        elif age <= SILENT and self.silent:
            events.add(t, "", f"{self._name}: its process answers again")
        self.silent = age if hangs else 0.0


def _range(domain: tuple[float, float]) -> str:
    return f"{domain[0]:.3g} to {domain[1]:.3g} N*m"
