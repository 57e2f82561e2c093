"""Define the findings of a monitor, the settings of its axes, and the evaluation of angles and received frames."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Any

import msgspec

FINDINGS = {  # id: title, s for which it must last, detail
    "command_torque": ("commanded torque above the limit", 0.0, "{:.2f} N*m, the limit is {:g} N*m"),
    "command_step": ("commanded torque grows too fast", 0.0, "by {:.2f} N*m in {:.4f} s, the limit is {:g} N*m/s"),
    "torque": ("reported torque above the limit", 0.01, "{:.2f} N*m, the limit is {:g} N*m"),
    "torque_error": ("reported torque differs from the command", 0.15, "{:.2f} N*m, the command is {:.2f} N*m"),
    "motor_speed": ("motor too fast", 0.0, "{:.1f} rad/s, the limit is {:g} rad/s"),
    "joint_speed": ("joint too fast", 0.0, "{:.1f} rad/s, the limit is {:g} rad/s"),
    "travel": ("joint beyond its travel", 0.0, "{:.2f} rad, the limits are {:g} and {:g} rad"),
    "velocity": ("velocity contradicts position", 0.0, "0x606C {:.2f} rad/s, derivative of 0x6064 {:.2f} rad/s"),
    "apart": ("motor and joint moved apart", 0.02, "by {:.3f} rad at the motor, the limit is {:.3f} rad"),
    "frozen": ("feedback of the drive is frozen", 0.03, "no bit changed while the command moved by {:.2f} N*m"),
    "stuck": ("motor position is frozen", 0.1, "no bit changed while the command moved by {:.2f} N*m"),
    "surplus": ("more than one frame per SYNC", 0.0, "identifier 0x{:03X}, {:.0f} frames too many"),
    "silent": ("a frame is missing", 0.0, "identifier 0x{:03X}, none for {:.3f} s"),
    "sync_rate": ("SYNC at a wrong rate", 0.0, "{:.0f} Hz, the rate is {:.0f} Hz"),
    "nmt": ("NMT command while torque is on", 0.0, "command 0x{:02X} to node {}"),
    "lss": ("LSS command while torque is on", 0.0, "command 0x{:02X}"),
    "sdo_write": ("SDO write while torque is on", 0.0, "object 0x{:02X}{:02X}"),
    "lss_question": ("LSS frame of another master", 0.0, "command 0x{:02X}"),
    "time": ("TIME frame of another master", 0.0, "identifier 0x100"),
    "bus": ("the monitor cannot hear the bus", 0.0, "{}"),
    "daemon": ("the daemon ended while torque was on", 0.0, "its pipe is closed"),
}


class Stop(msgspec.Struct, frozen=True):
    """The reason why the monitor stops the torque, or a notice that requires no action."""

    id: str
    title: str
    detail: str
    time: float  # s

    @classmethod
    def of(cls, cause: str, time: float, values: Iterable[object], where: str = "") -> Stop:
        """Return the finding `cause`, an id of `FINDINGS`, with the values of its detail."""
        title, _, detail = FINDINGS[cause]
        return cls(cause, title, where + detail.format(*values), time)

    def __str__(self) -> str:
        return f"{self.title}: {self.detail}"


class WatchedAxis(msgspec.Struct, frozen=True, kw_only=True):
    """The monitor's settings of one axis, with torque and angle at the motor pulley. Digits have the bus sign."""

    name: str
    node_id: int  # node id of the drive
    slot: int = 1
    pdo_node_id: int | None = None
    has_error_code: bool = True  # 0x603F is in the second TPDO
    lean: bool = False  # 0x6064 is in the first TPDO instead of 0x606C
    encoder_id: int | None = None  # node of the joint encoder
    torque_digit: float  # N*m
    position_digit: float  # rad
    velocity_digit: float  # rad/s; 0: 0x606C is not used
    joint_digit: float = 0.0  # rad of the joint
    joint_zero: int = 0  # counts
    joint_range: int = 1 << 32  # counts
    torque: float  # N*m, absolute limit
    torque_rate: float  # N*m/s, fastest growth of the command
    torque_error: float  # N*m, reported against commanded
    over_speed: float  # rad/s of the joint
    motor_over_speed: float  # rad/s
    travel: tuple[float, float] | None = None  # rad of the joint
    ratio: float  # 1, r_J / r_M
    slack: float  # rad, largest elongation without torque
    compliance: float  # rad/(N*m), elongation by the motor torque
    silence: float  # s without SYNC, command or answer


class Watched(msgspec.Struct, frozen=True, kw_only=True):
    """The axes and nodes of one bus that a monitor checks."""

    axes: tuple[WatchedAxis, ...]
    nodes: tuple[int, ...]  # all nodes of the axes
    period: float  # s of SYNC
    host_node_id: int
    host_silence: float  # s without the heartbeat of the host


SURPLUS, FORGIVEN = 3.0, 0.05  # frames beyond one per SYNC, and their decrease per SYNC, because bus errors repeat some
Frame = tuple[int, bytes]  # identifier and data
COUNTER = 1 << 32  # range of 0x6064
SPEED_WINDOW = 0.01  # s over which positions are differentiated


class Angle:
    """The angle (rad) of a counter that wraps, with its last step (rad) and its speed (rad/s) over `SPEED_WINDOW`."""

    def __init__(self, digit: float, wraps: int, zero: int, period: float) -> None:
        self._digit, self._wraps, self.count, self._last, self._fresh = digit, wraps, zero, zero, False
        self._past: deque[tuple[float, float]] = deque(maxlen=1 + math.ceil(SPEED_WINDOW / period))
        self.angle = self.speed = self.step = 0.0

    def take(self, values: tuple[Any, ...], now: float) -> None:
        self.count, self._fresh = values[0], True

    def update(self, sampled: float) -> bool:
        """Update the angle with the count of the SYNC at `sampled` (s). Return False without a new count."""
        if not self._fresh:
            return False
        half = self._wraps // 2
        self.step = self._digit * ((self.count - self._last + half) % self._wraps - half)
        self._last, self._fresh = self.count, False
        self.angle += self.step
        self._past.append((sampled, self.angle))
        elapsed = sampled - self._past[0][0]
        self.speed = (self.angle - self._past[0][1]) / elapsed if elapsed > 0.0 else 0.0
        return True


class Unchanged:
    """The range of the command (N*m) since a measurement last changed."""

    def __init__(self) -> None:
        self._content: object = None
        self._low = self._high = 0.0

    def update(self, content: object, command: float) -> float:
        """Return the range with the present `content` of the measurement and the present `command` (N*m)."""
        if content == self._content:
            self._low, self._high = min(self._low, command), max(self._high, command)
        else:
            self._content, self._low, self._high = content, command, command
        return self._high - self._low


class Stream:
    """The frames of one identifier: the time of the last one, and the number of surplus frames beyond one per SYNC."""

    def __init__(self, can_id: int, silence: float) -> None:
        self.can_id, self.silence, self.heard, self.surplus, self._credit = can_id, silence, -math.inf, 0.0, 2

    def receive(self, now: float) -> bool:
        """Count a frame that arrived at `now` (s). Return True if it is one too many."""
        self.heard = now
        if self._credit:
            self._credit -= 1
            return False
        self.surplus += 1.0
        return self.surplus > SURPLUS

    def renew(self) -> None:
        """Permit a frame for a new SYNC."""
        self._credit = 1 if self._credit == 0 else 2  # 2 permits an answer that is late by one SYNC
        if self.surplus > 0.0:
            self.surplus -= FORGIVEN
