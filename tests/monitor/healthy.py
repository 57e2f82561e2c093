"""Frames of a healthy axis as literal bytes: SYNC, command, TPDOs of the drive and the encoder, heartbeats."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator

from tsa_ctrl.monitor.watch import Monitor
from tsa_ctrl.monitor.watched import Frame, Stop, Watched, WatchedAxis

PERIOD = 1e-3  # s
ENABLED, READY = 0x1237, 0x1231  # statuswords
NODE, ENCODER, HOST = 1, 0x20, 0x7F
COUNTS, JOINT_COUNTS, RATIO = 65536, 1 << 20, 1.25
SYNC, RPDO, MOTION, POSITION, JOINT, HEARTBEAT = 0x080, 0x201, 0x181, 0x281, 0x1A0, 0x77F

Edit = Callable[[float, list[Frame]], list[Frame]]


def watched_axis(**changes: object) -> WatchedAxis:
    numbers: dict[str, object] = {
        "name": "knee", "node_id": NODE, "encoder_id": ENCODER, "torque_digit": 1e-3, "velocity_digit": 1e-3,
        "position_digit": 2.0 * math.pi / COUNTS, "joint_digit": 2.0 * math.pi / JOINT_COUNTS, "torque": 2.0,
        "torque_rate": 200.0, "torque_error": 0.5, "over_speed": 12.0, "motor_over_speed": 20.0, "travel": (-1.5, 1.5),
        "ratio": RATIO, "slack": 0.06, "compliance": 0.04, "silence": 0.02,
    }  # fmt: skip
    return WatchedAxis(**{**numbers, **changes})  # type: ignore[arg-type]


def watched(period: float = PERIOD, nodes: tuple[int, ...] = (1, 0x20, 0x40), **changes: object) -> Watched:
    axis = watched_axis(**changes)
    return Watched(axes=(axis,), nodes=nodes, period=period, host_node_id=HOST, host_silence=0.1)


class Sound:
    """A healthy axis that swings by `amplitude` rad at 1 Hz. Its torque follows the command.

    `sign` is the sign of the drive's torque, speed and position on the bus.
    """

    def __init__(self, amplitude: float = 0.5, torque: float = 0.8, sign: int = 1) -> None:
        self.amplitude, self.torque, self.sign = amplitude, torque, sign
        self.controlword, self.statusword = 0x0F, ENABLED

    def cycle(self, t: float) -> list[Frame]:
        phase = 2.0 * math.pi * t
        torque = self.torque * math.sin(phase) * min(1.0, 2.0 * t)
        q_j, omega_j = self.amplitude * math.sin(phase), 2.0 * math.pi * self.amplitude * math.cos(phase)
        q_m, omega_m = RATIO * q_j + 0.04 * torque, RATIO * omega_j
        raw, counts = self.sign * round(1e3 * torque), self.sign * math.floor(q_m * COUNTS / (2.0 * math.pi))
        joint = math.floor(q_j * JOINT_COUNTS / (2.0 * math.pi)) & 0xFFFFFFFF
        frames = [
            (SYNC, b""),
            (MOTION, struct.pack("<Hhi", self.statusword, raw, self.sign * round(1e3 * omega_m))),
            (POSITION, struct.pack("<ibH", counts, 10, 0)),
            (JOINT, struct.pack("<I", joint)),
            (RPDO, struct.pack("<Hh", self.controlword, raw)),
        ]
        return [*frames, (HEARTBEAT, b"\x05")] if round(t / PERIOD) % 20 == 0 else frames


def frames(sound: Sound, seconds: float, edit: Edit = lambda t, frames: frames) -> Iterator[tuple[Frame | None, float]]:
    """Yield the frames of each cycle, 0.1 ms apart, and None at its end."""
    for number in range(round(seconds / PERIOD)):
        t = number * PERIOD
        for place, frame in enumerate(edit(t, sound.cycle(t))):
            yield frame, t + 1e-4 * place
        yield None, t + 0.9 * PERIOD


def play(monitor: Monitor, sound: Sound, seconds: float, edit: Edit = lambda t, frames: frames) -> Stop | None:
    """Pass all frames to the monitor. Return the cause of its stop, or None."""
    for frame, now in frames(sound, seconds, edit):
        monitor.step(frame, now)
    return monitor.stop


def changed(can_id: int, edit: Callable[[bytes], bytes], at: float) -> Edit:
    """Return an edit that changes the data of one identifier from `at` s on."""
    return lambda t, frames: [(i, edit(data) if i == can_id and t >= at else data) for i, data in frames]


def held(can_ids: tuple[int, ...], at: float, size: int = 8) -> Edit:
    """Return an edit that freezes the first `size` bytes of these identifiers from `at` s on."""
    kept: dict[int, bytes] = {}

    def edit(t: float, frames: list[Frame]) -> list[Frame]:
        if t < at:
            kept.clear()
            return frames
        return [(i, kept.setdefault(i, data)[:size] + data[size:] if i in can_ids else data) for i, data in frames]

    return edit


def without(can_id: int, at: float) -> Edit:
    return lambda t, frames: [frame for frame in frames if frame[0] != can_id or t < at]


def added(at: float, *more: Frame, last: float = math.inf) -> Edit:
    """Return an edit that adds frames at the end of each cycle from `at` to `last` s."""
    return lambda t, frames: [*frames, *more] if at <= t <= last else frames
