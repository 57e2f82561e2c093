"""The findings of the monitor as a table, and its inputs as plain numbers."""

from __future__ import annotations

import msgspec

FINDINGS = {  # id: title, s that it must last, detail
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
    """Why the torque must go; or a notice, which needs no action."""

    id: str
    title: str
    detail: str
    time: float  # s

    def __str__(self) -> str:
        return f"{self.title}: {self.detail}"


class WatchedAxis(msgspec.Struct, frozen=True, kw_only=True):
    """One axis in plain numbers, torque and angle at the motor pulley; a digit is one of the wire's, with sign."""

    name: str
    node_id: int  # of the drive
    slot: int = 1
    pdo_node_id: int | None = None
    has_error_code: bool = True  # 0x603F is in the second TPDO
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
    slack: float  # rad, motor against joint without torque
    compliance: float  # rad/(N*m), motor against joint
    silence: float  # s without SYNC, command or answer


class Watched(msgspec.Struct, frozen=True, kw_only=True):
    """The axes and nodes of one bus that a monitor checks."""

    axes: tuple[WatchedAxis, ...]
    nodes: tuple[int, ...]  # every node of the axes
    period: float  # s of SYNC
    host_node_id: int
    host_silence: float  # s without the heartbeat of the host
