"""The cyclic side of all axes on one bus: SYNC out, TPDOs in, RPDOs out. Nothing here allocates more than it must.

A cycle is `rig.sync()`, `rig.collect(deadline)`, then for each axis `axis.command(controlword, tau_m)`. A TPDO counts
as fresh only when it came after this cycle's SYNC: what waited before that is late, what comes twice is repeated, and
neither is believed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from tsa_ctrl.bus import cia301, emcy, pdo
from tsa_ctrl.bus.cia301 import NmtCommand, NmtState
from tsa_ctrl.bus.error_frames import ErrorClass, describe
from tsa_ctrl.bus.image import Image, NodeHealth, Role
from tsa_ctrl.bus.pdo import Pdo
from tsa_ctrl.bus.profile import DriveProfile
from tsa_ctrl.bus.scale import DriveScale, drive_scale, encoder_scale
from tsa_ctrl.bus.seam import ERROR_FLAG, Bus, BusFault, Frame
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, NodeSettings
from tsa_ctrl.bus.tracker import PositionTracker

_MAX_WAITING = 512  # frames taken before a SYNC; more is a flood, in which old answers cannot be told from new ones
_AFTER_DEADLINE = 64  # frames still taken when the deadline has passed, because they came in time
_ABANDONED = 10  # misses in a row after which a cycle no longer waits for a node
_HEARTBEAT = cia301.heartbeat(NmtState.OPERATIONAL)
_NO_DATA = b""
_COUNTER_RANGE = 1 << 32  # where 0x6064 wraps

Handler = Callable[[bytes], int]


class Inbox:
    """One TPDO: takes its first well-formed frame after a SYNC, counts the others."""

    __slots__ = ("_length", "_store", "_unpack", "armed", "health")

    def __init__(self, layout: Pdo, health: NodeHealth, store: Callable[[tuple[Any, ...]], None]) -> None:
        self.health = health
        self.armed = False
        self._length = layout.length
        self._unpack = layout.struct.unpack
        self._store = store

    def receive(self, data: bytes) -> int:
        """1 when the frame is this cycle's answer, else 0."""
        if len(data) != self._length:
            self.health.malformed += 1
            return 0
        if not self.armed:
            self.health.repeated += 1
            return 0
        self.armed = False
        self._store(self._unpack(data))
        return 1

    def stale(self, data: bytes) -> int:
        """Count a frame that waited before the SYNC."""
        if len(data) != self._length:
            self.health.malformed += 1
        elif self.armed:
            self.health.late += 1
        else:
            self.health.repeated += 1
        return 0


class Guard:
    """Heartbeat, boot-up and emergencies of one node."""

    __slots__ = ("_clock", "_health", "_image")

    def __init__(self, health: NodeHealth, image: Image, clock: Callable[[], float]) -> None:
        self._health = health
        self._image = image
        self._clock = clock

    def heartbeat(self, data: bytes) -> int:
        health = self._health
        state = cia301.heartbeat_state(data)
        if state is None:
            health.malformed += 1
            return 0
        health.heard = self._clock()
        if state == NmtState.BOOT_UP:
            health.boot_ups += 1
            self._image.events += 1
        if state != health.nmt_state:
            health.nmt_state = state
            self._image.events += 1
        return 0

    def emergency(self, data: bytes) -> int:
        health = self._health
        found = emcy.decode(data)
        if found is None:
            health.malformed += 1
        elif not found.is_reset:
            health.emcy = found
            health.emcys += 1
            self._image.events += 1
        return 0


class Axis:
    """One axis: its process image and its command. SI at the motor pulley and the joint."""

    def __init__(self, nodes: AxisNodes, profile: DriveProfile, bus: Bus, clock: Callable[[], float]) -> None:
        self.name = nodes.name
        self.nodes = nodes
        self.profile = profile
        drive, encoder, sensor = nodes.drive, nodes.encoder, nodes.torque_sensor
        self.scale: DriveScale = drive_scale(drive, profile, f"axis '{nodes.name}'")
        self.refused = 0  # commands that were not finite, and were sent as zero
        self.tau_m_sent = 0.0  # N*m, the last command as the drive was given it

        health = _health(Role.DRIVE, drive)
        guarded = [health]
        self._inboxes = [
            Inbox(pdo.MOTION, health, self._store_motion),
            Inbox(pdo.POSITION, health, self._store_position),
        ]
        self._control_inboxes = list(self._inboxes)  # without whose answers the axis is not fresh
        self._ids = [pdo.MOTION.cob_id(drive.node_id), pdo.POSITION.cob_id(drive.node_id)]
        self._joint: PositionTracker | None = None
        if encoder is not None:
            health = _health(Role.ENCODER, encoder)
            guarded.append(health)
            self._inboxes.append(Inbox(pdo.ENCODER, health, self._store_encoder))
            self._control_inboxes.append(self._inboxes[-1])
            self._ids.append(pdo.ENCODER.cob_id(encoder.node_id))
            scale = encoder_scale(encoder)
            self._joint = PositionTracker(scale, encoder.counts_range, encoder.zero, encoder.velocity_cutoff)
        if sensor is not None:
            health = _health(Role.TORQUE_SENSOR, sensor)
            guarded.append(health)
            self._inboxes.append(Inbox(pdo.TORQUE_SENSOR, health, self._store_torque))
            self._ids.append(pdo.TORQUE_SENSOR.cob_id(sensor.node_id))
            self._sensor_scale = sensor.sign * sensor.resolution
            self._sensor_offset = sensor.offset
        self.image = Image(tuple(guarded))
        self._guards = [Guard(health, self.image, clock) for health in guarded]

        self._motor = PositionTracker(self.scale.position, _COUNTER_RANGE, 0, drive.velocity_cutoff)
        self._differentiate_motor = drive.velocity_source == "position"
        self._joint_count = 0
        self._motor_count = 0
        self._sampled = -math.inf
        self._torque = self.scale.torque
        self._velocity = self.scale.velocity
        self._per_newton_metre = 1.0 / self.scale.torque
        self._limit = float(self.scale.max_torque_digits)
        self._send = bus.send
        self._rpdo = pdo.COMMAND.cob_id(drive.node_id)
        self._pack = pdo.COMMAND.struct.pack

    def command(self, controlword: int, tau_m: float) -> bool:
        """Send one RPDO: `controlword`, and `tau_m` (N*m at the motor pulley) clamped to the drive's limit.

        What is not finite is sent as zero and counted in `refused`. False when the frame was dropped.
        """
        digits = tau_m * self._per_newton_metre
        if -self._limit <= digits <= self._limit:
            raw = round(digits)
        elif math.isfinite(digits):
            raw = int(math.copysign(self._limit, digits))
        else:
            raw = 0
            self.refused += 1
        self.tau_m_sent = raw * self._torque
        if self._send(self._rpdo, self._pack(controlword, raw)):
            self.image.drops = 0
            return True
        self.image.drops += 1
        return False

    def rearm(self, now: float) -> None:
        """Forget what was latched, after the nodes of this axis have been configured again."""
        image = self.image
        for health in image.nodes:
            health.heard = now
            health.nmt_state = NmtState.OPERATIONAL
            health.boot_ups = health.emcys = health.misses = 0
            health.emcy = None
        image.silent = image.intruder = image.bus_fault = None
        image.fresh = image.joint_fresh = False
        image.misses = image.drops = image.events = 0
        self._motor.reset()
        if self._joint is not None:
            self._joint.reset()

    def _store_motion(self, values: tuple[Any, ...]) -> None:
        image = self.image
        image.statusword, torque, velocity = values
        image.tau_m = torque * self._torque
        if not self._differentiate_motor:
            image.omega_m = velocity * self._velocity

    def _store_position(self, values: tuple[Any, ...]) -> None:
        image = self.image
        self._motor_count, image.mode, image.error_code = values

    def _store_encoder(self, values: tuple[Any, ...]) -> None:
        self._joint_count = values[0]

    def _store_torque(self, values: tuple[Any, ...]) -> None:
        self.image.tau_j = values[0] * self._sensor_scale - self._sensor_offset

    def settle(self, sampled: float, now: float, complete: bool) -> None:
        """Close a cycle: derive what follows from positions sampled at `sampled`, and judge freshness at `now`."""
        image = self.image
        image.now = now
        fresh = joint_fresh = True
        if not complete:
            fresh, joint_fresh = self._count_misses()
        if self._joint is not None and joint_fresh:
            self._joint.update(self._joint_count, sampled)
            image.q_j = self._joint.angle
            image.omega_j = self._joint.velocity
        image.joint_fresh = joint_fresh
        image.fresh = fresh
        if fresh:
            self._motor.update(self._motor_count, sampled)
            image.q_m = self._motor.angle
            if self._differentiate_motor:
                image.omega_m = self._motor.velocity
            image.misses = 0
            self._sampled = sampled
        else:
            image.misses += 1
            image.missed += 1
        image.pdo_age = now - self._sampled
        image.silent = None
        for health in image.nodes:
            if now - health.heard > health.timeout:
                image.silent = health
                break

    def _count_misses(self) -> tuple[bool, bool]:
        """Charge each node with the answers that did not come; returns fresh, joint_fresh."""
        joint_fresh = True
        for health in self.image.nodes:
            if any(inbox.armed for inbox in self._inboxes if inbox.health is health):
                health.misses += 1
                health.missed += 1
                joint_fresh = joint_fresh and health.role is not Role.ENCODER
            else:
                health.misses = 0
        return not any(inbox.armed for inbox in self._control_inboxes), joint_fresh


class Rig:
    """All axes of one bus.

    `axes` and `profiles` belong together one by one; `clock` is monotonic, in s. Attributes: `axes`, `error_frames`
    (counted), `last_error` (what the last one said), `flooded` (cycles whose answers could not be told from old ones).
    """

    def __init__(
        self,
        bus: Bus,
        settings: BusSettings,
        axes: Sequence[AxisNodes],
        profiles: Sequence[DriveProfile],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.bus = bus
        self.axes = tuple(Axis(nodes, profile, bus, clock) for nodes, profile in zip(axes, profiles, strict=True))
        self.error_frames = 0
        self.last_error = ""
        self.flooded = 0
        self._clock = clock
        self._settings = settings
        self._inboxes = tuple(inbox for axis in self.axes for inbox in axis._inboxes)
        self._receive: dict[int, Handler] = {}
        self._stale: dict[int, Handler] = {}
        for axis in self.axes:
            for can_id, inbox in zip(axis._ids, axis._inboxes, strict=True):
                self._receive[can_id] = inbox.receive
                self._stale[can_id] = inbox.stale
            for health, guard in zip(axis.image.nodes, axis._guards, strict=True):
                for table in (self._receive, self._stale):
                    table[cia301.HEARTBEAT + health.node_id] = guard.heartbeat
                    table[cia301.EMCY + health.node_id] = guard.emergency
        ours = [cia301.NMT, cia301.SYNC, cia301.HEARTBEAT + settings.host_node_id, *(axis._rpdo for axis in self.axes)]
        for can_id in ours:
            self._receive[can_id] = self._stale[can_id] = partial(self._meet_intruder, can_id)
        self._heartbeat_id = cia301.HEARTBEAT + settings.host_node_id
        self._next_heartbeat = -math.inf
        self._expected = len(self._inboxes)
        self._synced = -math.inf
        self._flooded_now = False

    def start(self) -> None:
        """Listen to the nodes of this rig only and forget what was received before; once, before the first cycle."""
        self.bus.accept(self._receive)
        self.bus.flush()
        now = self._clock()
        for axis in self.axes:
            axis.rearm(now)

    def sync(self) -> bool:
        """Begin a cycle: take what waited (emergencies, heartbeats; late answers are counted), then send SYNC."""
        recv = self.bus.recv
        frame = recv(0.0)
        if frame is not None:
            self._take_waiting(frame)
        for inbox in self._inboxes:
            inbox.armed = True
        self._synced = self._clock()
        return self.bus.send(cia301.SYNC, _NO_DATA)

    def collect(self, deadline: float) -> float:
        """Receive until every node has answered this SYNC, or until `deadline` (monotonic s); returns the time now."""
        recv, receive, clock = self.bus.recv, self._receive, self._clock
        pending = 0 if self._flooded_now else self._expected
        spare = _AFTER_DEADLINE
        now = self._synced
        while pending > 0:
            remaining = deadline - now
            if remaining <= 0.0:
                spare -= 1
                if spare < 0:
                    break
            frame = recv(remaining)
            if frame is None:
                break
            now = clock()
            handler = receive.get(frame[0])
            if handler is not None:
                pending -= handler(frame[1])
            else:
                self._take_other(frame)
        now = clock()
        complete = pending == 0 and self._expected == len(self._inboxes) and not self._flooded_now
        self._flooded_now = False
        fault = self.bus.fault
        for axis in self.axes:
            axis.settle(self._synced, now, complete)
            if fault is not None:
                axis.image.bus_fault = fault
        if not complete:
            self._expected = sum(inbox.health.misses <= _ABANDONED for inbox in self._inboxes)
        return now

    def heartbeat(self, now: float) -> None:
        """Send our heartbeat when it is due; call it every cycle, and never hand it to a timer of the kernel."""
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + self._settings.host_heartbeat_period
            self.bus.send(self._heartbeat_id, _HEARTBEAT)

    def nmt(self, command: NmtCommand, node_id: int = cia301.ALL_NODES) -> bool:
        """Send an NMT command to one node or to all."""
        return self.bus.send(cia301.NMT, cia301.nmt(command, node_id))

    def _take_waiting(self, frame: Frame | None) -> None:
        for _ in range(_MAX_WAITING):
            if frame is None:
                return
            handler = self._stale.get(frame[0])
            if handler is not None:
                handler(frame[1])
            else:
                self._take_other(frame)
            frame = self.bus.recv(0.0)
        self.flooded += 1
        self._flooded_now = True

    def _take_other(self, frame: Frame) -> None:
        can_id, data = frame
        if can_id & ERROR_FLAG:
            self.error_frames += 1
            self.bus.counters.error_frames += 1
            self.last_error = describe(can_id, data)
            if can_id & ErrorClass.BUS_OFF and self.bus.fault is None:
                self.bus.fault = BusFault.BUS_OFF

    def _meet_intruder(self, can_id: int, data: bytes) -> int:
        """A frame that only a master sends, and not ours: a bus hears its own frames never."""
        for axis in self.axes:
            axis.image.intruder = can_id
        return 0


def _health(role: Role, node: NodeSettings) -> NodeHealth:
    return NodeHealth(role, node.node_id, node.heartbeat_timeout)
