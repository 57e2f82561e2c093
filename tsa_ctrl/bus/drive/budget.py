"""Bus load from the configured bit rate: a virtual bus has none, and a real one only fails when it is too late.

A data frame with an 11-bit identifier and n bytes takes 47 + 8 n bits (CAN 2.0A with interframe space), and at worst
floor((33 + 8 n) / 4) stuff bits more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tsa_ctrl.bus.canopen import pdo
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.errors import UsageError


def frame_bits(length: int) -> tuple[int, int]:
    """Bits on the wire of a frame with `length` bytes: without and with the worst bit stuffing."""
    bits = 47 + 8 * length
    return bits, bits + (33 + 8 * length) // 4


@dataclass(frozen=True)
class Load:
    """Bits per cycle and per second (heartbeats) of one bus; loads are fractions of the bit rate."""

    bitrate: int  # bit/s
    rate: float  # Hz, of SYNC
    cycle_bits: tuple[int, int]  # without, with worst stuffing
    background: float  # bit/s, worst case

    @property
    def least(self) -> float:
        return (self.cycle_bits[0] * self.rate + self.background) / self.bitrate

    @property
    def worst(self) -> float:
        return (self.cycle_bits[1] * self.rate + self.background) / self.bitrate

    def highest_rate(self, max_load: float) -> float:
        """Hz that stay within `max_load` in the worst case; 0 when not even the background fits."""
        return max(0.0, (self.bitrate * max_load - self.background) / self.cycle_bits[1])


def load(settings: BusSettings, axes: Sequence[AxisNodes], rate: float) -> Load:
    """The load of these axes at `rate` (Hz): SYNC, all PDOs each cycle, all heartbeats."""
    lengths = [0]
    background = frame_bits(1)[1] / settings.host_heartbeat_period
    counted: set[int] = set()  # nodes that two axes share talk once
    for axis in axes:
        lengths += [entry.length for entry in pdo.DRIVE_PLAN]
        if axis.encoder is not None and axis.encoder.node_id not in counted:
            lengths += [entry.length for entry in pdo.ENCODER_PLAN]
        if axis.torque_sensor is not None:
            lengths += [entry.length for entry in pdo.TORQUE_SENSOR_PLAN]
        for _, node in axis.nodes():
            if node.node_id not in counted:
                counted.add(node.node_id)
                background += frame_bits(1)[1] / node.heartbeat_period
    bits = [frame_bits(length) for length in lengths]
    return Load(settings.bitrate, rate, (sum(b[0] for b in bits), sum(b[1] for b in bits)), background)


def check(settings: BusSettings, axes: Sequence[AxisNodes], rate: float) -> Load:
    """The load; raises UsageError with the figures when the bit rate cannot carry the rate."""
    result = load(settings, axes, rate)
    if result.worst > settings.max_load:
        raise UsageError(
            f"[bus] bitrate {settings.bitrate}: {rate:g} Hz with {len(axes)} axis/axes needs "
            f"{100 * result.least:.0f} to {100 * result.worst:.0f} % of it, allowed is {100 * settings.max_load:.0f} % "
            f"(max_load); choose a rate of at most {int(result.highest_rate(settings.max_load))} Hz, or a higher "
            "bitrate"
        )
    return result
