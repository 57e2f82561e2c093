"""One axis on the bus: converts frames of its nodes to its process image, and its torque command to an RPDO."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from tsa_ctrl.bus.canopen import cia301, objects, pdo
from tsa_ctrl.bus.canopen.cia301 import NmtState
from tsa_ctrl.bus.canopen.pdo import Pdo
from tsa_ctrl.bus.drive.network import layout_of, torque_sensor_pdo
from tsa_ctrl.bus.drive.profile import DriveProfile, DriveScale, drive_scale, encoder_scale
from tsa_ctrl.bus.live.image import Image, NodeHealth
from tsa_ctrl.bus.live.read_back import CommandReadback
from tsa_ctrl.bus.settings import AxisNodes, NodeSettings, Role
from tsa_ctrl.bus.wire.bus import Bus, wire_of


class PositionTracker:
    """Convert a position counter that wraps to an unwrapped angle and an angular velocity.

    The velocity is the difference of two positions over the measured interval dt. A first-order low-pass with the
    cutoff f_c filters it: omega += (1 - exp(-2 pi f_c dt)) (dq/dt - omega). Its delay is 1 / (2 pi f_c). A missed
    sample only makes dt longer.

    Attributes:
        angle: rad; nan until the first sample. The first angle is the one nearest to 0.
        velocity: rad/s; 0 until the second sample.
    """

    __slots__ = ("_half", "_last", "_range", "_scale", "_time", "_total", "_w", "_zero", "angle", "velocity")

    def __init__(self, radians_per_count: float, counts_range: int, zero: int, cutoff: float) -> None:
        self._scale = radians_per_count
        self._range = counts_range
        self._half = counts_range // 2
        self._zero = zero
        self._w = -2.0 * math.pi * cutoff
        self.reset()

    def reset(self) -> None:
        """Clear the state, so that the next sample counts as the first."""
        self._last: int | None = None
        self._total = 0
        self._time = 0.0
        self.angle = math.nan
        self.velocity = 0.0

    def take_position(self, count: int) -> int:
        """Take a position without a velocity update; return the step in counts since the last position."""
        last = self._last
        self._last = count
        if last is None:
            step = 0
            self._total = (count - self._zero + self._half) % self._range - self._half
        else:
            step = count - last
            if not -self._half <= step < self._half:
                step = (step + self._half) % self._range - self._half
            self._total += step
        self.angle = self._total * self._scale
        return step

    def update(self, count: int, t: float) -> None:
        """Take a position sampled at `t` (s), and update the velocity."""
        first = self._last is None
        step = self.take_position(count)
        dt = t - self._time
        if first:
            self._time = t
        elif dt > 0.0:
            self._time = t
            self.velocity += (1.0 - math.exp(self._w * dt)) * (step * self._scale / dt - self.velocity)


_FAULT = 0x0008  # bit 3 of 0x6041
_COUNTER_RANGE = 1 << 32  # where 0x6064 wraps

Handler = Callable[[bytes], None]


class Inbox:
    """One TPDO. A cycle takes its first well-formed frame after the SYNC; other frames are counted here.

    The rig's loop takes the frame. `armed` is True until this cycle's answer has arrived. `awaited` is 0 if cycles no
    longer wait for the node.

    A TPDO of every n-th SYNC (`every`) is never awaited. It is taken whenever it arrives, but not before it is due,
    because then it is a repetition. `gap` counts the SYNCs since its last arrival.
    """

    __slots__ = ("armed", "awaited", "every", "gap", "health", "length", "seen", "store", "turn", "unpack")

    def __init__(self, layout: Pdo, health: NodeHealth, store: Callable[[tuple[Any, ...]], None]) -> None:
        self.health = health
        self.length = layout.length
        self.unpack = layout.struct.unpack
        self.store = store
        self.every = layout.every
        # SYNCs after which the next answer may arrive. With a long period one fewer, because the last may have been
        # late.
        self.turn = self.every - 1 if self.every > 2 else self.every
        self.begin()
        if self.every > 1:
            self.share(self._taken)

    def begin(self) -> None:
        """Wait for the first answer."""
        self.armed = False
        self.awaited = int(self.every == 1)
        self.gap = 0
        self.seen = False  # the first arrives at any SYNC, because a node counts SYNCs from its own start

    def _taken(self, values: tuple[Any, ...]) -> None:
        self.gap = 0
        self.seen = True

    def count_sync(self) -> None:
        """Begin a cycle for a TPDO that is not sent on each SYNC."""
        self.gap += 1
        self.armed = self.gap >= self.turn or not self.seen

    @property
    def is_overdue(self) -> bool:
        """Return True if a TPDO of every n-th SYNC is missing; a busy bus is allowed one more SYNC."""
        return self.every > 1 and self.gap > self.every + 1

    @property
    def is_missing(self) -> bool:
        """Return True if this cycle lacks a due answer."""
        return self.armed if self.every == 1 else self.is_overdue

    def share(self, store: Callable[[tuple[Any, ...]], None]) -> None:
        """Also pass received frames to another axis that uses the same encoder."""
        first = self.store

        def both(values: tuple[Any, ...]) -> None:
            first(values)
            store(values)

        self.store = both

    def refuse(self, data: bytes) -> None:
        """Count a frame that cannot be this cycle's answer: it has a wrong length, or an answer was already taken."""
        if len(data) != self.length:
            self.health.malformed += 1
        else:
            self.health.repeated += 1

    def refuse_stale(self, data: bytes) -> None:
        """Count a frame that arrived before the SYNC; a TPDO of every n-th SYNC is taken."""
        if len(data) != self.length or not self.armed:
            self.refuse(data)
            return
        if self.every > 1:
            self.armed = False
            self.store(self.unpack(data))
            return
        self.health.late += 1
        if not self.awaited:
            self.health.misses = 0  # alive again: the next cycles wait for the node


class Guard:
    """Process the heartbeats, boot-ups and emergencies of one node."""

    __slots__ = ("_clock", "_guarded", "_health", "_image", "_toggle")

    def __init__(self, health: NodeHealth, image: Image, clock: Callable[[], float], guarded: bool = False) -> None:
        """`guarded`: the node has no heartbeat and answers node guarding."""
        self._health = health
        self._image = image
        self._clock = clock
        self._guarded = guarded
        self._toggle: int | None = None  # toggle bit of the last answer

    def begin(self) -> None:
        """Accept either toggle bit in the next answer, after a new bring-up."""
        self._toggle = None

    def heartbeat(self, data: bytes) -> None:
        health = self._health
        state = cia301.heartbeat_state(data)
        if state is None:
            health.malformed += 1
            return
        if self._guarded:
            toggle = None if state == NmtState.BOOT_UP else data[0] & cia301.TOGGLE
            if toggle is not None and toggle == self._toggle:  # CiA 301, 7.2.8.3.2.1: treated as not received
                health.untoggled += 1
                return
            self._toggle = toggle
        health.heard = self._clock()
        if state == NmtState.BOOT_UP:
            health.boot_ups += 1
            self._image.events += 1
        if state != health.nmt_state:
            health.nmt_state = state
            self._image.events += 1

    def emergency(self, data: bytes) -> None:
        health = self._health
        found = cia301.decode(data)
        if found is None:
            health.malformed += 1
        elif found.code in health.told:
            health.warning = found
            health.warnings += 1
        elif not found.is_reset:
            health.emcy = found
            health.emcys += 1
            self._image.events += 1


class Axis:
    """One axis with its process image and its command, in SI units at the motor pulley and the joint.

    `shared` maps identifiers to inboxes of other axes, so that two axes can use one encoder.

    Attributes:
        stands_off: True if nothing is commanded, because ownership and mapping of the drive are not confirmed.
        target: object with the last torque command that the drive received.
    """

    def __init__(
        self,
        nodes: AxisNodes,
        profile: DriveProfile,
        bus: Bus,
        shared: Mapping[int, Inbox] | None = None,
    ) -> None:
        self.name = nodes.name
        self.nodes = nodes
        self.profile = profile
        drive, encoder, sensor = nodes.drive, nodes.encoder, nodes.torque_sensor
        self.scale: DriveScale = drive_scale(drive, profile, f"axis '{nodes.name}'")
        self.refused = 0  # commands that were not finite, and were sent as zero
        self.tau_m_sent = 0.0  # N*m, the last command in whole digits of the drive
        self.stands_off = True

        self.target = objects.TARGET_TORQUE.of(drive.slot)
        layout = layout_of(drive, profile)
        health = _health(Role.DRIVE, drive)
        health.told = frozenset(profile.warnings)
        guarded = [health]
        self._has_error_code = profile.has(objects.ERROR_CODE)
        self._is_lean = drive.pdo == "lean"
        store_motion, store_position = self._store_motion, self._store_position
        if self._is_lean:
            store_motion, store_position = self._store_lean_motion, self._store_lean_state
        self.inboxes = [Inbox(layout.motion, health, store_motion), Inbox(layout.position, health, store_position)]
        self._control_inboxes = list(self.inboxes)  # the axis is fresh only with these answers
        self._watched = [(health, tuple(self.inboxes))]  # the answers of each node
        self.tpdo_ids = list(layout.tpdo_ids)
        self._joint: PositionTracker | None = None
        if encoder is not None:
            health = _health(Role.ENCODER, encoder)
            guarded.append(health)
            can_id = pdo.ENCODER.cob_id(encoder.node_id)
            inbox = (shared or {}).get(can_id)
            if inbox is None:
                inbox = Inbox(pdo.ENCODER, health, self._store_encoder)
            else:
                inbox.share(self._store_encoder)
            self.inboxes.append(inbox)
            self._control_inboxes.append(inbox)
            self._watched.append((health, (inbox,)))
            self.tpdo_ids.append(can_id)
            scale = encoder_scale(encoder)
            self._joint = PositionTracker(scale, encoder.counts_range, encoder.zero, encoder.velocity_cutoff)
        if sensor is not None:
            health = _health(Role.TORQUE_SENSOR, sensor)
            guarded.append(health)
            self.inboxes.append(Inbox(torque_sensor_pdo(sensor), health, self._store_torque))
            self._watched.append((health, (self.inboxes[-1],)))
            self.tpdo_ids.append(pdo.TORQUE_SENSOR.cob_id(sensor.node_id))
            self._sensor_scale = sensor.sign * sensor.resolution
            self._sensor_offset = sensor.offset
        self.image = Image(tuple(guarded))
        by_guarding = profile.supervision == "guarding"
        self.guards = [
            Guard(health, self.image, bus.clock, by_guarding and health.role is Role.DRIVE) for health in guarded
        ]

        self._motor = PositionTracker(self.scale.position, _COUNTER_RANGE, 0, drive.velocity_cutoff)
        self._differentiate_motor = drive.differentiates
        self._joint_count = 0
        self._motor_count = 0
        self._sampled = -math.inf
        self._look_again = -math.inf  # s, when a heartbeat may be overdue
        self._gaps = False  # True if a node missed the last cycle
        self._torque = self.scale.torque
        self._velocity = self.scale.velocity
        self._per_newton_metre = 1.0 / self.scale.torque
        self._limit = float(self.scale.most_digits)
        self.bus = wire_of(bus, drive.node_id)
        self._send = self.bus.send
        self.rpdo_id = layout.rpdo_id
        self._pack = pdo.COMMAND.struct.pack
        self.readback = CommandReadback()
        self._note = self.readback.sent.append

    def command(self, controlword: int, tau_m: float) -> bool:
        """Send one RPDO with `controlword` and `tau_m` (N*m at the motor pulley), clamped to the drive's limit.

        A value that is not finite is sent as zero and counted in `refused`.

        Returns:
            False if the frame was dropped.
        """
        if self.stands_off:
            self.tau_m_sent = 0.0
            return True
        digits = tau_m * self._per_newton_metre
        if -self._limit <= digits <= self._limit:
            raw = round(digits)
        elif math.isfinite(digits):
            raw = int(math.copysign(self._limit, digits))
        else:
            raw = 0
            self.refused += 1
        self.tau_m_sent = raw * self._torque
        if self._send(self.rpdo_id, self._pack(controlword, raw)):
            self.image.drops = 0
            self._note(raw)
            return True
        self.image.drops += 1
        self.image.dropped += 1
        return False

    def rearm(self, now: float) -> None:
        """Clear the latches after the nodes of this axis have been configured again."""
        image = self.image
        for health in image.nodes:
            health.heard = now
            health.nmt_state = NmtState.OPERATIONAL
            health.boot_ups = health.emcys = health.misses = health.warnings = 0
            health.emcy = health.warning = None
        for guard in self.guards:
            guard.begin()
        image.silent = image.intruder = image.altered = image.pressed = image.bus_fault = None
        image.fresh = image.joint_fresh = False
        image.misses = image.drops = image.events = 0
        if self._is_lean:
            image.mode = image.error_code = 0  # outdated; torque waits for the next one
        self._look_again = -math.inf
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
        self._motor_count, self.image.mode = values[0], values[1]
        self.image.error_code = self._error_code(values)

    def _error_code(self, values: tuple[Any, ...]) -> int:
        """Return the error code at the end of a PDO, or that of the last emergency of a drive without 0x603F."""
        if self._has_error_code:
            return int(values[-1])
        said = self.image.nodes[0].emcy
        return 0 if said is None else said.code

    def _store_lean_motion(self, values: tuple[Any, ...]) -> None:
        image = self.image
        image.statusword, torque, self._motor_count = values
        image.tau_m = torque * self._torque
        if image.statusword & _FAULT and image.nodes[0].emcy is not None:  # arrives before the next error code
            image.error_code = image.nodes[0].emcy.code

    def _store_lean_state(self, values: tuple[Any, ...]) -> None:
        self.image.mode = values[0]
        self.image.error_code = self._error_code(values)

    def _store_encoder(self, values: tuple[Any, ...]) -> None:
        self._joint_count = values[0]

    def _store_torque(self, values: tuple[Any, ...]) -> None:
        self.image.tau_j = values[0] * self._sensor_scale - self._sensor_offset

    def settle(self, sampled: float, complete: bool) -> None:
        """End a cycle: mark fresh values, and update velocities from positions sampled at `sampled` (s)."""
        image = self.image
        image.now = sampled
        fresh = joint_fresh = True
        if not complete:
            fresh, joint_fresh = self._count_misses()
        elif self._gaps:
            self._gaps = False
            for health in image.nodes:
                health.misses = 0
        if self._joint is not None and joint_fresh:
            self._joint.update(self._joint_count, sampled)
            image.q_j = self._joint.angle
            image.omega_j = self._joint.velocity
        image.joint_fresh = joint_fresh
        image.fresh = fresh
        if fresh:
            motor = self._motor
            if self._differentiate_motor:
                motor.update(self._motor_count, sampled)
                image.omega_m = motor.velocity
            else:
                motor.take_position(self._motor_count)
            image.q_m = motor.angle
            image.misses = 0
            self._sampled = sampled
        else:
            image.misses += 1
            image.missed += 1
        image.pdo_age = sampled - self._sampled
        if sampled >= self._look_again:
            self._look_for_silence(sampled)

    def _look_for_silence(self, now: float) -> None:
        """Find a node whose heartbeat is overdue, and the time at which the next one may be."""
        image = self.image
        image.silent = None
        self._look_again = math.inf
        for health in image.nodes:
            due = health.heard + health.timeout
            self._look_again = min(self._look_again, due)
            if image.silent is None and now > due:
                image.silent = health

    def _count_misses(self) -> tuple[bool, bool]:
        """Count a miss for each node with missing answers; return `fresh` and `joint_fresh`."""
        joint_fresh = self._gaps = True
        for health, inboxes in self._watched:
            if any(inbox.is_missing for inbox in inboxes):
                health.misses += 1
                health.missed += 1
                joint_fresh = joint_fresh and health.role is not Role.ENCODER
            else:
                health.misses = 0
        return not any(inbox.is_missing for inbox in self._control_inboxes), joint_fresh


def _health(role: Role, node: NodeSettings) -> NodeHealth:
    return NodeHealth(role, node.node_id, node.heartbeat_timeout)
