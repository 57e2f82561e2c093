"""Decide from CAN frames alone whether the torque must be stopped, without a clock, I/O or a model of the actuator.

The module shares only the frame tables of `bus.canopen` with the loop. `now` is the arrival time of a frame in s.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from tsa_ctrl.bus.canopen import cia301, cia402, objects, pdo
from tsa_ctrl.bus.canopen.cia301 import NmtCommand
from tsa_ctrl.bus.canopen.cia402 import Controlword, PowerState
from tsa_ctrl.monitor.watched import COUNTER, FINDINGS, Angle, Frame, Stop, Stream, Unchanged, Watched, WatchedAxis

RATE_WINDOW, FAST, SLOW = 32, 1.5, 0.5  # SYNC periods over which SYNCs are counted; bounds as multiples of the rate
MEMORY = 0.2  # s over which 0x606C is compared with 0x6064, and for which tendons may stay stretched after a torque
VELOCITY_ERROR, VELOCITY_SHARE, VELOCITY_LAG = 0.02, 0.25, 0.01  # rad, 1, s: errors of a drive's 0x606C
RATIO_ERROR, LATE, CREEP = 0.02, 3e-3, 0.2  # 1, of the travel; s, between encoders; 1/s, of the permitted elongation
STUCK, FROZEN = 0.25, 0.05  # of the torque limit, change of the command during which a measurement must change
_ON = frozenset({PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE})
_SDO_WRITES = frozenset({0, 1, 6})  # client command specifiers: download segment, download, block download
_LSS_QUESTIONS = range(0x46, 0x60)  # CiA 305: identify and inquire; all other LSS services may change a node


class _Axis:
    """The checks of one axis.

    Attributes:
        on: True while the drive may produce torque.
        gone: True once the drive has reported that it produces no torque.
    """

    def __init__(self, watched: WatchedAxis, period: float, act: Callable[..., None]) -> None:
        self.watched, self._period, self._act = watched, period, act
        layout = pdo.drive_layout(watched.node_id, watched.slot, watched.pdo_node_id, watched.lean)
        self.layout = layout if watched.has_error_code else layout.without(objects.ERROR_CODE)
        self.motor = Angle(watched.position_digit, COUNTER, 0, period)
        self.joint = Angle(watched.joint_digit, watched.joint_range, watched.joint_zero, period)
        self.streams: list[Stream] = []
        self.controlword, self.statusword = (
            struct.pack("<HB", *entry.of(watched.slot).key) for entry in (objects.CONTROLWORD, objects.STATUSWORD)
        )
        self.on = self.gone = self._commanded = self._enabled = False
        self._command = self._commanded_at = self._torque = self._speed = self._sampled = 0.0
        self._raw: tuple[int, ...] = ()
        self._begin(0.0)

    def _begin(self, now: float) -> None:
        """Restart all checks, because torque may start."""
        for stream in self.streams:
            stream.heard = max(stream.heard, now)
        self._since: dict[str, float] = {}  # s, start of each failing check
        self._frozen, self._stuck = Unchanged(), Unchanged()
        self._offset, self._from = math.nan, self.motor.angle
        self._load = self._fast = self._way = self._mismatch = 0.0

    def _check(self, now: float, cause: str, wrong: bool, *values: float) -> None:
        """Stop the torque if a wrong condition has lasted for its time without interruption."""
        if not wrong:
            self._since.pop(cause, None)
        elif self.on:
            lasting = FINDINGS[cause][1]
            if now - self._since.setdefault(cause, now) >= lasting + (3.0 * self._period if lasting else 0.0):
                self._act(cause, now, *values, where=f"axis '{self.watched.name}': ")

    def _switch(self, now: float) -> None:
        on = self._commanded or self._enabled
        if on and not self.on:
            self._begin(now)
        self.on = on

    def take_command(self, values: tuple[Any, ...], now: float) -> None:
        """Check the command of the loop."""
        watched, last, elapsed = self.watched, self._command, now - self._commanded_at
        self._commanded = values[0] & 0x8F == Controlword.ENABLE_OPERATION
        self._switch(now)
        torque = values[1] * watched.torque_digit
        self._command, self._commanded_at = torque, now
        limit, rounding = watched.torque, 2.0 * abs(watched.torque_digit)
        self._check(now, "command_torque", abs(torque) > limit + rounding, torque, limit)
        growth = torque - max(last, 0.0) if torque > 0.0 else min(last, 0.0) - torque
        most = watched.torque_rate * (elapsed + self._period) + rounding
        self._check(now, "command_step", growth > most, growth, elapsed, watched.torque_rate)

    def take_motion(self, values: tuple[Any, ...], now: float) -> None:
        """Record state, torque and speed that the drive reports."""
        self.take_state(values[0])
        self._switch(now)
        self._raw = values[1:]
        self._torque, self._speed = values[1] * self.watched.torque_digit, values[2] * self.watched.velocity_digit

    def take_lean_motion(self, values: tuple[Any, ...], now: float) -> None:
        """Record state, torque and position of a drive that does not send 0x606C."""
        self.take_motion((*values[:2], 0), now)
        self.motor.take(values[2:], now)

    def take_state(self, statusword: int) -> None:
        self._enabled = cia402.decode(statusword) in _ON
        self.gone = self.gone or not self._enabled

    def take_answer(self, data: bytes, now: float) -> None:
        """Record the state from an answer to an SDO read of the statusword."""
        if len(data) == 8 and data[0] == 0x4B and data[1:4] == self.statusword:
            self.take_state(int.from_bytes(data[4:6], "little"))

    def judge(self, sampled: float, now: float) -> None:
        """Check the samples of the SYNC at `sampled` (s) against the limits and each other."""
        watched, motor, joint, check = self.watched, self.motor, self.joint, self._check
        moved, joint_moved = motor.update(sampled), joint.update(sampled)
        elapsed = sampled - self._sampled
        if moved:
            self._sampled = sampled
        if not self.on:
            return
        geared = watched.encoder_id is None
        source, ratio = (motor, watched.ratio) if geared else (joint, 1.0)
        q_j, omega_j = source.angle / ratio, source.speed / ratio
        torque, command, limit = self._torque, self._command, watched.torque
        omega_m = max(abs(motor.speed), abs(self._speed))
        check(now, "motor_speed", omega_m > watched.motor_over_speed, omega_m, watched.motor_over_speed)
        check(now, "joint_speed", abs(omega_j) > watched.over_speed, omega_j, watched.over_speed)
        if watched.travel is not None:
            check(now, "travel", not watched.travel[0] <= q_j <= watched.travel[1], q_j, *watched.travel)
        check(now, "torque", abs(torque) > limit + watched.torque_error, torque, limit)
        check(now, "torque_error", abs(torque - command) > watched.torque_error, torque, command)
        by = self._frozen.update((self._raw, motor.count), command)
        check(now, "frozen", by > FROZEN * limit, by)
        by = self._stuck.update(motor.count, command)
        check(now, "stuck", by > max(STUCK * limit, watched.slack / watched.compliance), by)
        if moved and elapsed > 0.0:
            self._compare(elapsed, now, joint_moved and not geared)

    def _compare(self, elapsed: float, now: float, has_joint: bool) -> None:
        """Compare the paths from 0x606C and 0x6064, and compare q_M with q_J by the ratio of the radii."""
        watched, motor, kept = self.watched, self.motor, math.exp(-elapsed / MEMORY)
        way, digit = self._speed * elapsed, abs(watched.velocity_digit)
        self._fast = max(abs(self._speed), abs(motor.speed), self._fast * kept)
        self._mismatch = self._mismatch * kept + way - motor.step
        self._way = self._way * kept + max(abs(way), abs(motor.step))
        most = VELOCITY_ERROR + VELOCITY_SHARE * self._way + VELOCITY_LAG * self._fast + digit * MEMORY
        self._check(now, "velocity", digit > 0.0 and abs(self._mismatch) > most, self._speed, motor.speed)
        if not has_joint:
            return
        apart = motor.angle - watched.ratio * self.joint.angle
        self._offset = apart if self._offset != self._offset else self._offset
        apart -= self._offset
        self._load = max(abs(self._torque), abs(self._command), self._load * kept)
        most = watched.slack + watched.compliance * self._load + LATE * self._fast
        most += RATIO_ERROR * abs(motor.angle - self._from)
        self._check(now, "apart", abs(apart) > most, apart, most)
        creep = CREEP * most * elapsed
        self._offset += min(creep, max(-creep, apart))


class Monitor:
    """Check the frames of one bus.

    Attributes:
        stop: latched cause of the stop; None without one.
        notices: harmless frames of another master by id of `FINDINGS`.
    """

    def __init__(self, watched: Watched) -> None:
        self.stop: Stop | None = None
        self.notices: dict[str, Stop] = {}
        self._watched, self._synced, self._counted = watched, -math.inf, (math.inf, 0)
        self._axes = [_Axis(axis, watched.period, self.act) for axis in watched.axes]
        self._handlers: dict[int, list[Callable[[bytes, float], None]]] = {}
        silence = max(axis.silence for axis in watched.axes)
        self._window = max(RATE_WINDOW * watched.period, 4.0 * silence)
        self._sync = Stream(cia301.SYNC, silence)
        self._host = Stream(cia301.HEARTBEAT + watched.host_node_id, watched.host_silence)
        self._hear(self._sync.can_id, self._take_sync)
        self._hear(self._host.can_id, lambda data, now: setattr(self._host, "heard", now))
        self._hear(cia301.NMT, self._meet_nmt)
        self._hear(cia301.LSS_REQUEST, self._meet_lss)
        self._hear(cia301.TIME, lambda data, now: self._notice("time", now))
        for node in watched.nodes:
            self._hear(cia301.SDO_REQUEST + node, self._meet_sdo)
        for axis in self._axes:
            layout, lean, encoder = axis.layout, axis.watched.lean, axis.watched.encoder_id
            self._hear_pdo(axis, layout.command, layout.node_id, axis.take_command)
            self._hear_pdo(axis, layout.motion, layout.node_id, axis.take_lean_motion if lean else axis.take_motion)
            if not lean:
                self._hear_pdo(axis, layout.position, layout.node_id, axis.motor.take)
            if encoder is not None:
                self._hear_pdo(axis, pdo.ENCODER, encoder, axis.joint.take)
            self._hear(cia301.SDO_ANSWER + axis.watched.node_id, axis.take_answer)

    def step(self, frame: Frame | None, now: float) -> Stop | None:
        """Process one frame that arrived at `now` (s), and return the cause of a stop or None.

        Call it with None once all frames until `now` have been processed, to detect missing frames.
        """
        if frame is None:
            self._look_for_silence(now)
        else:
            for handler in self._handlers.get(frame[0], ()):
                handler(frame[1], now)
        return self.stop

    @property
    def on(self) -> bool:
        """Return True while a drive may produce torque."""
        return any(axis.on for axis in self._axes)

    @property
    def confirmed(self) -> bool:
        """Return True once every drive has reported after the stop that it produces no torque."""
        return all(axis.gone for axis in self._axes)

    def action(self, number: int) -> list[Frame]:
        """Return the frames of repetition `number` (from 0) of the stop.

        NMT stop comes first. A stopped node answers no SDO, so the next repetition makes it pre-operational, disables a
        drive that did not react to the stop, and requests its state. RPDOs have no effect in either state.
        """
        nodes = dict.fromkeys(axis.watched.node_id for axis in self._axes)
        if number % 2 == 0:
            return [(cia301.NMT, cia301.nmt(NmtCommand.STOP, node)) for node in nodes]
        frames = [(cia301.NMT, cia301.nmt(NmtCommand.PRE_OPERATIONAL, node)) for node in nodes]
        for axis in self._axes:
            request = cia301.SDO_REQUEST + axis.watched.node_id
            frames.append((request, b"\x2b" + axis.controlword + bytes(4)))
            frames.append((request, b"\x40" + axis.statusword + bytes(4)))
        return frames

    def act(self, cause: str, now: float, *values: object, where: str = "") -> None:
        """Latch `cause`, an id of `FINDINGS`, with the values of its detail, unless a cause is latched already."""
        if self.stop is None:
            self.stop = Stop.of(cause, now, values, where)
            for axis in self._axes:
                axis.gone = not axis.on

    def _notice(self, cause: str, now: float, *values: object) -> None:
        if self.on and cause not in self.notices:
            self.notices[cause] = Stop.of(cause, now, values)

    def _meet(self, cause: str, now: float, *values: object) -> None:
        """Stop the torque on a frame that only another master sends while torque is on."""
        if self.on:
            self.act(cause, now, *values)

    def _hear(self, can_id: int, handler: Callable[[bytes, float], None]) -> None:
        self._handlers.setdefault(can_id, []).append(handler)

    def _hear_pdo(self, axis: _Axis, layout: pdo.Pdo, node_id: int, take: Callable[..., None]) -> None:
        stream = Stream(layout.cob_id(node_id), axis.watched.silence)
        axis.streams.append(stream)
        unpack, length = layout.struct.unpack, layout.length

        def handle(data: bytes, now: float) -> None:
            if len(data) != length:  # not the expected PDO
                return
            if stream.receive(now) and axis.on:
                self.act("surplus", now, stream.can_id, stream.surplus)
            take(unpack(data), now)

        self._hear(stream.can_id, handle)

    def _take_sync(self, data: bytes, now: float) -> None:
        sampled, self._synced = self._synced, now
        self._sync.heard = now
        for axis in self._axes:
            axis.judge(sampled, now)
            for stream in axis.streams:
                stream.renew()
        began, count = self._counted
        if not self.on:
            self._counted = now, 0
        elif now - began < self._window:
            self._counted = began, count + 1
        else:
            self._counted, rate, expected = (now, 0), (count + 1) / (now - began), 1.0 / self._watched.period
            if not SLOW * expected < rate < FAST * expected:
                self.act("sync_rate", now, rate, expected)

    def _look_for_silence(self, now: float) -> None:
        for axis in self._axes if self.stop is None else ():
            for stream in (self._sync, self._host, *axis.streams) if axis.on else ():
                silent, where = now - stream.heard, f"axis '{axis.watched.name}': "
                if silent > stream.silence:
                    self.act("silent", now, stream.can_id, silent, where=where)

    def _meet_nmt(self, data: bytes, now: float) -> None:
        if len(data) == 2 and data[1] in (cia301.ALL_NODES, *self._watched.nodes):
            self._meet("nmt", now, *data)

    def _meet_lss(self, data: bytes, now: float) -> None:
        if data and data[0] in _LSS_QUESTIONS:
            self._notice("lss_question", now, data[0])
        elif data:
            self._meet("lss", now, data[0])

    def _meet_sdo(self, data: bytes, now: float) -> None:
        if len(data) > 2 and data[0] >> 5 in _SDO_WRITES:
            self._meet("sdo_write", now, data[2], data[1])
