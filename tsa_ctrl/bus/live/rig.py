"""Run the cyclic communication of all axes: SYNC out, TPDOs in, RPDOs out, with as few allocations as possible.

A cycle is `rig.sync()`, `rig.collect(deadline)`, then for each axis `axis.command(controlword, tau_m)`. A TPDO is fresh
only if it arrives after this cycle's SYNC. An earlier TPDO is late, a second one is repeated, and neither is used.
`check_startup` runs such cycles without commands before the first torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

from tsa_ctrl.bus.canopen import cia301
from tsa_ctrl.bus.canopen.cia301 import NmtCommand, NmtState
from tsa_ctrl.bus.canopen.objects import DIGITAL_INPUTS
from tsa_ctrl.bus.drive.checks import Report
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.axis import Axis, Handler, Inbox
from tsa_ctrl.bus.live.image import NodeHealth
from tsa_ctrl.bus.live.read_back import ReadBack, ReadTarget, StopBit, StopInput, held_by
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.bus.wire.bus import ERROR_FLAG, REMOTE_FLAG, Bus, BusFault, ErrorClass, Frame, describe
from tsa_ctrl.errors import BusError
from tsa_ctrl.system.sleep import Lead

_MAX_WAITING = 512  # most frames read before a SYNC; in a larger flood, old and new answers cannot be distinguished
_OTHERS = 16  # emergencies and heartbeats that may arrive between the answers
_MISJUDGED = 8  # consecutive cycles in which another answer than expected was the last
_ABANDONED = 10  # consecutive misses after which a cycle no longer waits for a node
_HEARTBEAT = cia301.heartbeat(NmtState.OPERATIONAL)
_NO_DATA = b""
_WRITES = (1, 6)  # CiA 301, client command specifiers: start of a download; start or end of a block download
_HIGHEST_EMCY = cia301.EMCY + 127


class Rig:
    """All axes of one bus, or of several buses combined (`bus.wire.bus.BusGroup`).

    Args:
        bus: the bus.
        settings: settings of the bus.
        axes: nodes of each axis.
        profiles: drive profile of each axis, in the same order.
        wake_early: maximum time by which `wait` may wake up early, s.

    Attributes:
        axes: the axes.
        error_frames: number of error frames.
        last_error: meaning of the last error frame.
        flooded: number of cycles whose answers could not be distinguished from old ones.
    """

    def __init__(
        self,
        bus: Bus,
        settings: BusSettings,
        axes: Sequence[AxisNodes],
        profiles: Sequence[DriveProfile],
        wake_early: float = 0.0,
    ) -> None:
        self.bus = bus
        self._answers: dict[int, Inbox] = {}  # by identifier: TPDOs
        made = []
        for nodes, profile in zip(axes, profiles, strict=True):
            axis = Axis(nodes, profile, bus, self._answers)
            self._answers.update(zip(axis.tpdo_ids, axis.inboxes, strict=True))
            made.append(axis)
        self.axes = tuple(made)
        self.error_frames = 0
        self.last_error = ""
        self.flooded = 0
        self.has_commanded = False  # since this object was created
        self.monitor_acted: Callable[[float], bool] = lambda now: (
            False
        )  # returns True while the monitor acts: its frames are then expected
        self.withholds_heartbeat = False  # for a trial of the drives' own watchdogs
        self._clock = bus.clock
        self._settings = settings
        self._inboxes = tuple(inbox for inbox in self._answers.values() if inbox.every == 1)
        self._rare = tuple(inbox for inbox in self._answers.values() if inbox.every > 1)
        self._messages: dict[int, Handler] = {}  # by identifier: messages that may arrive at any time
        for axis in self.axes:
            for health, guard in zip(axis.image.nodes, axis.guards, strict=True):
                self._hear(cia301.HEARTBEAT + health.node_id, guard.heartbeat)
                self._hear(cia301.EMCY + health.node_id, guard.emergency)
        self._guarded = sorted(
            {axis.nodes.drive.node_id for axis in self.axes if axis.profile.supervision == "guarding"}
        )  # their state is requested by remote frames
        ours = [
            cia301.NMT,
            cia301.SYNC,
            cia301.HEARTBEAT + settings.host_node_id,
            *(axis.rpdo_id for axis in self.axes),
        ]
        self._messages.update({can_id: partial(self._meet_intruder, can_id) for can_id in ours})
        asked = [cia301.SDO_REQUEST + health.node_id for axis in self.axes for health in axis.image.nodes]
        self._messages.update({can_id: partial(self._meet_request, can_id) for can_id in asked})
        self._heartbeat_id = cia301.HEARTBEAT + settings.host_node_id
        self._next_heartbeat = -math.inf
        self._expected = len(self._inboxes)
        self._synced = -math.inf
        self._flooded_now = False
        self._emptied = False
        self._lead = Lead(wake_early)
        self._read_back: ReadBack | None = None
        self._patience = 0.0  # s that the last cycle was prepared to wait for answers
        self._last = 0  # identifier of the answer expected last
        self._later = 0  # consecutive cycles in which another answer arrived later

    def _hear(self, can_id: int, handler: Handler) -> None:
        """Add a handler for an identifier; a node of two axes has two handlers."""
        first = self._messages.get(can_id)
        if first is None:
            self._messages[can_id] = handler
            return

        def both(data: bytes, first: Handler = first) -> None:
            first(data)
            handler(data)

        self._messages[can_id] = both

    @property
    def settings(self) -> BusSettings:
        return self._settings

    @property
    def commands(self) -> bool:
        """Return True if any drive receives commands; see `stand_off`."""
        return any(not axis.stands_off for axis in self.axes)

    @property
    def longest_turn(self) -> int:
        """Return the number of SYNCs within which every node sends each of its rare PDOs; 0 without rare PDOs."""
        return max((inbox.every + 1 for inbox in self._rare), default=0)

    def look_after(self, report: Report, stop: StopBit | None = None) -> None:
        """Read back the objects that the bring-up wrote, beginning with the next `start`.

        `stop` is the input of the emergency stop at each drive with digital inputs, or None.
        """
        held = held_by(report)
        if held:
            settings = self._settings
            targets = [ReadTarget(axis.nodes.drive.node_id, axis.target, axis.readback) for axis in self.axes]
            share = settings.supervision.lost_share
            stops = self._stops(report, stop)
            self._read_back = ReadBack(self.bus, settings.bitrate, held, targets, share, stops)
            for node_id in {each.node_id for each in held} | {each.node_id for each in targets}:
                self._messages[cia301.SDO_ANSWER + node_id] = partial(self._compare, node_id)

    def _stops(self, report: Report, wiring: StopBit | None) -> list[StopInput]:
        """Return the emergency stop input of each axis whose drive has digital inputs."""
        if wiring is None:
            return []
        inputs = {(node.node_id, node.digital_inputs) for node in report.nodes if node.digital_inputs is not None}
        return [
            StopInput(drive.node_id, entry, wiring, axis.image)
            for axis in self.axes
            for drive in (axis.nodes.drive,)
            for entry in (DIGITAL_INPUTS.of(drive.slot),)
            if (drive.node_id, entry) in inputs
        ]

    def read_back(self, now: float) -> None:
        """Request the next object if it is due. Call it at the end of a cycle, after the answers have arrived."""
        if self._read_back is not None:
            self._read_back.update(now)

    def stand_off(self) -> None:
        """Send no commands until `start`, because the drives are about to be configured and may have been exchanged."""
        self._read_back = None
        for axis in self.axes:
            axis.stands_off = True

    def start(self) -> None:
        """Begin commanding after all nodes are configured: receive only their frames, and discard old answers.

        Emergencies received since the bring-up are kept.
        """
        self.bus.accept([*self._answers, *self._messages])
        now = self._clock()
        for axis in self.axes:
            axis.rearm(now)
            axis.stands_off = False
        self.has_commanded = True
        for can_id, data in self.bus.gather(0.0, _MAX_WAITING):
            if cia301.EMCY < can_id <= _HIGHEST_EMCY:
                self._take_message(can_id, data)
        self.bus.flush()
        for inbox in self._answers.values():
            inbox.begin()
        self._expect()

    def wait(self, until: float) -> float:
        """Sleep until `until` (monotonic s), then process the received frames: emergencies, heartbeats, late answers.

        A loop calls this instead of sleeping, so that `sync` need not check for waiting frames. An old answer is
        accepted, once, only if it arrives within the microseconds between both calls.

        The call wakes up early by the recent wake-up latency, and processes frames until `until`. Before it sleeps, it
        sets the timer that ends the wait for the next answers.

        Returns:
            The time after the wait, s.
        """
        lead = self._lead.value
        if self._patience > 0.0:
            self.bus.expect(until + self._patience)
        now = self._empty(until - lead)
        self._lead.learn(now - until + lead)
        while now < until:
            now = self._empty(0.0)
        return now

    def _empty(self, until: float) -> float:
        """Receive the frames until `until` without accepting them as answers; return the time."""
        frames = self.bus.gather(until, _MAX_WAITING)
        for frame in frames:
            self._take_stale(frame)
        self._flooded_now |= len(frames) >= _MAX_WAITING
        self._emptied = True
        return self._clock()

    def sync(self, now: float | None = None) -> bool:
        """Begin a cycle at `now` (default: read the clock): take waiting frames, unless `wait` just did, and send SYNC.

        Returns:
            False if the SYNC was dropped.
        """
        if not self._emptied:
            self._empty(0.0)
        self._emptied = False
        for inbox in self._inboxes:
            inbox.armed = True
        for inbox in self._rare:
            inbox.count_sync()
        self._synced = self._clock() if now is None else now
        return self.bus.send(cia301.SYNC, _NO_DATA)

    def collect(self, deadline: float) -> float:
        """Receive until every node has answered this SYNC, or until `deadline` (monotonic s); return the SYNC time.

        The call waits for the last answer and takes all at once. A wake-up for each answer would cost more than a
        cycle's arithmetic, and would take processor time from nodes on the same processor.
        """
        answers, bus = self._answers, self.bus
        self._patience = deadline - self._synced
        pending = 0 if self._flooded_now else self._expected
        if pending:
            frames = bus.answers(self._patience, pending)
            taken, rounds, over, last = 0, 0, False, self._last
            while True:
                for can_id, data in frames:
                    inbox = answers.get(can_id)
                    if inbox is None:
                        self._take_message(can_id, data)
                    elif inbox.armed and len(data) == inbox.length:
                        inbox.armed = False
                        inbox.store(inbox.unpack(data))
                        if inbox.awaited:
                            pending -= 1
                            last = can_id
                    else:
                        inbox.refuse(data)
                taken += len(frames)
                rounds += 1
                if pending <= 0 or over or taken >= _MAX_WAITING:
                    break
                remaining = deadline - self._clock()
                frame = bus.recv(remaining) if remaining > 0.0 else None
                over = frame is None  # afterwards only frames that arrived in time are taken
                frames = bus.gather(deadline, pending + _OTHERS) if frame is None else (frame,)
            if rounds > 1 and pending <= 0:
                self._learn_the_last(last)
        complete = pending <= 0 and self._expected == len(self._inboxes) and not self._flooded_now
        for inbox in self._rare:
            complete = complete and not inbox.is_overdue
        if self._flooded_now:
            self.flooded += 1
            self._flooded_now = False
        for axis in self.axes:
            axis.settle(self._synced, complete)
            fault = axis.bus.fault
            if fault is not None:
                axis.image.bus_fault = fault
        if not complete:
            for inbox in self._inboxes:
                inbox.awaited = int(inbox.health.misses <= _ABANDONED)
            self._expect()
        return self._synced

    def _expect(self) -> None:
        """Count the answers to wait for; the answer with the lowest priority is expected last."""
        awaited = [can_id for can_id, inbox in self._answers.items() if inbox.awaited]
        if len(awaited) != self._expected or self._last not in awaited:
            self._expected = len(awaited)
            last = {axis.bus: 0 for axis in self.axes}
            for axis in self.axes:
                last[axis.bus] = max(last[axis.bus], *(can_id for can_id in axis.tpdo_ids if can_id in awaited), 0)
            for can_id in sorted(last.values()):
                self._listen_for(can_id)

    def _learn_the_last(self, can_id: int) -> None:
        """Expect `can_id` last if it has repeatedly completed a cycle in place of the identifier expected last."""
        self._later = 0 if can_id == self._last else self._later + 1
        if self._later >= _MISJUDGED:
            self._listen_for(can_id)

    def _listen_for(self, can_id: int) -> None:
        self._last = can_id
        self._later = 0
        self.bus.listen_for(can_id)

    def heartbeat(self, now: float) -> None:
        """Send our heartbeat when it is due. Call it every cycle, and never delegate it to a timer of the kernel."""
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + self._settings.host_heartbeat_period
            if self.withholds_heartbeat:
                return
            self.bus.send(self._heartbeat_id, _HEARTBEAT)
            for node_id in self._guarded:
                self.bus.send(REMOTE_FLAG | cia301.HEARTBEAT + node_id, _NO_DATA)

    def nmt(self, command: NmtCommand, node_id: int = cia301.ALL_NODES) -> bool:
        """Send an NMT command to one node or to all."""
        return self.bus.send(cia301.NMT, cia301.nmt(command, node_id))

    def _take_stale(self, frame: Frame) -> None:
        """Process a frame from outside a cycle's window: count a late answer, handle a message."""
        can_id, data = frame
        inbox = self._answers.get(can_id)
        if inbox is None:
            self._take_message(can_id, data)
        else:
            inbox.refuse_stale(data)

    def _take_message(self, can_id: int, data: bytes) -> None:
        handler = self._messages.get(can_id)
        if handler is not None:
            handler(data)
        elif can_id & ERROR_FLAG:
            self.error_frames += 1
            self.bus.counters.error_frames += 1
            self.last_error = describe(can_id, data)
            if can_id & ErrorClass.BUS_OFF and self.bus.fault is None:
                self.bus.fault = BusFault.BUS_OFF

    def _compare(self, node_id: int, data: bytes) -> None:
        """Compare an SDO answer with the configured value, and report an altered object."""
        reader = self._read_back
        if reader is None or not reader.answer(node_id, data):
            return
        for axis in self.axes:
            for health in axis.image.nodes:
                if health.node_id == node_id:
                    axis.image.altered = f"{health}: {reader.altered[node_id]}"

    def _meet_request(self, can_id: int, data: bytes) -> None:
        """Report an SDO write of another master, which may remove a watchdog or a clamp; a read is harmless."""
        if data and data[0] >> 5 in _WRITES:
            self._meet_intruder(can_id, data)

    def _meet_intruder(self, can_id: int, data: bytes) -> None:
        """Report a frame of another master. The bus does not receive its own frames; the monitor's are expected."""
        if self.monitor_acted(self._clock()):
            return
        for axis in self.axes:
            axis.image.intruder = can_id


_LEAST_ANSWERED = 0.8  # share of SYNCs that each node must answer before torque is allowed
_MOST_PDOS = 4  # TPDOs of a node in a cycle (CiA 301 defaults); this many may arrive late with one cycle
_GONE = 3  # unanswered SYNCs at the end after which a node counts as gone


def check_startup(rig: Rig, period: float, cycles: int = 50) -> None:
    """Send SYNC at the period (s) without commands, so that the slow first cycles do not count in the loop.

    Raises:
        BusError: a node answers less than 80 % of `cycles` SYNCs, or none of the last three. Or it answers more than
            once, as two nodes with one id do.
    """
    nodes = [(axis.name, health) for axis in rig.axes for health in axis.image.nodes]
    cycles += rig.longest_turn  # so that rare PDOs are also received
    before = [(health.missed, health.repeated) for _, health in nodes]
    begin = rig.wait(0.0)
    for _ in range(cycles):
        begin = rig.wait(begin + period)
        rig.sync(begin)
        rig.collect(begin + 0.8 * period)
        rig.heartbeat(begin)
    for (name, health), (missed, repeated) in zip(nodes, before, strict=True):
        answered = cycles - (health.missed - missed)
        if answered < _LEAST_ANSWERED * cycles or health.misses >= _GONE:
            raise BusError(
                f"axis '{name}' {health}: answered {answered} of {cycles} SYNCs in time "
                f"(late {health.late}, wrong length {health.malformed}){_said(health)}"
            )
        more = health.repeated - repeated - _MOST_PDOS * (health.missed - missed)  # late ones arrive with the next
        if more > (1.0 - _LEAST_ANSWERED) * cycles:
            raise BusError(
                f"axis '{name}' {health}: sent {more} more PDOs than {cycles} SYNCs requested; "
                f"another node may have the same id: give each its own (switches, maker's tool or "
                f"tsa drive set-node-id){_said(health, '')}"
            )


def _said(health: NodeHealth, otherwise: str = "; check the bus load, collect in [controller], and the cable") -> str:
    """Return the last emergency of a node as the end of a message, or `otherwise` if it sent none."""
    if health.emcy is None:
        return otherwise
    return f"; it sent {health.emcy}: remove the reported cause, power-cycle the node and start again"
