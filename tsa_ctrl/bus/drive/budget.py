"""Compute the bus load from the configured bit rate.

A virtual bus has no bit rate, and a real bus shows an overload only while the loop runs.

A data frame with an 11-bit identifier and n bytes takes 47 + 8 n bits (CAN 2.0A with interframe space). Bit stuffing
adds at most floor((33 + 8 n) / 4) bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from msgspec.structs import replace

from tsa_ctrl.bus.canopen import pdo
from tsa_ctrl.bus.drive.network import layout_of, torque_sensor_pdo
from tsa_ctrl.bus.drive.plan import is_rate
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.errors import UsageError

BITRATES = (125_000, 250_000, 500_000, 800_000, 1_000_000)  # bit/s, of CiA 301
LOWEST_RATE = 10  # Hz, lower limit of [controller] rate


def frame_bits(length: int) -> tuple[int, int]:
    """Return the bits on the wire of a frame with `length` data bytes, without and with worst-case bit stuffing."""
    bits = 47 + 8 * length
    return bits, bits + (33 + 8 * length) // 4


@dataclass(frozen=True)
class Load:
    """Bits per cycle and per second (heartbeats) on one bus. Loads are fractions of the bit rate."""

    bitrate: int  # bit/s
    rate: float  # Hz, of SYNC
    cycle_bits: tuple[float, float]  # without and with worst-case stuffing; a PDO every n SYNCs counts as 1/n
    background: float  # bit/s, worst case

    @property
    def least(self) -> float:
        return (self.cycle_bits[0] * self.rate + self.background) / self.bitrate

    @property
    def worst(self) -> float:
        return (self.cycle_bits[1] * self.rate + self.background) / self.bitrate

    def highest_rate(self, max_load: float) -> float:
        """Return the highest SYNC rate (Hz) within `max_load` in the worst case; 0 if heartbeats alone exceed it."""
        return max(0.0, (self.bitrate * max_load - self.background) / self.cycle_bits[1])


def load(settings: BusSettings, axes: Sequence[AxisNodes], rate: float) -> Load:
    """Return the load of these axes at `rate` (Hz): SYNC, PDOs at their own rates, and all heartbeats."""
    frames = [(0, 1)]  # data bytes, and SYNCs from one frame to the next
    background = frame_bits(1)[1] / settings.host_heartbeat_period
    counted: set[int] = set()  # nodes that two axes share send one heartbeat
    for axis in axes:
        layout = layout_of(axis.drive)
        pdos = [layout.command, layout.motion, layout.position]
        if axis.encoder is not None and axis.encoder.node_id not in counted:
            pdos.append(pdo.ENCODER)
        if axis.torque_sensor is not None:
            pdos.append(torque_sensor_pdo(axis.torque_sensor))
        frames += [(each.length, each.every) for each in pdos]
        for _, node in axis.nodes():
            if node.node_id not in counted:
                counted.add(node.node_id)
                background += frame_bits(1)[1] / node.heartbeat_period
    least, worst = (sum(frame_bits(length)[kind] / every for length, every in frames) for kind in (0, 1))
    return Load(settings.bitrate, rate, (least, worst), background)


def fits(settings: BusSettings, axes: Sequence[AxisNodes], rate: float) -> bool:
    """Return True if the bit rate is sufficient for `rate` (Hz) with worst-case bit stuffing."""
    return load(settings, axes, rate).worst <= settings.max_load


A = TypeVar("A", bound=AxisNodes)


def fitted(settings: BusSettings, axes: Sequence[A], rate: float) -> tuple[A, ...]:
    """Return the axes with `every` of each torque sensor set: 1, or 2 if the bit rate requires it; set values stay."""

    def answering(every: int) -> tuple[A, ...]:
        return tuple(
            axis
            if axis.torque_sensor is None or axis.torque_sensor.every is not None
            else replace(axis, torque_sensor=replace(axis.torque_sensor, every=every))
            for axis in axes
        )

    return answering(1 if fits(settings, answering(1), rate) else 2)


def lean(axes: Sequence[A]) -> tuple[A, ...]:
    """Return the axes with `pdo = "lean"`."""
    return tuple(replace(axis, drive=replace(axis.drive, pdo="lean")) for axis in axes)


def suggestions(settings: BusSettings, axes: Sequence[AxisNodes], rate: float) -> list[str]:
    """Return changes to the file after which `check` passes for this bus; each one is sufficient."""
    found = []
    shorter, seldom = lean(axes), [_every_second(axis) for axis in axes]
    if fits(settings, seldom, rate):
        found.append("every = 2 in [axis.torque_sensor]")
    elif fits(settings, fitted(settings, shorter, rate), rate):
        found.append('pdo = "lean" in [axis.drive]')
    elif fits(settings, lean(seldom), rate):
        found.append('pdo = "lean" in [axis.drive] and every = 2 in [axis.torque_sensor]')
    highest = load(settings, axes, rate).highest_rate(settings.max_load)
    slower = next((lower for lower in range(int(highest), LOWEST_RATE - 1, -1) if is_rate(lower)), None)
    if slower is not None:
        found.append(f"rate = {slower} in [controller]")
    faster = (
        each for each in BITRATES if each > settings.bitrate and fits(replace(settings, bitrate=each), axes, rate)
    )
    bitrate = next(faster, None)
    if bitrate is not None:
        found.append(f"bitrate = {bitrate} in {settings.header} and in every node")
    return found


def _every_second(axis: AxisNodes) -> AxisNodes:
    return axis if axis.torque_sensor is None else replace(axis, torque_sensor=replace(axis.torque_sensor, every=2))


def check(settings: BusSettings, axes: Sequence[AxisNodes], rate: float) -> Load:
    """Return the load; raise UsageError with the figures if the bit rate is too low for `rate` (Hz)."""
    result = load(settings, axes, rate)
    if result.worst > settings.max_load:
        remedies = suggestions(settings, axes, rate) or ["fewer axes on this bus"]
        raise UsageError(
            f"{settings.header} bitrate {settings.bitrate}: {rate:g} Hz with {len(axes)} "
            f"{'axis' if len(axes) == 1 else 'axes'} needs {100 * result.least:.0f} to {100 * result.worst:.0f} % of "
            f"it, but {100 * settings.max_load:.0f} % is allowed (max_load), i.e. at most "
            f"{int(result.highest_rate(settings.max_load))} Hz; choose {', or '.join(remedies)}"
        )
    return result
